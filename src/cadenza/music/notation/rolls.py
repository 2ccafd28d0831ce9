"""Rolled chords: notes that begin shortly one after the other, and go on sounding together."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from cadenza.music.notation.metre import QUARTER
from cadenza.music.notation.voices import Timed
from cadenza.music.score import CHORD_TOLERANCE

_MIN_STEP, _MAX_STEP = 0.02, 0.08  # [s] from a note of a rolled chord to the next
_MAX_LENGTH = 0.4  # [s] from the first to the last
_HELD = 0.1  # [s] for which all sound on after the last has begun
_MIN_NOTES = 3  # notes of a chord that has the sign for it


class Roll(NamedTuple):
    """How a note is part of a rolled chord: upwards or not, and of one hand or both."""

    is_up: bool
    of_both: bool


def unrolled(
    timed: Sequence[Timed], hands: Sequence[int], is_free: Sequence[bool]
) -> tuple[list[Timed], dict[int, Roll]]:
    """The notes, by start, with one onset for each rolled chord, and the rolls by ids of notes.

    `hands` play the notes. The onset is that of the first or the last note of the chord, whichever
    is nearer to a beat or half a beat. Chords without an `is_free` note do not move.
    """
    together, rolls, arpeggiated = list(timed), dict[int, Roll](), set[int]()
    for side in (None, *sorted(set(hands))):  # first chords of both hands
        remaining = [
            i for i, hand in enumerate(hands) if side in (None, hand) and i not in arpeggiated
        ]
        for chord in _runs(remaining, timed):
            notes = [timed[i] for i in chord]
            of_both = len({hands[i] for i in chord}) > 1
            is_free_roll = _is_roll(notes, of_both) and any(is_free[i] for i in chord)
            if not is_free_roll or of_both != (side is None):
                continue
            onset = min((notes[0].onset, notes[-1].onset), key=_off_beat)
            arpeggiated.update(chord)
            for i in chord:
                together[i] = timed[i]._replace(onset=onset)
                if len(chord) >= _MIN_NOTES:
                    is_up = notes[-1].note.pitch > notes[0].note.pitch
                    rolls[id(timed[i].note)] = Roll(is_up, of_both)
    return together, rolls


def _runs(indices: Sequence[int], timed: Sequence[Timed]) -> Iterator[list[int]]:
    """Yield notes that follow each other upwards or downwards, and sound together at last."""
    run: list[int] = []
    for i in indices:
        if run and not _goes_on([timed[k] for k in run], timed[i]):
            yield run
            run = []
        run.append(i)
    if run:
        yield run


def _goes_on(run: Sequence[Timed], following: Timed) -> bool:
    note, last = following.note, run[-1].note
    if note.pitch == last.pitch or note.start - last.start > _MAX_STEP:
        return False
    if len(run) > 1 and (note.pitch > last.pitch) != (last.pitch > run[-2].note.pitch):
        return False
    is_held = min(note.end, *(each.note.end for each in run)) >= note.start + _HELD
    return is_held and note.start - run[0].note.start <= _MAX_LENGTH


def _is_roll(run: Sequence[Timed], of_both: bool) -> bool:
    """Whether notes are rolled, and not a chord, or one of a hand after one of the other."""
    starts = [each.note.start for each in run]
    if of_both:
        steps = (b - a for a, b in pairwise(starts))
        return len(run) >= _MIN_NOTES and min(steps) >= _MIN_STEP
    return starts[-1] - starts[0] > CHORD_TOLERANCE


def _off_beat(onset: float) -> float:
    """How far an onset is from a beat, or half of one [ticks]."""
    half = QUARTER / 2
    return abs(onset - round(onset / half) * half)
