"""Arrangement of a song for the hands that are to play it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

from cadenza.arranging.fidelity import NOTHING_LOST, Fate, Fidelity, fates_of, fidelity_of
from cadenza.arranging.moments import MIN_LENGTH, SongMoment, beats_of, moments_of
from cadenza.arranging.parts import TOGETHER, sources_of
from cadenza.arranging.reduction import Held, OneHand, Struck, reduced
from cadenza.fingering.difficulty import EASIEST, FITTED, HARDEST, features_of
from cadenza.fingering.players import Players
from cadenza.fingering.search import find_fingering
from cadenza.fingers import LEFT, RIGHT, SIDES, Finger
from cadenza.hands.reach import JumpTimes
from cadenza.music.score import Note, Score, chords

# [s] in which a key comes up before it is struck again, so that a repetition is heard as one; at
# most a share of the note.
_LIFT, _LIFT_SHARE = 0.08, 0.3
_SOFTER = 0.85  # factor of velocities of the harmony: the melody is heard above it
# Costs of a note of the harmony; the smallest one that makes a song easy enough is used.
_COSTS = 0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 3.0


@dataclass(frozen=True)
class Arranged:
    """A song as it was arranged."""

    score: Score  # the notes that the hands play
    fidelity: Fidelity  # how much of the song is left
    grade: float  # the difficulty, from 1 to 10
    fates: tuple[Fate, ...] = ()  # the fate of each note of the song; notes in unison are one


class Arranger:
    """An arranger of songs for the same hands."""

    def __init__(self, players: Players, times: JumpTimes) -> None:
        """Take the hands and the times of their jumps."""
        self._players, self._times = players, times
        self._hands = OneHand(RIGHT, players, times), OneHand(LEFT, players, times)

    def arrange(self, score: Score, grade: float = HARDEST) -> Arranged:
        """The arrangement that keeps most of a song without being harder than a grade, 1 to 10.

        If even the melody and the bass are harder, they are played alone.
        """
        if not score.notes:
            return Arranged(score, NOTHING_LOST, EASIEST)
        song, beats = sources_of(score), beats_of(score)
        moments = moments_of(song, beats)

        @cache
        def arranged(cost: float) -> Arranged:
            struck, fingered = self._struck(score, moments, cost)
            held = held_as_possible(fingered, self._players, self._times)
            fates, reached = fates_of(song, struck), FITTED.grade(features_of(held))
            return Arranged(held.without_fingers(), fidelity_of(fates, held, beats), reached, fates)

        easy = (cost for cost in _COSTS if arranged(cost).grade <= grade)
        return arranged(next(easy, _COSTS[-1]))

    def _struck(
        self, score: Score, moments: Sequence[SongMoment], cost: float
    ) -> tuple[list[Struck], Score]:
        """The notes that the hands strike, the harmony at a `cost` a note, and their score."""
        struck, early_ends = reduced(moments, self._hands, cost)
        fingered, dropped = find_fingering(_score(score, struck, early_ends), self._players)
        if dropped:
            omitted = {(note.start, note.pitch) for note, _ in dropped}
            struck = [each for each in struck if (each.start, each.pitch) not in omitted]
            fingered, _ = find_fingering(_score(score, struck, early_ends), self._players)
        return struck, fingered


def _score(score: Score, struck: Iterable[Struck], early_ends: Sequence[Held]) -> Score:
    """The score of struck notes, some of which end early."""
    ends: dict[tuple[float, int], float] = {}
    for early in early_ends:
        key = early.start, early.pitch
        ends[key] = min(early.end, ends.get(key, early.end))
    by_pitch: dict[int, list[Note]] = {}
    for each in sorted(struck, key=lambda s: s.start):
        source = each.source
        end = min(each.end, ends.get((each.time, each.pitch), each.end))
        softer = _SOFTER if not source.melody and not source.bass else 1.0
        velocity = max(round(softer * source.velocity), 1)
        end = max(end, each.start + MIN_LENGTH)
        note = Note(each.start, end, each.pitch, velocity, hands=source.hands)
        same_pitch = by_pitch.setdefault(each.pitch, [])
        if same_pitch:
            same_pitch[-1] = _lifted(same_pitch[-1], note.start)
        same_pitch.append(note)
    return replace(score, notes=tuple(note for notes in by_pitch.values() for note in notes))


def _lifted(note: Note, time: float) -> Note:
    """A note that ends early enough to be struck again at a time [s]."""
    lift = min(_LIFT, _LIFT_SHARE * (time - note.start))
    return replace(note, end=min(note.end, time - lift))


_RISE = 0.05  # [s] in which a finger gets off its key
_SPARE = 0.05  # [s] since planners release notes on control steps
_MAX_JUMP = 1.0  # [s]


def held_as_possible(score: Score, players: Players, times: JumpTimes) -> Score:
    """A score with fingers, whose notes end where their hand has to go to others.

    A hand leaves its keys early enough to jump to keys beyond its reach; a finger leaves its key
    for another. Notes without a finger stay as they are.
    """
    notes = list(score.notes)
    for hand in range(len(SIDES)):
        played = [i for i, n in enumerate(notes) if n.finger is not None and n.finger.hand == hand]
        struck = list(chords(played, TOGETHER, lambda i: notes[i].start))
        _end_for_jumps(notes, struck, hand, players, times)
        _end_for_other_keys(notes, played, times)
    return replace(score, notes=tuple(notes))


def _end_for_jumps(
    notes: list[Note], struck: Sequence[list[int]], hand: int, players: Players, times: JumpTimes
) -> None:
    """End notes whose hand has to jump to the notes of the indices `struck`."""
    y, reach = players.key_y(hand), players.reach
    key = [note.pitch - players.keyboard.lowest_pitch for note in notes]
    finger = [_index(note.finger) for note in notes]

    def place(i: int) -> float:
        """The place of the forearm while a note is pressed [m]."""
        return float(y[key[i]] - reach.rest[finger[i]])

    def mean(chord: Sequence[int]) -> float:
        return sum(map(place, chord)) / len(chord)

    def spans(i: int, j: int) -> bool:
        return bool(reach.spans(finger[i], finger[j], y[key[j]] - y[key[i]]))

    held: list[int] = []
    for chord, after in pairwise(struck):
        begins = notes[after[0]].start
        held = [i for i in (*held, *chord) if notes[i].end > begins - _MAX_JUMP]
        for i in held:
            holding = notes[i].end > begins + _RISE
            from_place = place(i) if holding or i not in chord else mean(chord)
            distance = abs(mean(after) - from_place)
            jump = float(times.seconds(distance, len(chord), len(after), holding))
            if jump and not all(spans(i, j) for j in after):
                _end(notes, i, begins - jump - _SPARE)


def _end_for_other_keys(notes: list[Note], own_notes: Sequence[int], times: JumpTimes) -> None:
    """End notes whose finger presses another key next."""
    latest: dict[int, int] = {}
    for i in own_notes:
        finger = _index(notes[i].finger)
        if (previous := latest.get(finger)) is not None and notes[previous].pitch != notes[i].pitch:
            _end(notes, previous, notes[i].start - times.next_key - _SPARE)
        latest[finger] = i


def _index(finger: Finger | None) -> int:
    return finger.index if finger else 0


def _end(notes: list[Note], i: int, time: float) -> None:
    """End a note at a time, if it is later, but not before it has been heard."""
    note = notes[i]
    if note.end > time:
        notes[i] = replace(note, end=max(time, min(note.start + MIN_LENGTH, note.end)))
