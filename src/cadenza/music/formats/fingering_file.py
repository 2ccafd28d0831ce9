"""The fingering of a MIDI file, in a small text file beside it.

MIDI has no place for fingers, so `song.mid` has its fingering in `song.fingering`, one line a note:

    # start [s]  MIDI pitch  finger
    0.0000 60 0
    0.5000 62 1    # a comment runs to the end of its line

Fingers are 0..4 for the right hand's thumb to little finger, 5..9 for the left hand's thumb to
little finger, and -1 where it is unknown; R6 is the sixth finger of a right hand that has six.
A line belongs to the note of its pitch that starts nearest to its time, at most 0.05 s away. Notes
without a line stay as they are.
"""

from bisect import bisect_left
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

from cadenza.errors import CadenzaError, errors_in, quoted
from cadenza.files import content_of, number_in, whole_number_in, write_atomically
from cadenza.fingers import Finger, finger_from, finger_number
from cadenza.music.formats.source import decoded
from cadenza.music.score import MAX_SCORE_LENGTH, MIDI_PITCHES, Score

SUFFIX = ".fingering"
_MAX_BYTES = 16 * 2**20  # bytes of half a million lines
TOLERANCE = 0.05  # [s] between a line's time and the start of its note

_HEADER = (
    "# start [s]  MIDI pitch  finger: 0-4 right thumb to little, 5-9 left thumb to little, "
    "-1 unknown\n"
)


def read_fingering(path: str | Path, score: Score, all_there: bool = True) -> Score:
    """`score` with the fingers of the file at `path`.

    Unless `all_there`, lines may belong to notes that the score has been left without. Raises
    CadenzaError if the file cannot be read, a line is malformed, belongs to no note, or gives a
    note a second, different finger; the line number is named.
    """
    path = Path(path)
    text = decoded(content_of(path, _MAX_BYTES), path)
    by_pitch: defaultdict[int, list[int]] = defaultdict(list)  # indices of notes, by start
    for index, note in enumerate(score.notes):
        by_pitch[note.pitch].append(index)
    notes = list(score.notes)
    line_of: dict[int, int] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        content = line.split("#", 1)[0].split()
        if not content:
            continue
        where = f"{path}, line {number}"
        start, pitch, finger = _parsed(content, where)
        nearest = _nearest(score, by_pitch[pitch], start)
        if nearest is None and not all_there:
            continue
        if nearest is None:
            raise CadenzaError(
                f"{where}: no note of pitch {pitch} starts within {TOLERANCE} s of {start:g} s"
            )
        if nearest in line_of and notes[nearest].finger != finger:
            raise CadenzaError(
                f"{where}: line {line_of[nearest]} gives the same note another finger; keep one"
            )
        line_of[nearest] = number
        notes[nearest] = replace(notes[nearest], finger=finger)
    return replace(score, notes=tuple(notes))


def write_fingering(score: Score, path: str | Path) -> None:
    """Write a line for every note, with -1 for an unknown finger, to be filled in."""
    lines = (
        f"{note.start:.4f} {note.pitch} {finger_number(note.finger)}\n" for note in score.notes
    )
    with write_atomically(Path(path)) as file:
        file.write((_HEADER + "".join(lines)).encode())


def _parsed(content: list[str], where: str) -> tuple[float, int, Finger | None]:
    if len(content) != 3:
        raise CadenzaError(
            f"{where}: {quoted(' '.join(content))} is not 'start pitch finger', such as '0.5 60 0'"
        )
    start, pitch, finger = content
    with errors_in(where):
        return (
            number_in(start, "start [s]", 0, MAX_SCORE_LENGTH),
            whole_number_in(pitch, "pitch", MIDI_PITCHES[0], MIDI_PITCHES[-1]),
            finger_from(finger),
        )


def _nearest(score: Score, indices: list[int], start: float) -> int | None:
    """The index, of `indices` by start, of the note nearest to `start` [s], if any is near."""
    place = bisect_left(indices, start, key=lambda i: score.notes[i].start)
    nearest = min(
        indices[max(0, place - 1) : place + 1],
        key=lambda i: abs(score.notes[i].start - start),
        default=None,
    )
    if nearest is None or abs(score.notes[nearest].start - start) > TOLERANCE:
        return None
    return nearest
