"""The voices of a staff: at most two, in each of which one chord follows the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cadenza.music.notation.metre import QUARTER
from cadenza.music.score import Note, chords

UPPER, LOWER = 0, 1
_LEGATO = QUARTER / 6  # by which a chord may overlap the next: players connect them so
_MOST_LOST = 2 * QUARTER  # of a note that is cut; what is more costs no more
_SECOND = 0.35 * QUARTER  # cost of a chord that is shared by both voices
_ALONE = 0.15 * QUARTER  # cost of a chord in the lower voice while the upper rests
_CROSSED = 0.5 * QUARTER  # cost of a note on the wrong side of the other voice
_UNEVEN = 0.5  # cost of a tick by which a note is written longer than it is
_KEPT = 12  # best histories that are followed


class _Voice(NamedTuple):
    """The latest chord of a voice: the ends of its notes [ticks], its lowest and highest pitch."""

    ends: tuple[float, ...] = ()
    low: int = 0
    high: int = 0

    @property
    def end(self) -> float:
        return max(self.ends, default=float("-inf"))

    def lost(self, onset: float) -> float:
        """The cost of ending at `onset`."""
        cut = (end - onset for end in self.ends)
        return sum(min(length, _MOST_LOST) for length in cut if length > _LEGATO)


class _History(NamedTuple):
    cost: float
    voices: tuple[_Voice, _Voice]
    path: tuple  # type: ignore[type-arg]  # linked: (notes of the upper voice, path before)


class Timed(NamedTuple):
    """A note with its onset and its end in ticks, with fractions."""

    note: Note
    onset: float
    end: float


def voices(timed: Sequence[Timed]) -> list[int]:
    """The voice of each of the notes of a staff, by start.

    Of every chord the highest notes go to the upper voice and the others to the lower, so that
    little is cut of held notes, voices rarely cross, and most is written in one voice. The best
    division is found by a beam search.
    """
    histories = [_History(0.0, (_Voice(), _Voice()), ())]
    by_note = {id(each.note): each for each in timed}
    groups = []
    for group in chords([each.note for each in timed]):
        chord = sorted((by_note[id(note)] for note in group), key=lambda each: -each.note.pitch)
        groups.append(group)
        onset = min(each.onset for each in chord)
        lone = all(voice.end <= onset + _LEGATO for voice in histories[0].voices)
        even = max(e.end for e in chord) - min(e.end for e in chord) <= _LEGATO
        if lone and even:  # the usual case: nothing to be divided
            splits: Sequence[int] = (len(chord),)
        else:
            splits = range(len(chord) + 1)
        found = [
            _continued(history, chord, onset, split) for history in histories for split in splits
        ]
        found.sort(key=lambda history: history.cost)
        histories = found[:_KEPT]
    path, counts = histories[0].path, []
    while path:
        count, path = path
        counts.append(count)
    chosen = []
    for group, count in zip(groups, reversed(counts), strict=True):
        order = sorted(range(len(group)), key=lambda i: -group[i].pitch)
        upper = set(order[:count])
        chosen += [UPPER if i in upper else LOWER for i in range(len(group))]
    return chosen


def _continued(history: _History, chord: list[Timed], onset: float, split: int) -> _History:
    upper, lower = history.voices
    cost = history.cost
    parts = chord[:split], chord[split:]
    latest = list(history.voices)
    for voice, part in enumerate(parts):
        if not part:
            continue
        before = latest[voice]
        end = max(each.end for each in part)
        cost += before.lost(onset)
        cost += _UNEVEN * sum(
            min(end - each.end, _MOST_LOST) for each in part if end - each.end > _LEGATO
        )
        latest[voice] = _Voice(
            tuple(each.end for each in part), part[-1].note.pitch, part[0].note.pitch
        )
    if parts[UPPER] and parts[LOWER]:
        cost += _SECOND
    elif parts[LOWER]:
        if upper.end <= onset + _LEGATO:
            cost += _ALONE
        elif parts[LOWER][0].note.pitch > upper.low:
            cost += _CROSSED
    elif lower.end > onset + _LEGATO and parts[UPPER][-1].note.pitch < lower.high:
        cost += _CROSSED
    return _History(cost, (latest[UPPER], latest[LOWER]), (split, history.path))
