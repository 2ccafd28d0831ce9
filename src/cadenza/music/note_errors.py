"""Extra and missed notes of a performance by kind, as a listener counts them."""

from collections import defaultdict
from collections.abc import Iterable
from operator import attrgetter
from typing import NamedTuple

from cadenza.music.metrics import ONSET_TOLERANCE, Pair, paired_notes, without_pairs
from cadenza.music.performance import SAME_NOTE
from cadenza.music.score import Note

BRUSHED = 0.06  # [s] than which the note of a key that a finger brushes in passing is shorter
_BESIDE = 2  # semitones from a key up to which others lie beside it
# Of a written note, how much earlier or later than it another key may sound by mistake for it [s].
_BEFORE, _AFTER = 0.15, 0.1


class ExtraNotes(NamedTuple):
    """Notes that were played for no written note, by kind."""

    # They are more than 50 ms late or early, for a written note that is missed
    off_time: list[Note]
    again: list[Note]  # their key should sound then, or just did, and was struck again
    neighbour: list[Note]  # their key lies beside one that should sound
    other: list[Note]


class MissedNotes(NamedTuple):
    """Written notes for which none was played within 50 ms, by kind."""

    off_time: list[Note]  # they were played late or early
    held: list[Note]  # their key was still down from before
    silent: list[Note]  # their key did not begin to sound


class NoteErrors(NamedTuple):
    """The notes of a performance that are right, and those that are not."""

    pairs: list[Pair]  # notes that begin within 50 ms of each other, the written one first
    extra: ExtraNotes
    missed: MissedNotes


def note_errors(written: Iterable[Note], played: Iterable[Note]) -> NoteErrors:
    """Sort the notes that are extra or missed by kind, each into the first one that it fits.

    Pairs are those of `matched_notes` within 50 ms, and of what is left, those within 200 ms are
    late or early.
    """
    written, played = (sorted(notes, key=attrgetter("start")) for notes in (written, played))
    pairs, off_time = paired_notes(written, played)
    due, sounded = _by_pitch(written), _by_pitch(played)
    missed = MissedNotes([note for note, _ in off_time], [], [])
    extra = ExtraNotes([note for _, note in off_time], [], [], [])
    written, played = without_pairs(written, played, pairs + off_time)
    for note in written:
        earlier = (n for n in sounded[note.pitch] if n.start < note.start - ONSET_TOLERANCE)
        (missed.held if _any_at(note.start, earlier) else missed.silent).append(note)
    for note in played:
        beside = range(note.pitch - _BESIDE, note.pitch + _BESIDE + 1)
        if _any_at(note.start, due[note.pitch], SAME_NOTE, SAME_NOTE):
            extra.again.append(note)
        elif any(_any_at(note.start, due[pitch], _BEFORE, _AFTER) for pitch in beside):
            extra.neighbour.append(note)
        else:
            extra.other.append(note)
    return NoteErrors(pairs, extra, missed)


def _by_pitch(notes: Iterable[Note]) -> defaultdict[int, list[Note]]:
    by_pitch = defaultdict[int, list[Note]](list)
    for note in notes:
        by_pitch[note.pitch].append(note)
    return by_pitch


def _any_at(time: float, notes: Iterable[Note], before: float = 0.0, after: float = 0.0) -> bool:
    """Whether any note sounds at a time, or from so long before to so long after it [s]."""
    return any(note.start - before <= time <= note.end + after for note in notes)
