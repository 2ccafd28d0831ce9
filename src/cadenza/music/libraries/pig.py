"""The PIG dataset of piano fingerings, which its authors do not allow to be passed on.

The published benchmark plays it: all of it as `repertoire-150`, and twelve pieces as `etude-12`.

`List.csv` has a line a piece, with its number, composer and title. A file in `FingeringFiles`, such
as `012-1_fingering.txt`, has the notes of piece 12 with the fingers of annotator 1; of several
annotators the first is taken. Its lines have eight columns: number of the note, onset [s], offset
[s], pitch such as C#4 or Ebb3, velocity at the onset and at the offset, channel (0 right hand, 1
left), finger (1 to 5 right, -1 to -5 left; 4_1 changes from the fourth to the first, and the fourth
is taken). From // on, a line is a comment.
"""

import io
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from zipfile import ZipFile

from cadenza.configs import MAX_COUNT
from cadenza.errors import CadenzaError, errors_in, is_full, quoted
from cadenza.files import files_in, number_in, opened, whole_number_in
from cadenza.fingers import Finger
from cadenza.music.formats.fingering_file import SUFFIX, write_fingering
from cadenza.music.formats.midi import write_midi
from cadenza.music.formats.source import decoded, printable, read_bytes
from cadenza.music.libraries.folder import short, unique
from cadenza.music.libraries.imported import (
    Grade,
    NewLibrary,
    Progress,
    imported,
    is_imported,
    new_library,
    silent,
)
from cadenza.music.libraries.index import read_table
from cadenza.music.libraries.songs import Library, Song
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

ALL = "repertoire-150"
TWELVE = "etude-12"
WEBSITE = "https://beam.kisarazu.ac.jp/~saito/research/PianoFingeringDataset/"
_ETUDES = (
    "French Suite No. 1 Allemande",
    "French Suite No. 5 Sarabande",
    "Piano Sonata D. 845 1st mov.",
    "Partita No. 2 (6)",
    "Waltz Op. 64 No. 1",
    "Bagatelle Op. 3 No. 4",
    "Kreisleriana Op. 16 No. 8",
    "French Suite No. 5 Gavotte",
    "Piano Sonata No. 23 2nd mov.",
    "Golliwogg's Cakewalk",
    "Piano Sonata No. 2 1st mov.",
    "Piano Sonata K. 279 1st mov.",
)
_UNSAID = re.compile(r"\bin [a-h]\b([ -]?(flat|sharp))?( (major|minor))?|\b(no|mov|movement|mvt)\b")


def repertoire_150() -> Library:
    """The pieces of the dataset. Raises CadenzaError if the dataset has not been imported."""
    if not is_imported(ALL):
        raise CadenzaError(
            f"{ALL} and {TWELVE} are made of the PIG dataset, which may not be passed on: register "
            f"at {WEBSITE}, download it, and run `cadenza import pig FILE.zip`"
        )
    return imported(ALL)


def etude_12() -> Library:
    """Twelve pieces of the dataset, in the order of the published benchmark.

    Raises CadenzaError if the dataset has not been imported, or has none of them.
    """
    songs = etudes_among(repertoire_150().songs)
    if not songs:
        raise CadenzaError(
            f"{TWELVE}: none of its pieces is in {ALL}; import all of the PIG dataset, with "
            "`cadenza import pig FILE.zip --replace`"
        )
    return Library(TWELVE, tuple(replace(s, name=s.name.replace(ALL, TWELVE, 1)) for s in songs))


def etudes_among(songs: Sequence[Song]) -> tuple[Song, ...]:
    """The songs that are among the twelve etudes, by their titles."""
    by_work = {_work(song.title): song for song in reversed(songs)}
    return tuple(by_work[work] for work in map(_work, _ETUDES) if work in by_work)


def published_name(title: str) -> str:
    """The name of a piece in the published benchmark, such as PianoSonataD8451StMov."""
    words = re.sub(r"[\W_]+", " ", re.sub("[.,'’]", "", title))
    return words.title().replace(" ", "") or "Piece"


def _work(title: str) -> str:
    """The words and numbers of a title without "in C", "no.", "mov.": equal for equal works."""
    plain = unicodedata.normalize("NFKD", title).lower().replace("'", "").replace("’", "")
    words = " ".join(re.findall(r"[a-z]+|\d+", plain))
    return " ".join(_UNSAID.sub("", words).split())


_LIST, _FINGERINGS = "list.csv", "FingeringFiles"
_FILE = re.compile(r"(\d{1,6})-(\d{1,6})_fingering\.txt", re.ASCII)
_MAX_UNPACKED = 256 * 2**20  # bytes, many times the dataset

_PITCH = re.compile(r"([A-G])(##|#|x|bb|b|)(\d)", re.ASCII)
_FINGER = re.compile(r"(-?)([1-5])(_(-?[1-5])?)*", re.ASCII)
_ACCIDENTALS = {"": 0, "#": 1, "##": 2, "x": 2, "b": -1, "bb": -2}
_COLUMNS = "number, onset, offset, pitch, two velocities, channel, finger"


def import_pig(
    source: Path, replace: bool = False, progress: Progress = silent, grade: Grade | None = None
) -> NewLibrary:
    """Import the dataset as the library `repertoire-150`; damaged pieces are left out.

    The source is its folder, or the ZIP file, as downloaded. `progress` is called with the number
    of pieces read, and of all; for the rest see `new_library`. Raises CadenzaError if it is not the
    dataset, nothing in it can be read, or it was imported before.
    """
    with _folder_of(source) as folder, new_library(ALL, replace, grade) as library:
        files = list(files_in(folder))
        list_file = _list_file(files, source)
        content = read_bytes(folder / list_file)
        pieces = _pieces(content, f"{source}/{list_file}", library.left_out)
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
                _add(library, name, piece, read_bytes(folder / file), f"{source}/{file}")
        for file in fingered.values():
            library.left_out.append(f"{source}/{file}: there is no such piece in {list_file.name}")
    return library


class _ListedPiece(NamedTuple):
    where: str  # the file of the list, and the line in it
    number: int
    title: str
    composer: str


def _add(library: NewLibrary, name: str, piece: _ListedPiece, content: bytes, where: str) -> None:
    score = replace(read_fingered(content, where), title=piece.title)
    path = library.folder / f"{name}.mid"
    write_midi(score, path)
    write_fingering(score, path.with_suffix(SUFFIX))
    source = f"PIG {piece.number:03d}"
    facts = {"title": piece.title, "composer": piece.composer, "source": source}
    library.add(path.name, score, facts)
    library.doubtful.extend(score.remarks)


# The files of the dataset


@contextmanager
def _folder_of(source: Path) -> Iterator[Path]:
    """Yield the folder of the dataset, into which a ZIP file is unpacked for the block."""
    if os.path.isdir(source):
        yield source
        return
    with TemporaryDirectory() as folder:
        try:
            with opened(source) as stream, ZipFile(stream) as archive:
                if sum(member.file_size for member in archive.infolist()) > _MAX_UNPACKED:
                    raise CadenzaError(f"over {_MAX_UNPACKED >> 20} MiB unpacked")
                archive.extractall(folder)  # nothing lies outside it
        except FileNotFoundError as error:
            raise CadenzaError(f"{source}: there is no such folder or ZIP file") from error
        except Exception as error:  # damage shows in many ways
            if is_full(error):
                raise
            raise CadenzaError(
                f"{source}: neither a folder nor a readable ZIP file of the dataset; get it at "
                f"{WEBSITE}"
            ) from error
        yield Path(folder)


def _list_file(files: Sequence[Path], source: Path) -> Path:
    """The list of pieces, in the fewest folders if there are several."""
    lists = [path for path in files if path.name.lower() == _LIST]
    if not lists:
        raise CadenzaError(
            f"{source}: there is no List.csv in it; give the PIG dataset as downloaded at {WEBSITE}"
        )
    return min(lists, key=lambda path: (len(path.parts), path))


def _first_fingerings(files: Sequence[Path], folder: Path) -> dict[int, Path]:
    """Number of a piece -> the file of its first annotator."""
    matches = [(path, _FILE.fullmatch(path.name)) for path in files]
    numbered = [
        (int(match[1]), int(match[2]), path)
        for path, match in matches
        if match and path.parent == folder / _FINGERINGS
    ]
    return {number: path for number, _, path in sorted(numbered, reverse=True)}


# The list of pieces


def _pieces(content: bytes, where: str, left_out: list[str]) -> list[_ListedPiece]:
    """The pieces in `List.csv`; lines that name none are added to `left_out`.

    Raises CadenzaError if it is no table, or there is no column of titles.
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
    pieces: dict[int, _ListedPiece] = {}
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
            pieces[number] = _ListedPiece(f"{where}:{line}", number, title, composer)
    return list(pieces.values())


# The files of notes


def read_fingered(content: bytes, where: str) -> Score:
    """The notes in a file, with their fingers; `Score.remarks` says what looks wrong.

    What cannot be played on one piano is repaired as by `read_midi`, and a remark, too. Errors call
    the file `where`, with the number of a line. Raises CadenzaError if it is no text or has no
    notes, it lasts over an hour, or a line is wrong.
    """
    notes: list[RawNote] = []
    doubts: list[str] = []
    lines = io.StringIO(decoded(content, where), newline=None)
    for number, line in enumerate(lines, start=1):
        entry = line.partition("//")[0]
        if not entry.strip():
            continue
        with errors_in(f"{where}:{number}"):
            note, channel = _note(entry)
        notes.append(note)
        if note.finger and note.finger.hand != channel:
            doubts.append(
                f"{where}:{number}: channel and finger are of different hands, the finger is taken"
            )
    with errors_in(where):
        playing, repairs = repaired_notes(notes, Counter(), ())
    return Score(playing, remarks=(*doubts, *(f"{where}: {repair}" for repair in repairs)))


def _note(line: str) -> tuple[RawNote, int]:
    """The note of a line, and its channel; raises CadenzaError if it is wrong."""
    cells = line.split()
    if len(cells) != 8:
        raise CadenzaError(f"{len(cells)} columns; expected eight: {_COLUMNS}")
    _, onset, offset, pitch, loud, _, channel, finger = cells
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
    note = RawNote(start, end, _pitch(pitch), velocity, True, _finger(finger))
    return note, int(channel)


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
