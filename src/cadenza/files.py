"""Writing files as a whole or not at all, and reading files that may be broken.

A reader declares the content that it expects, as a type for JSON and as a table for arrays. Other
content raises an error of one line.
"""

import errno
import hashlib
import json
import math
import os
import re
import secrets
import shutil
import stat
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeVar

import msgspec
import numpy as np
import safetensors.numpy
from numpy.typing import NDArray

from cadenza.configs import MAX_SEED
from cadenza.errors import CadenzaError, is_full, quoted, shortened

T = TypeVar("T")

TEMPORARY = ".cadenza-"  # the prefix of the name of a file while it is written
MAX_JSON = 32 * 2**20
"""Bytes of a file that is read as a whole, enough for a song of half a million notes."""
TENSORS = ".safetensors"  # the ending of the names of our own files of arrays
_FACTS, _SHA256 = "facts", "sha256"  # in the header of such a file
_ANOTHER = "it is damaged, modified or from another version; use another copy"

# Writing


@contextmanager
def write_atomically(path: Path) -> Iterator[IO[bytes]]:
    """Yield a binary file that takes the place of `path` when the block ends without an error.

    It keeps the permissions of the file that it replaces; a new one has those of any new file. A
    symbolic link is replaced, not followed.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Short, since the name of `path` may be as long as a name can be.
    temporary = path.parent / f"{TEMPORARY}{secrets.token_hex(8)}"
    mode = _permissions(path)

    def create(name: str, flags: int) -> int:
        # Its permissions are the final ones from the beginning.
        return os.open(name, flags, 0o666 if mode is None else mode)

    try:
        with open(temporary, "xb", opener=create) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if mode is not None:
            os.chmod(temporary, mode)
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error  # which file it was
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _permissions(path: Path) -> int | None:
    """The permissions of a regular file, None where there is none."""
    with suppress(FileNotFoundError):
        if stat.S_ISREG(mode := path.lstat().st_mode):
            return stat.S_IMODE(mode) & 0o777
    return None


@contextmanager
def new_folder(path: Path, replaces: bool = False) -> Iterator[Path]:
    """Yield a folder that becomes `path` when the block ends without an error.

    Raises CadenzaError if `path` exists and is not to be replaced, unless it is an empty folder.
    """
    if path.exists() and not replaces and not (path.is_dir() and not any(path.iterdir())):
        raise CadenzaError(f"{path}: exists already; choose another folder with --output")
    path = path.resolve()  # "." could not be replaced
    temporary = path.parent / f"{TEMPORARY}{secrets.token_hex(8)}"
    temporary.mkdir(parents=True)
    try:
        yield temporary
        if replaces:
            shutil.rmtree(path, ignore_errors=True)
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def remove_half_written(folder: Path) -> None:
    """Remove files that a process was writing to a folder with `write_atomically` as it died."""
    for path in folder.glob(f"{TEMPORARY}*"):
        if path.is_file() or path.is_symlink():
            path.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path, patience: float = 0.0) -> Iterator[bool]:
    """Yield whether this process holds the lock of a folder, which is made if need be.

    Args:
        folder: the folder to lock.
        patience: the time to wait for other processes [s].

    Raises:
        CadenzaError: nothing can be written in the folder.
        OSError: the disk is full.
    """
    path = folder / "lock"
    with ExitStack() as stack:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            ours = stack.enter_context(locked_file(path, patience))
        except OSError as error:
            if is_full(error):
                raise
            in_the_way = os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode)
            what = "remove it" if in_the_way else "copy the folder to where you can write"
            raise CadenzaError(f"{path}: cannot be locked ({error.strerror}); {what}") from error
        yield ours


@contextmanager
def locked_file(path: Path, patience: float = 0.0) -> Iterator[bool]:
    """Yield whether this process holds the lock file, after `patience` [s] at most; or OSError."""
    from filelock import FileLock, Timeout  # its import is slow

    lock = FileLock(path)
    try:
        lock.acquire(timeout=patience)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()


# Reading


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Yield a regular file to be read: pipes and devices may never end.

    Raises OSError if it cannot be opened, or is not a regular file.
    """
    at_once = getattr(os, "O_NONBLOCK", 0)
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | at_once)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "no regular file", str(path))
        yield file


@contextmanager
def _readable(path: Path, max_bytes: int | None) -> Iterator[IO[bytes]]:
    """Open a regular file of at most `max_bytes`, or raise a CadenzaError."""
    try:
        with opened(path) as file:
            size = os.fstat(file.fileno()).st_size
            if max_bytes is not None and size > max_bytes:
                raise CadenzaError(
                    f"{path}: takes {size:,} bytes, but such a file needs no more than "
                    f"{max_bytes:,}; {_ANOTHER}"
                )
            yield file
    except FileNotFoundError as error:
        raise CadenzaError(f"{path}: there is no such file") from error
    except OSError as error:
        raise CadenzaError(f"{path}: cannot be read ({error.strerror})") from error


def content_of(path: Path, max_bytes: int = MAX_JSON) -> bytes:
    """Read a file of at most `max_bytes`.

    Raises CadenzaError if it is not there, cannot be read, or is larger.
    """
    with _readable(path, max_bytes) as file:
        return file.read(os.fstat(file.fileno()).st_size)  # and not what is added meanwhile


def sha256_of(*paths: Path, max_bytes: int | None = None) -> str:
    """The SHA-256 of the contents of files, one after the other.

    Raises CadenzaError if one is not there, cannot be read, or takes over `max_bytes`.
    """
    digest = hashlib.sha256()
    for path in paths:
        with _readable(path, max_bytes) as file:
            hashlib.file_digest(file, lambda: digest)  # type: ignore[arg-type]
    return digest.hexdigest()


def files_in(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and in the folders in it, by their paths within it.

    Hidden ones are left out, and so are folders that cannot be read. Links to folders are not
    followed.
    """
    folders = [folder]
    while folders:
        with suppress(OSError), os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                if entry.is_dir(follow_symlinks=False):
                    folders.append(Path(entry.path))
                elif not entry.is_dir():
                    yield Path(entry.path).relative_to(folder)


def unpacked(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Unpack a member of at most `max_bytes`.

    Raises:
        CadenzaError: it holds more, or is packed by another method than ZIP's usual one.
        Exception: it is damaged; the type depends on the damage.
    """
    if archive.getinfo(name).compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise CadenzaError("packed in an unusual way; pack it again as a plain ZIP file (deflate)")
    with archive.open(name) as stream:
        content = stream.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise CadenzaError(f"over {max_bytes >> 20} MiB unpacked, too large for a song")
    return content


# Numbers in text

_WHOLE = re.compile("[+-]?[0-9]{1,40}")  # int() refuses thousands of digits with another error
_DECIMAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


def whole_number_in(text: str, what: str, low: int, high: int) -> int:
    """The whole number from `low` to `high` that a file or a user writes as `text`.

    Text from outside is converted here or in `number_in`, never by int() or float() alone: these
    accept "1_000", other digits than 0 to 9, nan and infinity, and int() raises another error from
    4,301 digits on. Raises CadenzaError if it is something else; the message begins with `what`
    was expected.
    """
    if not _WHOLE.fullmatch(text) or not low <= (number := int(text)) <= high:
        raise CadenzaError(f"{what} {quoted(text)}; expected a whole number, {low:,} to {high:,}")
    return number


def number_in(text: str, what: str, low: float, high: float) -> float:
    """The number from `low` to `high` that a file or a user writes as `text`.

    Raises CadenzaError if it is something else, also nan; the message begins with `what` was
    expected.
    """
    if not _DECIMAL.fullmatch(text) or not low <= (number := float(text)) <= high:
        raise CadenzaError(f"{what} {quoted(text)}; expected a number, {low:,g} to {high:,g}")
    return number


# JSON


def read_json(path: Path, kind: type[T]) -> T:
    """Read a JSON file as a value of a type; see `checked`.

    Raises CadenzaError if it cannot be read, is too large, is not JSON, or holds something else.
    """
    return parsed_json(content_of(path), kind, path)


def parsed_json(content: bytes | str, kind: type[T], where: object) -> T:
    """Parse JSON as a value of a type, see `checked`; raises CadenzaError if it is not."""
    try:
        value = json.loads(content, object_pairs_hook=_named_once)
    except CadenzaError as error:
        raise CadenzaError(f"{where}: {error}; {_ANOTHER}") from error
    except (ValueError, RecursionError) as error:
        raise CadenzaError(f"{where}: not JSON; {_ANOTHER}") from error
    return checked(value, kind, where)


def _named_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse an object with a name twice: readers differ in which value they take."""
    value = dict(pairs)
    if len(value) < len(pairs):
        raise CadenzaError("has a name twice")
    return value


def checked(value: Any, kind: type[T], where: object, advice: str = _ANOTHER) -> T:
    """Convert a JSON value to a dataclass, a named tuple, or lists and dictionaries of these.

    Only lists are converted to tuples, and whole numbers to floats. Missing fields get their
    defaults. Raises CadenzaError if a value is of another type, unknown to `kind`, or a number that
    is not finite; the message has `where`, the path of the value, and the `advice`.
    """
    try:
        _check_values(value, "$")
        result = msgspec.convert(value, kind)
        _check_names(value, msgspec.to_builtins(result), "$")
    except (msgspec.ValidationError, CadenzaError) as error:
        raise CadenzaError(f"{where}: {shortened(str(error))}; {advice}") from error
    except RecursionError as error:
        raise CadenzaError(f"{where}: too deeply nested; {advice}") from error
    return result


def _check_values(value: Any, at: str) -> None:
    """Refuse values that only Python's JSON reads, or that cannot be written again."""
    if isinstance(value, dict):
        for name, part in value.items():
            _check_values(name, at)
            _check_values(part, f"{at}.{shortened(name)}")
    elif isinstance(value, list):
        for i, part in enumerate(value):
            _check_values(part, f"{at}[{i}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise CadenzaError(f"Expected a finite number, got {value} - at `{at}`")
    elif isinstance(value, int) and abs(value) > MAX_SEED:
        raise CadenzaError(f"Expected a number of fewer digits, got {quoted(value)} - at `{at}`")
    elif isinstance(value, str) and not _is_text(value):
        raise CadenzaError(f"Expected text, got {quoted(value)} - at `{at}`")


def _check_names(given: Any, understood: Any, at: str) -> None:
    """Refuse fields that `msgspec.convert` leaves out."""
    if isinstance(given, dict):
        for name, part in given.items():
            if name not in understood:
                raise CadenzaError(f"Unknown field {quoted(name)} - at `{at}`")
            _check_names(part, understood[name], f"{at}.{name}")
    elif isinstance(given, list):
        for i, (part, other) in enumerate(zip(given, understood, strict=True)):
            _check_names(part, other, f"{at}[{i}]")


def _is_text(value: str) -> bool:
    """Whether text can be written to a file: JSON and numpy know halves of characters."""
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


# Arrays

NUMBERS, FLOATS, INTEGERS, FLAGS, TEXT = "fiub", "f", "iu", "b", "U"  # numpy's kinds of types
_WORDS = {
    NUMBERS: "numbers",
    FLOATS: "floating-point numbers",
    INTEGERS: "whole numbers",
    FLAGS: "truth values",
    TEXT: "text",
}


class ArrayOf(NamedTuple):
    """The type, shape and values that an array is expected to have."""

    kinds: str
    """The kinds of its type, as `numpy.dtype.kind`."""
    shape: tuple[int | str, ...] | None = ()
    """A name stands for any size, the same in all arrays of a file; `*` for any; None for any
    shape."""
    needed: bool = False
    finite: bool = False
    within: tuple[Any, Any] | None = None
    """Minimum and maximum of its values: numbers, or arrays that broadcast with it."""

    def __str__(self) -> str:
        sizes = "" if self.shape is None else f" of shape ({', '.join(map(str, self.shape))})"
        return f"{_WORDS.get(self.kinds, 'numbers or text')}{sizes}"


Expected = Mapping[str, ArrayOf]
"""Arrays by name; the first that fits a name counts, and `*` stands for any part of one."""
ANY: Expected = {"*": ArrayOf(NUMBERS + TEXT, None)}


def read_arrays(
    path: Path, expected: Expected, max_bytes: int | None = None
) -> dict[str, NDArray[Any]]:
    """Read the `expected` arrays of a .npz file by name; nothing in it is executed.

    Together they take at most `max_bytes`, by default the size of the file. Raises CadenzaError if
    the file is missing, of another format, larger, or holds something else.
    """
    try:
        with opened(path) as stream, np.load(stream, allow_pickle=False) as file:
            size = stream.seek(0, os.SEEK_END)
            members = {m.filename.removesuffix(".npy"): m.file_size for m in file.zip.infolist()}
            sizes = {name: n for name, n in members.items() if first_fitting(name, expected)}
            total, limit = sum(sizes.values()), size if max_bytes is None else max_bytes
            if total > limit:
                raise CadenzaError(
                    f"its arrays would take {total / 2**20:,.0f} MiB, but such a file "
                    f"needs no more than {limit / 2**20:,.0f} MiB; {_ANOTHER}"
                )
            arrays = {name: np.asarray(file[name]) for name in sizes}
        text = [str(t) for each in arrays.values() if each.dtype.kind in TEXT for t in each.flat]
        if not (all(map(str.isprintable, arrays)) and all(map(_is_text, text))):
            raise ValueError("names or text that cannot be printed")
    except FileNotFoundError as error:
        raise CadenzaError(f"{path}: there is no such file") from error
    except CadenzaError as error:
        raise CadenzaError(f"{path}: {error}") from error
    except Exception as error:  # damage shows in many ways, down to numpy's tokenizer
        raise CadenzaError(f"{path}: not a readable .npz file of plain arrays") from error
    check_arrays(arrays, expected, path)
    return arrays


def tensor_bytes(arrays: Mapping[str, NDArray[Any]], facts: Any = None) -> bytes:
    """The content of a .safetensors file of arrays of numbers, with `facts` as JSON in its header.

    The header also has the SHA-256 of both, which `read_tensors` checks.
    """
    in_order = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    about = {} if facts is None else plain(facts)
    digest = {_SHA256: _digest(in_order, about)}
    header = json.dumps(about | digest, allow_nan=False)  # one entry: several have no fixed order
    return safetensors.numpy.save(in_order, {_FACTS: header})


def _digest(arrays: dict[str, NDArray[Any]], facts: dict[str, Any]) -> str:
    content = safetensors.numpy.save(arrays)
    return hashlib.sha256(json.dumps(facts).encode() + content).hexdigest()


def write_tensors(
    path: Path, arrays: Mapping[str, NDArray[Any]], facts: Any = None, max_bytes: int | None = None
) -> None:
    """Write a .safetensors file as a whole or not at all; see `tensor_bytes`.

    Raises CadenzaError if the file would take over `max_bytes`, and could not be read again.
    """
    content = tensor_bytes(arrays, facts)
    if max_bytes is not None and len(content) > max_bytes:
        raise CadenzaError(
            f"{path}: would take {len(content) >> 20:,} MiB; such a file holds up to "
            f"{max_bytes >> 20:,} MiB"
        )
    with write_atomically(path) as file:
        file.write(content)


def read_tensors(
    path: Path, expected: Expected, max_bytes: int
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read the arrays of a .safetensors file by name, and the facts in its header.

    The file takes at most `max_bytes`. Raises CadenzaError if it is missing, of another format,
    damaged or modified, larger, or holds other than the `expected` arrays.
    """
    content = content_of(path, max_bytes)
    try:
        arrays: dict[str, NDArray[Any]] = safetensors.numpy.load(content)
        size = int.from_bytes(content[:8], "little")  # of the header, which has just been checked
        header = json.loads(content[8 : 8 + size]).get("__metadata__", {})
    except Exception as error:  # damage shows in many ways
        raise CadenzaError(f"{path}: not a readable .safetensors file") from error
    if not all(map(str.isprintable, arrays)):
        raise CadenzaError(f"{path}: holds arrays of names that cannot be printed")
    facts = parsed_json(header.get(_FACTS, "{}"), dict[str, Any], f"{path}, header")
    digest = facts.pop(_SHA256, None)
    if digest is None:
        raise CadenzaError(f"{path}: was written by another program; give a file of Cadenza's own")
    if digest != _digest(arrays, facts):
        raise CadenzaError(f"{path}: damaged or modified; use another copy")
    check_arrays(arrays, expected, path)
    return arrays, facts


def check_arrays(arrays: Mapping[str, NDArray[Any]], expected: Expected, where: object) -> None:
    """Raise a CadenzaError that names an array which is missing or not as `expected`."""
    for name, form in expected.items():
        if form.needed and name not in arrays:
            raise CadenzaError(f"{where}: holds no array named {name}, {form}; {_ANOTHER}")
    sizes: dict[str, int] = {}
    for name, array in arrays.items():
        form = first_fitting(name, expected) or ArrayOf("")
        if array.dtype.kind not in form.kinds or not _fits(array.shape, form.shape, sizes):
            known = [f"{n} {sizes[n]}" for n in form.shape or () if n in sizes]
            raise CadenzaError(
                f"{where}: {name} is {array.dtype} of shape {array.shape}; expected {form}"
                f"{', here ' * bool(known)}{', '.join(known)}; {_ANOTHER}"
            )
        if form.finite and not np.isfinite(array).all():
            raise CadenzaError(f"{where}: {name} holds numbers that are not finite; {_ANOTHER}")
        if form.within is not None:
            low, high = form.within
            if not ((array >= low) & (array <= high)).all():
                raise CadenzaError(f"{where}: {name} is not within {low} and {high}; {_ANOTHER}")


def first_fitting(name: str, by_pattern: Mapping[str, T]) -> T | None:
    """The value of the first pattern that fits a name; `*` stands for any part of one."""
    return next((of for known, of in by_pattern.items() if fnmatchcase(name, known)), None)


def _fits(
    shape: tuple[int, ...], form: tuple[int | str, ...] | None, sizes: dict[str, int]
) -> bool:
    if form is None:
        return True
    return len(shape) == len(form) and all(
        want == "*" or size == (sizes.setdefault(want, size) if isinstance(want, str) else want)
        for size, want in zip(shape, form, strict=True)
    )


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file as a whole or not at all; see `plain`."""
    with write_atomically(path) as file:
        file.write((json.dumps(plain(content), indent=2, allow_nan=False) + "\n").encode())


def plain(value: Any) -> Any:
    """A value as JSON has it: paths as text, null for what is no finite number.

    Bytes of a file's name that are no text become escapes such as `\\udcfc`.
    """
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, str | Path):
        return str(value).encode(errors="backslashreplace").decode()
    return value


def folder_name(text: str) -> str:
    """The name of a folder that shows any `text`.

    It is a name, not a path, and can be printed: separators, characters that some file system
    refuses, and unprintable ones become `_`; dots and spaces at the ends, and all after 255 bytes,
    are removed.
    """
    safe = "".join(c if c.isprintable() and c not in '/\\:*?"<>|' else "_" for c in text)
    return safe.encode()[:255].decode(errors="ignore").strip(". ") or "_"


def modification_times(paths: Iterable[Path]) -> dict[Path, float]:
    """The times of the last changes of files [s since 1970], the newest first.

    Files that were removed meanwhile, or are not accessible, are left out. Links are not followed.
    """
    times = {}
    for path in paths:
        with suppress(OSError):
            times[path] = path.lstat().st_mtime
    return dict(sorted(times.items(), key=lambda item: item[1], reverse=True))
