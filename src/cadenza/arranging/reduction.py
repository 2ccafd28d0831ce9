"""The reduction of a song to notes that two hands can play, by a beam search.

At each moment, a hand strikes some of the notes that begin, and holds the keys that it can. A state
of the search consists of the keys that both hands hold, and the pitch classes that have sounded in
this beat. The value of a transition is the sum over struck notes, less the costs of the hands. The
best states of each moment are kept (the beam); the best sequence of states is the reduction.

Fidelity under a bound on difficulty, melody and bass before all others, follows Nakamura and
Yoshii, "Statistical piano reduction controlling performance difficulty" (APSIPA Transactions on
Signal and Information Processing 7, 2018).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from heapq import nsmallest
from itertools import product
from typing import NamedTuple

from cadenza.arranging.moments import MIN_LENGTH, SongMoment
from cadenza.arranging.parts import TOGETHER, SourceNote
from cadenza.fingering.players import Players, ways_to_hold
from cadenza.fingers import LEFT, RIGHT
from cadenza.hands.reach import JumpTimes
from cadenza.music.score import OCTAVE, RELEASE_TIME

_BEAM = 6  # states that are kept; more cost time and change little
_MAX_HARMONY = 3  # notes that a hand adds to melody or bass
_SHIFTS = 0, -OCTAVE, OCTAVE, -2 * OCTAVE, 2 * OCTAVE
_LONG_AGO = -10.0  # [s]
_MIN_HELD = 0.03  # [s] for which a hand holds struck keys
_MIN_REPETITION = 0.1  # [s]
_MIN_LATE = 0.15  # [s] for which a note sounds that is struck late
# [s] in which C4 (MIDI 60) falls by 20 dB on a piano. It decays at first by 10 dB a second, C2 by 2
# and C7 by 80 (Bensa et al., JASA 114, 2003), then more slowly (Weinreich, JASA 62, 1977).
_DECAY, _DECAY_PITCH = 3.6, 60
_BUSY = 0.2  # [s] after which a hand that strikes again is busy

# Values and costs of notes; 1 is a pitch class that sounds in a beat.
_MELODY, _BASS, _MOVED_BASS = 12.0, 6.0, 4.0  # values; that of a bass note an octave higher
_NEW, _AGAIN = 1.0, 0.4  # values of the first note of a pitch class in a beat, and of others
_LATE = 0.15  # cost of striking a note later than written, or again
_MOVED = 0.3  # cost of every octave by which a note is moved
# Cost of ending a note, and one of the melody, as soon as it begins; less if it ends later.
_EARLY, _EARLY_MELODY = 0.6, 4.0
_HASTE = 30.0  # cost of a jump that takes all available time; by the square of the share
_BUSY_COST = 0.6  # cost of each further note that a hand strikes at once `_BUSY` after others


_EASY = 0.85  # share of the reach used in chords: at its end, inner fingers press badly
_TWO_NOTES = 2  # a chord of two notes may use the whole reach


class OneHand:
    """One hand of the players."""

    def __init__(self, hand: int, players: Players, times: JumpTimes) -> None:
        """Take the number of the hand, the players, and the times of their jumps."""
        keyboard = players.keyboard
        self.is_there = players.forearm(hand) is not None
        self._lowest, self._num_keys = keyboard.lowest_pitch, len(keyboard.grid_y)
        self._y, self._times = keyboard.grid_y, times
        self._reaches = players.reaches(hand)
        self._spans = players.spans()
        eased = replace(players.reach, most=_EASY * players.reach.most)
        self._spans_of_chord = replace(players, reach=eased).spans()
        self._outwards = 1 if hand == RIGHT else -1
        self.fits = cache(self._fits)
        self.jump_time = cache(self._jump_time)

    def reaches(self, pitch: int) -> bool:
        """Whether any finger reaches a key."""
        key = pitch - self._lowest
        return 0 <= key < self._num_keys and bool(self._reaches[key].any())

    def _fits(self, pitches: tuple[int, ...]) -> bool:
        """Whether the hand can hold keys at once, by their pitches from the lowest on."""
        keys = [pitch - self._lowest for pitch in pitches]
        spans = self._spans if len(keys) <= _TWO_NOTES else self._spans_of_chord
        if not all(map(self.reaches, pitches)):
            return False
        return any(True for _ in ways_to_hold(keys[:: self._outwards], self._reaches, spans))

    def _middle(self, pitches: tuple[int, ...]) -> float:
        """The middle of keys along the keyboard [m]."""
        return float(self._y[pitches[0] - self._lowest] + self._y[pitches[-1] - self._lowest]) / 2

    def _jump_time(self, left: tuple[int, ...], struck: tuple[int, ...], holding: bool) -> float:
        """The time from leaving keys to striking others [s]."""
        distance = abs(self._middle(left) - self._middle(struck))
        return float(self._times.seconds(distance, len(left), len(struck), holding))


class Held(NamedTuple):
    """A key that is down from `start` to `end` [s], and whether it has the melody."""

    pitch: int
    start: float
    end: float
    melody: bool


class Grip(NamedTuple):
    """A hand between two moments."""

    held: tuple[Held, ...] = ()  # the keys that it holds, from the lowest on
    struck: tuple[int, ...] = ()  # the pitches that it struck last
    time: float = _LONG_AGO  # the time at which it struck them [s]

    def still_held(self, time: float) -> list[Held]:
        """The keys that it holds at a time."""
        return [held for held in self.held if held.end > time + RELEASE_TIME]


class Struck(NamedTuple):
    """A note that is played: the moment [s], its source, and its pitch."""

    time: float
    source: SourceNote
    pitch: int

    @property
    def late(self) -> bool:
        """Whether its source has begun before, in a broken chord or to be struck again."""
        return self.time > self.source.start + TOGETHER

    @property
    def start(self) -> float:
        """When it is struck [s]: at the moment, or as written if it begins then."""
        return max(self.time, self.source.start)

    @property
    def end(self) -> float:
        """When it ends [s], if the hand can hold it for so long."""
        return max(self.source.end, self.time + _MIN_LATE) if self.late else self.source.end


class Action(NamedTuple):
    """The action of one hand at a moment."""

    hand: Grip  # the hand afterwards
    struck: tuple[Struck, ...]
    early_ends: tuple[Held, ...]  # the keys that it leaves early, with their new ends
    cost: float


class ReductionState(NamedTuple):
    """A state of the search, with its least cost and its predecessor."""

    cost: float
    hands: tuple[Grip, Grip]
    classes: frozenset[int]  # the pitch classes that have sounded in this beat
    actions: tuple[Action, ...]
    before: ReductionState | None


def reduced(
    moments: Sequence[SongMoment], hands: tuple[OneHand, OneHand], cost: float
) -> tuple[list[Struck], list[Held]]:
    """The notes that the hands play of these moments, and the ends of notes that end early.

    The reduction becomes easier with the `cost` of every note of the harmony.
    """
    beam = [ReductionState(0.0, (Grip(), Grip()), frozenset(), (), None)]
    for moment in moments:
        successors = [new for state in beam for new in _successors(state, moment, hands, cost)]
        best: dict[tuple[object, ...], ReductionState] = {}
        for state in nsmallest(4 * _BEAM, successors, key=lambda option: option.cost):
            best.setdefault((state.hands, state.classes), state)
        beam = list(best.values())[:_BEAM]
    actions: list[Action] = []
    last: ReductionState | None = beam[0]
    while last is not None:
        actions += last.actions
        last = last.before
    struck = (note for action in reversed(actions) for note in action.struck)
    return list(_again(struck)), [end for action in actions for end in action.early_ends]


def _again(struck: Iterable[Struck]) -> Iterator[Struck]:
    """Yield notes by time; where a source is struck again, a source that is added."""
    before: set[SourceNote] = set()
    for each in struck:
        if each.source in before:
            added = each.source._replace(start=each.time, end=each.end, added=True)
            yield each._replace(source=added)
        else:
            before.add(each.source)
            yield each


def _successors(
    state: ReductionState, moment: SongMoment, hands: tuple[OneHand, OneHand], cost: float
) -> Iterator[ReductionState]:
    """Yield the states after a moment, for all actions of both hands."""
    classes = state.classes
    if moment.begins_beat:
        held_keys = (held for hand in state.hands for held in hand.still_held(moment.time))
        audible = (held for held in held_keys if not _has_died_away(held, moment.time))
        classes = frozenset(held.pitch % OCTAVE for held in audible)
    actions = [
        list(_HandAtMoment(hand, state.hands[hand], moment, hands[hand], classes).actions())
        for hand in (RIGHT, LEFT)
    ]
    for right, left in product(*actions):
        if _collide(right, left):
            continue
        present, value = classes, 0.0
        for struck in (*right.struck, *left.struck):
            value += _value(struck, present, cost)
            present |= {struck.pitch % OCTAVE}
        total = state.cost - value + right.cost + left.cost
        yield ReductionState(total, (right.hand, left.hand), present, (right, left), state)


def _collide(right: Action, left: Action) -> bool:
    """Whether the hands would cross, or both play the same note."""
    high, low = right.hand.held, left.hand.held
    if high and low and low[-1].pitch >= high[0].pitch:
        return True
    sources = {struck.source for struck in right.struck}
    return any(struck.source in sources for struck in left.struck)


def _value(struck: Struck, classes: frozenset[int], cost: float) -> float:
    """The value of a struck note after these pitch classes, less its `cost`."""
    note, moved = struck.source, abs(struck.pitch - struck.source.pitch) // OCTAVE
    if note.melody:
        return _MELODY
    if note.bass:
        return _MOVED_BASS if moved else _BASS
    value = -cost - _MOVED * moved - _LATE * struck.late
    if struck.pitch % OCTAVE not in classes:
        return value + _NEW
    return value - _NEW if moved or struck.late else value + _AGAIN


def _has_died_away(held: Held, time: float) -> bool:
    """Whether a tone of a piano would have died away by a time [s]: strike it again."""
    return time - held.start > _DECAY * 2 ** ((_DECAY_PITCH - held.pitch) / OCTAVE)


class _HandAtMoment:
    """One hand at one moment: the right hand has the melody, the left the bass."""

    def __init__(
        self, hand: int, before: Grip, moment: SongMoment, one: OneHand, classes: frozenset[int]
    ) -> None:
        inwards = -1 if hand == RIGHT else 1  # so that hands share the notes that begin
        written, late = moment.harmony[::inwards], moment.sounding[::inwards]
        new = [n for n in (*written, *late) if n.pitch % OCTAVE not in classes]
        self._harmony = [*new, *(n for n in written if n.pitch % OCTAVE in classes)]
        self._hand, self._before, self._moment, self._one = hand, before, moment, one
        self._held = before.still_held(moment.time)
        self._own = moment.melody if hand == RIGHT else moment.bass

    def actions(self) -> Iterator[Action]:
        """Yield all actions for which the hand has time, first to strike nothing."""
        yield Action(self._before._replace(held=tuple(self._held)), (), (), 0.0)
        if self._one.is_there:
            for struck in self._choices():
                action = self._action(struck)
                if action is not None:
                    yield action

    def _choices(self) -> Iterator[tuple[Struck, ...]]:
        """Yield notes to strike at once: melody or bass, with more or less of the harmony."""
        own = [self._strike(note) for note in self._own]
        bases: list[tuple[Struck, ...]] = [()]
        bases += [tuple(own[:1])] if own else []
        if len(own) > 1:
            bases.append(tuple(own))
        if own and self._hand == LEFT:
            bases.append((self._strike(self._own[0], OCTAVE),))
        for base in bases:
            yield from self._with_harmony(base)

    def _strike(self, note: SourceNote, shift: int = 0) -> Struck:
        return Struck(self._moment.time, note, note.pitch + shift)

    def _with_harmony(self, base: tuple[Struck, ...]) -> Iterator[tuple[Struck, ...]]:
        """Yield `base` with none, one or more of the harmony, as far as the hand reaches."""
        struck, pitches = base, tuple(sorted(each.pitch for each in base))
        if base:
            if not self._one.fits(pitches):
                return
            yield base
        for note in self._harmony:
            if len(struck) - len(base) == _MAX_HARMONY:
                return
            shift = self._shift(note, pitches)
            if shift is not None:
                struck = (*struck, self._strike(note, shift))
                pitches = tuple(sorted((*pitches, note.pitch + shift)))
                yield struck

    def _shift(self, note: SourceNote, pitches: tuple[int, ...]) -> int | None:
        """The octaves by which a note is moved so that the hand strikes it with these pitches.

        A note that is moved stays below the melody, and above the bass.
        """
        around = pitches or self._held
        for shift in _SHIFTS if around else _SHIFTS[:1]:
            pitch = note.pitch + shift
            if pitch in pitches:
                return None
            inside = self._moment.floor < pitch < self._moment.ceiling
            if (not shift or inside) and self._one.fits(tuple(sorted((*pitches, pitch)))):
                return shift
        return None

    def _action(self, struck: tuple[Struck, ...]) -> Action | None:
        """The action that strikes these notes; None if the hand has no time for it."""
        time, before = self._moment.time, self._before
        pitches = tuple(sorted(each.pitch for each in struck))
        kept = self._kept(pitches)
        elapsed, jump = time - before.time, 0.0
        if before.struck:
            jump = self._one.jump_time(before.struck, pitches, bool(kept))
            repeats = elapsed < _MIN_REPETITION and not set(before.struck).isdisjoint(pitches)
            if repeats or jump > elapsed - _MIN_HELD:
                return None
        cost = _HASTE * (jump / elapsed) ** 2
        cost += _BUSY_COST * (len(struck) - 1) * min(_BUSY / elapsed, 1.0)
        early = list(self._left_early(kept, time - jump))
        cost += sum(self._early_cost(held, end) for held, end in early)
        early_ends = tuple(held._replace(end=end) for held, end in early)
        new = (Held(s.pitch, time, s.end, s.source.melody) for s in struck)
        hand = Grip(tuple(sorted((*kept, *new))), pitches, time)
        return Action(hand, struck, early_ends, cost)

    def _kept(self, pitches: tuple[int, ...]) -> list[Held]:
        """The keys that the hand can go on to hold while it strikes these pitches."""
        kept = [held for held in self._held if held.pitch not in pitches]
        while kept and not self._one.fits(tuple(sorted((*pitches, *(h.pitch for h in kept))))):
            kept.remove(min(kept, key=lambda held: (held.melody, held.end)))
        return kept

    def _left_early(self, kept: list[Held], leave: float) -> Iterator[tuple[Held, float]]:
        """Yield keys that are not kept and left too early, each with its new end [s]."""
        for held in self._before.held:
            if held not in kept and held.end > leave:
                yield held, max(leave, held.start + MIN_LENGTH)

    def _early_cost(self, held: Held, end: float) -> float:
        """The cost of leaving a key before its note is over."""
        weight = _EARLY_MELODY if held.melody else _EARLY
        return weight * max(held.end - end, 0.0) / (held.end - held.start)
