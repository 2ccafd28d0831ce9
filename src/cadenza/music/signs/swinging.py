"""Swing: pairs of equal notes whose first is longer."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from fractions import Fraction

from cadenza.music.signs.signed_note import SignedNote
from cadenza.music.signs.tempo_marks import Swing


class SwungTimes:
    """Where notes begin and end that are to swing.

    As in MuseScore, only the middle of a pair moves, and not where shorter notes fill the pair.

    Args:
        swings: where the rhythm changes.
        notes: all notes, to know which pairs have shorter ones.
    """

    def __init__(self, swings: Iterable[Swing], notes: Iterable[SignedNote]) -> None:
        self._swings = sorted(swings, key=lambda swing: swing.onset)
        self._filled: set[tuple[int, str, Fraction]] = set()
        for note in notes:
            swing = self._at(note.onset)
            if swing is not None and note.grace is None and note.duration < swing.unit:
                self._filled.add((note.part, note.voice, _pair(swing, note.onset)))

    def moved(self, note: SignedNote, place: Fraction) -> Fraction:
        """The place [quarters] where a note begins or ends that is written at `place`."""
        swing = self._at(place)
        if swing is None or swing.first == swing.second:
            return place
        begin = _pair(swing, place)
        if place - begin != swing.unit or (note.part, note.voice, begin) in self._filled:
            return place
        return begin + 2 * swing.unit * Fraction(swing.first, swing.first + swing.second)

    def _at(self, place: Fraction) -> Swing | None:
        index = bisect_right(self._swings, place, key=lambda swing: swing.onset)
        return self._swings[index - 1] if index else None


def _pair(swing: Swing, place: Fraction) -> Fraction:
    """The beginning of the pair in which a place lies."""
    pair = 2 * swing.unit
    return swing.beat + (place - swing.beat) // pair * pair
