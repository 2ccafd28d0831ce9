"""The staff of each note, and its voice on it: at most two, each with one chord after the other.

A staff is that of the hand of the finger, or for which a note is written, or by pitch. The upper
and the lower one are numbered as hands are, `RIGHT` and `LEFT`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cadenza.fingers import LEFT, RIGHT
from cadenza.music.notation.metre import QUARTER
from cadenza.music.score import Note, chords
from cadenza.music.viterbi import cheapest_sequence

UPPER, LOWER = 0, 1
_LEGATO = QUARTER / 6  # ticks by which a chord may overlap the next: players connect them so
_ROUNDING = QUARTER / 32  # the same where nobody has played
_MAX_LOST = 2 * QUARTER  # the greatest cost of cutting a note
_SECOND = 0.35 * QUARTER  # cost of a chord that is shared by both voices
_ALONE = 0.15 * QUARTER  # cost of a chord in the lower voice while the upper rests
_CROSSED = 0.5 * QUARTER  # cost of a note on the wrong side of the other voice
_UNEVEN = 0.5  # cost of a tick by which a note is written longer than it is
_KEPT = 8  # width of the beam search


class _LatestChord(NamedTuple):
    """The latest chord of a voice: the ends of its notes [ticks], its lowest and highest pitch."""

    ends: tuple[float, ...] = ()
    low: int = 0
    high: int = 0

    @property
    def end(self) -> float:
        return max(self.ends, default=float("-inf"))

    def lost(self, onset: float, legato: float) -> float:
        """The cost of ending at `onset`."""
        overlaps = (end - onset for end in self.ends)
        return sum(min(length, _MAX_LOST) for length in overlaps if length > legato)


class _History(NamedTuple):
    cost: float
    voices: tuple[_LatestChord, _LatestChord]
    path: tuple[Any, ...]  # linked: how many notes the upper voice has, and the path before


class Timed(NamedTuple):
    """A note with its onset and its end in ticks, with fractions."""

    note: Note
    onset: float
    end: float


def voices(timed: Sequence[Timed], is_exact: bool) -> list[int]:
    """The voice of each of the notes of a staff, by start.

    The highest notes of every chord go to the upper voice and the others to the lower. A beam
    search finds divisions that cut little of held notes, let voices rarely cross, and use mostly
    one voice. Unless the notes are `is_exact`, they may overlap a little.
    """
    histories = [_History(0.0, (_LatestChord(), _LatestChord()), ())]
    groups = list(chords(timed, start=lambda each: each.note.start))
    for group in groups:
        chord = sorted(group, key=lambda each: -each.note.pitch)
        histories = _continued(histories, chord, _ROUNDING if is_exact else _LEGATO)
    path, counts = histories[0].path, []
    while path:
        count, path = path
        counts.append(count)
    chosen = []
    for group, count in zip(groups, reversed(counts), strict=True):
        order = sorted(range(len(group)), key=lambda i: -group[i].note.pitch)
        upper = set(order[:count])
        chosen += [UPPER if i in upper else LOWER for i in range(len(group))]
    return chosen


def _continued(histories: list[_History], chord: list[Timed], legato: float) -> list[_History]:
    """The best histories with `chord`, from the highest note down, one for each pair of voices."""
    onset = min(each.onset for each in chord)
    parts = [(chord[:count], chord[count:]) for count in range(len(chord) + 1)]
    ends = [each.end for each in chord]
    is_free = all(voice.end <= onset + legato for each in histories for voice in each.voices)
    if is_free and max(ends) - min(ends) <= legato:  # the usual case: nothing to be divided
        parts = parts[-1:]
    latest = [
        tuple((_latest_chord(part), _uneven(part, legato)) for part in pair) for pair in parts
    ]
    best: dict[tuple[_LatestChord, _LatestChord], _History] = {}
    for history in histories:
        lost = [voice.lost(onset, legato) for voice in history.voices]
        for (upper, lower), ((high, rough), (low, rougher)) in zip(parts, latest, strict=True):
            cost = history.cost + rough + rougher + _crossing(history, upper, lower, onset + legato)
            cost += (lost[UPPER] if upper else 0.0) + (lost[LOWER] if lower else 0.0)
            pair_of_voices = high or history.voices[UPPER], low or history.voices[LOWER]
            if pair_of_voices not in best or cost < best[pair_of_voices].cost:
                best[pair_of_voices] = _History(cost, pair_of_voices, (len(upper), history.path))
    return sorted(best.values(), key=lambda history: history.cost)[:_KEPT]


def _latest_chord(part: list[Timed]) -> _LatestChord | None:
    if not part:
        return None
    return _LatestChord(tuple(each.end for each in part), part[-1].note.pitch, part[0].note.pitch)


def _uneven(part: list[Timed], legato: float) -> float:
    """The cost of writing the notes of a chord as long as the longest."""
    end = max((each.end for each in part), default=0.0)
    gaps = (end - each.end for each in part)
    return _UNEVEN * sum(min(gap, _MAX_LOST) for gap in gaps if gap > legato)


def _crossing(history: _History, upper: list[Timed], lower: list[Timed], onset: float) -> float:
    """The cost of a second voice, or of one that crosses the other."""
    high, low = history.voices
    if upper and lower:
        return _SECOND
    if lower:
        if high.end <= onset:
            return _ALONE
        return _CROSSED if lower[0].note.pitch > high.low else 0.0
    is_below = low.end > onset and upper[-1].note.pitch < low.high
    return _CROSSED if is_below else 0.0


_SPLITS = np.arange(43, 80)  # lowest pitch of the right hand, G2 to G5
_MIDDLE = 60  # the usual split, C4
_SPAN = 12  # semitones that a hand plays at once with ease
_TOO_WIDE = 2.0  # cost of each semitone beyond that
_MOVE = 0.15  # cost of moving the split by a semitone
_FAR = 0.01  # cost of each semitone of the split from the middle
_CLOSE = 0.1  # cost of each semitone by which a split leaves less than `_ROOM` between hands
_ROOM = 5  # semitones


def staves(notes: Sequence[Note]) -> list[int]:
    """The staff of each of the `notes`, by start.

    Notes without a finger or a hand are split at a pitch that moves as little as it can while each
    hand spans about an octave at most, found by dynamic programming over chords.
    """
    hands = [(note.finger.hand,) if note.finger else note.hands for note in notes]
    chosen = [hand[0] if hand else RIGHT for hand in hands]
    loose = [i for i, hand in enumerate(hands) if len(hand) != 1]
    if not loose:
        return chosen
    groups = list(chords(loose, start=lambda i: notes[i].start))
    costs = [_cost(np.array([notes[i].pitch for i in group])) for group in groups]
    move = _MOVE * np.abs(_SPLITS[:, None] - _SPLITS)
    splits = _SPLITS[cheapest_sequence(costs, [move] * (len(groups) - 1))].tolist()
    for group, split in zip(groups, splits, strict=True):
        for i in group:
            chosen[i] = RIGHT if notes[i].pitch >= split else LEFT
    return chosen


def _cost(pitches: np.ndarray) -> np.ndarray:
    """The cost of each split for a chord."""
    upper = pitches >= _SPLITS[:, None]
    high, low = np.where(upper, pitches, np.inf), np.where(upper, -np.inf, pitches)
    right = np.where(upper.any(1), pitches.max() - high.min(1), 0)
    left = np.where((~upper).any(1), low.max(1) - pitches.min(), 0)
    wide = np.maximum(right - _SPAN, 0) + np.maximum(left - _SPAN, 0)
    gap = np.abs(pitches - (_SPLITS[:, None] - 0.5)).min(1)
    close = np.maximum(_ROOM / 2 - gap, 0)
    return np.asarray(_TOO_WIDE * wide + _CLOSE * close + _FAR * np.abs(_SPLITS - _MIDDLE))
