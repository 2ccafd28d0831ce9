"""The index of a folder of music: `index.csv`, a line a piece.

    file,title,composer,split
    midi/nocturne.mid,Nocturne,John Field,train

The piece is named by `file` (also `path`, `filename`, `id` or `name`): the path of its file within
the folder, or its name, with or without ending. All else is optional.
"""

import csv
import io
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from cadenza.configs import MAX_COUNT
from cadenza.errors import CadenzaError, quoted, shortened
from cadenza.files import number_in, whole_number_in, write_atomically
from cadenza.music.formats.source import decoded, printable, read_bytes

INDEX = "index.csv"
_NAMES = ("file", "path", "filename", "id", "name")
_TEXTS = ("title", "composer", "source", "split")
_NUMBERS: Mapping[str, Callable[[str, str, int, int], float]] = {
    "seconds": number_in,
    "notes": whole_number_in,
    "hands": whole_number_in,
    "difficulty": number_in,
}
_COLUMNS = (_NAMES[0], *_TEXTS, *_NUMBERS)
_MAX_BYTES = 64 * 2**20  # bytes of a hundred thousand pieces

Facts = dict[str, Any]  # facts about a piece, by the names of the fields of `Song`


def read_index(path: Path) -> dict[str, Facts]:
    """Name of a piece, as the index has it -> facts about it, in the order of the index.

    Raises CadenzaError if it cannot be read, is no table, or names a piece twice.
    """
    header, rows = read_table(decoded(read_bytes(path, _MAX_BYTES), path), path)
    column = next((name for name in _NAMES if name in header), None)
    if column is None:
        raise CadenzaError(
            f"{path}:1: no column says which file a line is about; name one of the columns "
            f"{', '.join(_NAMES[:-1])} or {_NAMES[-1]}"
        )
    index: dict[str, Facts] = {}
    for line, cells in rows:
        name = cells.get(column, "")
        if not name or name in index:
            wrong = f"a second line for {quoted(name)}" if name else "names no file"
            raise CadenzaError(f"{path}:{line}: {wrong}; correct or remove it")
        index[name] = _facts(cells)
    return index


def read_table(
    text: str, where: object, strict: bool = True
) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """The names of the columns of a CSV file in lower case, and its lines with their numbers.

    Empty lines are left out, and so are cells that no column has a name for. If `strict`, quotation
    marks in the middle of a cell are an error. Errors name `where` and the line. Raises
    CadenzaError if it is no CSV.
    """
    csv.field_size_limit(max(len(text), csv.field_size_limit()))  # that of the text is enough
    reader = csv.reader(io.StringIO(text, newline=""), strict=strict)
    try:
        header = [printable(name).lower() for name in next(reader, [])]
        rows = [
            (reader.line_num, dict(zip(header, map(str.strip, row), strict=False)))
            for row in reader
            if any(row)
        ]
    except csv.Error as error:
        raise CadenzaError(
            f"{where}:{reader.line_num}: not a table as CSV ({shortened(str(error))})"
        ) from error
    return header, rows


def write_index(path: Path, rows: Iterable[tuple[str, Facts]]) -> None:
    """Write the index of files and facts about them."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    for file, facts in rows:
        writer.writerow({_COLUMNS[0]: file, **facts})
    with write_atomically(path) as out:
        out.write(text.getvalue().encode())


def _facts(cells: Mapping[str, str]) -> Facts:
    """The facts in a line, None for a number that is none."""
    texts = {name: printable(cells.get(name, "")) for name in _TEXTS}
    numbers = dict.fromkeys(_NUMBERS)
    for name, read in _NUMBERS.items():
        with suppress(CadenzaError):
            numbers[name] = read(cells.get(name, ""), name, 0, MAX_COUNT)
    return texts | numbers
