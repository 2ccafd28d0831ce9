"""Reads the PIG dataset as its authors ship it, and makes a library of it.

`List.csv` has a line a piece, with its number, composer and title. A file in `FingeringFiles`, such
as `012-1_fingering.txt`, has the notes of piece 12 with the fingers of annotator 1; of several
annotators the first is taken. Its lines have eight columns: number of the note, onset [s], offset
[s], pitch such as C#4 or Ebb3, velocity at the onset and at the offset, channel (0 right hand, 1
left), finger (1 to 5 right, -1 to -5 left; 4_1 changes from the fourth to the first, and the fourth
is taken). From // on, a line is a comment.
"""

from __future__ import annotations

import io
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from zipfile import ZipFile

from cadenza.configs import MAX_COUNT
from cadenza.errors import CadenzaError, errors_in, quoted, shortened
from cadenza.files import files_in, number_in, opened, opened_archive, unpacked, whole_number_in
from cadenza.fingers import Finger
from cadenza.music.formats.fingering_file import SUFFIX, write_fingering
from cadenza.music.formats.midi import write_midi
from cadenza.music.formats.source import MAX_BYTES, decoded, read_bytes
from cadenza.music.formats.titles import printable
from cadenza.music.libraries.folder import short, unique
from cadenza.music.libraries.imported import Grade, NewLibrary, Progress, new_library, silent
from cadenza.music.libraries.index import read_table
from cadenza.music.libraries.pig import ALL, WEBSITE, published_name
from cadenza.music.repair import RawNote, repaired_notes
from cadenza.music.score import (
    LOUDEST,
    MAX_SECONDS,
    NATURALS,
    OCTAVE,
    PITCHES,
    SOFTEST,
    STEPS,
    Score,
)

_LIST, _FINGERINGS = "list.csv", "FingeringFiles"
_FILE = re.compile(r"(\d{1,6})-(\d{1,6})_fingering\.txt", re.ASCII)
_DEEPEST = 3  # folders from the one that is given down to the files

_PITCH = re.compile(r"([A-G])(##|#|x|bb|b|)(\d)", re.ASCII)
_FINGER = re.compile(r"(-?)([1-5])(_(-?[1-5])?)*", re.ASCII)
_ACCIDENTALS = {"": 0, "#": 1, "##": 2, "x": 2, "b": -1, "bb": -2}
_COLUMNS = "number, onset, offset, pitch, two velocities, channel, finger"
_MAX_NAMED = 10  # other lines of a file that are wrong

_Files = Mapping[PurePosixPath, Callable[[], bytes]]
"""Path of a file within the dataset -> function that reads it."""


def import_pig(
    source: Path, replace: bool = False, progress: Progress = silent, grade: Grade | None = None
) -> NewLibrary:
    """Imports the dataset as the library `repertoire-150`; damaged pieces are left out.

    The source is its folder, or the ZIP file, as downloaded. `progress` is called with the number
    of pieces read, and of all; for the rest see `new_library`.

    Raises:
        CadenzaError: it is not the dataset, nothing in it can be read, or it was imported before.
    """
    with _files(source) as files, new_library(ALL, replace, grade) as library:
        list_file = _list_file(files, source)
        pieces = _pieces(files[list_file](), f"{source}/{list_file}", library.left_out)
        fingered = _first_fingerings(files, list_file.parent)
        names = unique(short(published_name(piece.title)) for piece in pieces)
        for done, (piece, name) in enumerate(zip(pieces, names, strict=True)):
            progress(done, len(pieces))
            with library.leaving_out_what_is_wrong(piece.where):
                file = fingered.pop(piece.number, None)
                if file is None:
                    raise CadenzaError(
                        f"{piece.where}: no file of fingers for {quoted(piece.title)}"
                    )
                _add(library, name, piece, files[file], f"{source}/{file}")
        for file in fingered.values():
            library.left_out.append(f"{source}/{file}: there is no such piece in {list_file.name}")
    return library


class _Piece(NamedTuple):
    where: str
    """The file of the list, and the line in it."""
    number: int
    title: str
    composer: str


def _add(
    library: NewLibrary, name: str, piece: _Piece, read: Callable[[], bytes], where: str
) -> None:
    score = replace(read_fingered(read(), where), title=piece.title)
    path = library.folder / f"{name}.mid"
    write_midi(score, path)
    write_fingering(score, path.with_suffix(SUFFIX))
    source = f"PIG {piece.number:03d}"
    facts = {"title": piece.title, "composer": piece.composer, "source": source}
    library.add(path.name, score, facts)
    library.doubtful.extend(score.remarks)


# The files of the dataset


@contextmanager
def _files(source: Path) -> Iterator[_Files]:
    """Yields the files of a folder, or of a ZIP file, which is not unpacked to the disk."""
    if os.path.isdir(source):
        yield {
            PurePosixPath(path.as_posix()): partial(read_bytes, source / path)
            for path in files_in(source, _DEEPEST)
        }
        return
    with ExitStack() as stack:
        try:
            stream = stack.enter_context(opened(source))
            archive = stack.enter_context(opened_archive(stream))
        except FileNotFoundError:
            raise CadenzaError(f"{source}: there is no such folder or ZIP file") from None
        except OSError as error:
            raise CadenzaError(f"{source}: cannot be read ({error.strerror})") from error
        except CadenzaError as error:
            raise CadenzaError(f"{source}: {error}") from error
        except Exception as error:  # damage shows in many ways
            raise CadenzaError(
                f"{source}: neither a folder nor a readable ZIP file; get the dataset at {WEBSITE}"
            ) from error
        # `is_dir` fails on a member without a name.
        members = [m for m in archive.infolist() if not m.filename.endswith("/")]
        for member in members:
            path = PurePosixPath(member.filename)
            if path.is_absolute() or ".." in path.parts or "\\" in member.filename:
                raise CadenzaError(
                    f"{source}: has a file that would lie outside it, "
                    f"{quoted(member.filename)}; get the "
                    f"dataset at {WEBSITE}"
                )
        yield {
            PurePosixPath(member.filename): partial(_unpacked, archive, member.filename, source)
            for member in members
        }


def _unpacked(archive: ZipFile, member: str, source: Path) -> bytes:
    where = f"{source}/{printable(member)}"
    try:
        return unpacked(archive, member, MAX_BYTES)
    except CadenzaError as error:
        raise CadenzaError(f"{where}: {error}") from error
    except Exception as error:  # damage shows in many ways
        raise CadenzaError(f"{where}: cannot be unpacked ({shortened(str(error))})") from error


def _list_file(files: _Files, source: Path) -> PurePosixPath:
    """The list of pieces, in the fewest folders if there are several."""
    lists = [path for path in files if path.name.lower() == _LIST]
    if not lists:
        raise CadenzaError(
            f"{source}: there is no List.csv in it; give the PIG dataset as downloaded at {WEBSITE}"
        )
    return min(lists, key=lambda path: (len(path.parts), path))


def _first_fingerings(files: _Files, folder: PurePosixPath) -> dict[int, PurePosixPath]:
    """Number of a piece -> the file of its first annotator."""
    found = []
    for path in files:
        match = _FILE.fullmatch(path.name)
        if match and path.parent == folder / _FINGERINGS:
            found.append((int(match[1]), int(match[2]), path))
    return {number: path for number, _, path in sorted(found, reverse=True)}


# The list of pieces


def _pieces(content: bytes, where: str, left_out: list[str]) -> list[_Piece]:
    """The pieces in `List.csv`; lines that name none are added to `left_out`.

    Raises:
        CadenzaError: it is no table, or there is no column of titles.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:  # as spreadsheets may save it
        text = content.decode("cp1252", errors="replace")
    header, rows = read_table(text, where, strict=False)
    titles = next((name for name in ("piece", "title") if name in header), None)
    if titles is None:
        raise CadenzaError(f"{where}:1: there is no column Piece or Title, which has the titles")
    column = "id" if "id" in header else header[0]
    pieces: dict[int, _Piece] = {}
    for line, cells in rows:
        title = printable(cells.get(titles, ""))
        try:
            number = whole_number_in(cells.get(column, ""), "number of a piece", 0, MAX_COUNT)
        except CadenzaError as error:
            left_out.append(f"{where}:{line}: {error}")
            continue
        if not title:
            left_out.append(f"{where}:{line}: piece {number} has no title")
        elif number in pieces:
            left_out.append(f"{where}:{line}: a second line for piece {number}")
        else:
            composer = printable(cells.get("composer", ""))
            pieces[number] = _Piece(f"{where}:{line}", number, title, composer)
    return list(pieces.values())


# The files of notes


def read_fingered(content: bytes, where: str) -> Score:
    """The notes in a file, with their fingers; `Score.remarks` says what looks wrong.

    What cannot be played on one piano is repaired as by `read_midi`, and a remark, too. Errors call
    the file `where`, with the number of a line.

    Raises:
        CadenzaError: it is no text or has no notes, it lasts over an hour, or a line is wrong.
    """
    notes: list[RawNote] = []
    ids: dict[int, int] = {}  # where the notes stand
    wrong: dict[int, str] = {}
    other_hand: list[int] = []
    lines = io.StringIO(decoded(content, where), newline=None)
    for number, line in enumerate(lines, start=1):
        said = line.partition("//")[0]
        if not said.strip():
            continue
        try:
            id_, note, channel = _note(said)
        except CadenzaError as error:
            wrong[number] = str(error)
            continue
        if id_ in ids:
            wrong[number] = f"note {id_} stands in line {ids[id_]} already"
        ids.setdefault(id_, number)
        notes.append(note)
        if note.finger and note.finger.hand != channel:
            other_hand.append(number)
    if wrong:
        first, *others = wrong
        raise CadenzaError(f"{where}:{first}: {wrong[first]}{_and_lines(others)}")
    doubts = []
    if other_hand:
        first, *others = other_hand
        doubts = [
            f"{where}:{first}: channel and finger are of different hands, the finger is taken"
            f"{_and_lines(others)}"
        ]
    with errors_in(where):
        playing, repairs = repaired_notes(notes, Counter(), ())
    return Score(playing, remarks=(*doubts, *(f"{where}: {repair}" for repair in repairs)))


def _note(line: str) -> tuple[int, RawNote, int]:
    """The number of a line's note, the note, and its channel.

    Raises:
        CadenzaError: it is wrong.
    """
    cells = line.split()
    if len(cells) != 8:
        raise CadenzaError(f"{len(cells)} columns; expected eight: {_COLUMNS}")
    id_, onset, offset, pitch, loud, release, channel, finger = cells
    number = whole_number_in(id_, "the number of the note", 0, MAX_COUNT)
    start, end = (
        number_in(text, f"{what} [s]", 0, MAX_SECONDS)
        for what, text in (("onset", onset), ("offset", offset))
    )
    if end < start:
        raise CadenzaError(f"offset {end:g} is before onset {start:g}")
    if channel not in ("0", "1"):
        raise CadenzaError(
            f"channel {quoted(channel)}; expected 0 for the right hand or 1 for the left"
        )
    velocity = whole_number_in(loud, "onset velocity", SOFTEST, LOUDEST)
    whole_number_in(release, "offset velocity", 0, LOUDEST)
    note = RawNote(start, end, _pitch(pitch), velocity, True, _finger(finger))
    return number, note, int(channel)


def _pitch(text: str) -> int:
    """The MIDI number of a spelled pitch, in which middle C is C4 and the B below it Cb4."""
    match = _PITCH.fullmatch(text)
    if not match:
        raise CadenzaError(f"pitch {quoted(text)}; expected one such as C4, F#4, Bb3 or Abb5")
    pitch = OCTAVE * (int(match[3]) + 1) + NATURALS[STEPS.index(match[1])] + _ACCIDENTALS[match[2]]
    if pitch not in PITCHES:
        raise CadenzaError(f"pitch {text} is outside the piano's 88 keys, A0 to C8")
    return pitch


def _finger(text: str) -> Finger:
    match = _FINGER.fullmatch(text)
    if not match:
        raise CadenzaError(
            f"finger {quoted(text)}; expected 1 to 5, -1 to -5, or several such as 4_1"
        )
    return Finger(hand=1 if match[1] else 0, index=int(match[2]) - 1)


def _and_lines(numbers: list[int]) -> str:
    """The end of an error that names the other lines, if any."""
    if not numbers:
        return ""
    named = ", ".join(map(str, numbers[:_MAX_NAMED]))
    more = f" and {len(numbers) - _MAX_NAMED} more" if len(numbers) > _MAX_NAMED else ""
    return f"; also wrong: line{'s' * (len(numbers) > 1)} {named}{more}"
