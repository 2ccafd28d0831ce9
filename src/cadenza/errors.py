"""Errors whose message is meant for users rather than programmers."""

import errno
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from cadenza.installing import install_line

_LACKS_MEMORY = (
    "allocate memory",  # of the system, and of MuJoCo
    "failed to map segment",  # of the system, where it loads a library
    "Caught an unknown exception!",  # of MuJoCo, where it makes room for a simulation
    "RESOURCE_EXHAUSTED",  # of XLA
    "bad_alloc",  # of C++
)


class CadenzaError(Exception):
    """An error for users: something they gave cannot be used.

    The message is one line: what is wrong, where, and what to do about it. The command line
    prints it without a traceback and exits with status 1.
    """


class CadenzaWarning(UserWarning):
    """A warning for users: something was done, but maybe not as expected.

    The message is one line. The command line prints it without a traceback.
    """


class FileWarning(CadenzaWarning):
    """A warning about what was repaired, or is left out, of a file of music."""


_MAX_QUOTED = 100  # letters of a quoted value: enough to find it again
_MAX_OTHERS = 300  # letters of a message of a library, which may quote its input
_MAX_SHOWN = 1500  # letters of any message: a screen


def quoted(value: object) -> str:
    """A value as a message may quote it: a line of at most `_MAX_QUOTED` letters.

    Text stands in quotation marks, and what cannot be printed in it is escaped. Every message that
    repeats the content of a file, an argument or a name quotes it so, however long, deeply nested
    or wrongly written it may be.
    """
    try:
        text = repr(value[: _MAX_QUOTED + 1] if isinstance(value, str | bytes) else value)
    except Exception:  # whole numbers of too many digits, nested lists, classes of users
        text = f"a value of type {type(value).__name__}"
    return shortened(text, _MAX_QUOTED)


def shortened(text: str, limit: int = _MAX_OTHERS) -> str:
    """Text of others, such as the message of a library, as a line of a message.

    White space becomes a space, unprintable letters are escaped, and longer text than `limit`
    letters ends with "...".
    """
    line = on_one_line(" ".join(text[: limit * 2].split()))
    return line if len(line) <= limit and len(text) <= limit * 2 else f"{line[: limit - 3]}..."


def counted(number: int, noun: str) -> str:
    """A number and its noun, such as "1 run" or "2,000 runs"."""
    return f"{number:,} {noun}{'s'[: number != 1]}"


def on_one_line(message: str) -> str:
    """The message; what cannot be printed, as in the name of a file, is escaped.

    One that is longer than a screen, as it repeats an argument, loses its middle: its end advises.
    """
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
    half = _MAX_SHOWN // 2
    return line if len(line) <= _MAX_SHOWN else f"{line[:half]}...{line[-half:]}"


def is_full(error: Exception) -> bool:
    """Whether the error says that the disk is full."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def lacks_memory(error: BaseException) -> bool:
    """Whether the error, or a cause of it, is that memory was short, in any library."""
    return _lack_of_memory(error) is not None


def _lack_of_memory(error: BaseException | None) -> BaseException | None:
    """The error among `error` and its causes which says that memory was short."""
    while error is not None:
        message = "" if isinstance(error, CadenzaError) else str(error)
        if isinstance(error, MemoryError) or any(words in message for words in _LACKS_MEMORY):
            return error
        error = error.__cause__
    return None


def is_for_users(error: BaseException) -> bool:
    """Whether users can do something about an error, so that its message is enough."""
    return isinstance(error, CadenzaError | OSError) or lacks_memory(error)


def explained(error: BaseException) -> str:
    """The message of an error, with advice if the disk is full or memory is short."""
    if isinstance(error, OSError) and is_full(error):
        where = f"{error.filename}: " * bool(error.filename)
        return f"{where}the disk is full; free some space, then give the same command again"
    if (lack := _lack_of_memory(error)) is not None:
        message = shortened(str(lack)) or type(lack).__name__
        return (
            f"there is not enough memory ({message}); end other programs, or allow more (ulimit -v)"
        )
    return str(error)


def with_place(error: BaseException) -> str:
    """The type and the message of an error in a line, and where in the code it was raised."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    message = shortened(f"{type(error).__name__}: {error}")
    where = f" ({frame.filename}, line {frame.lineno})"
    return message + where * os.path.isfile(frame.filename)  # Python's own imports have no file


def in_a_line(error: BaseException, where: object = "") -> str:
    """A line on an error in the file `where`, for commands that go on with other files.

    A fault of the program has its place in the code.
    """
    if isinstance(error, CadenzaError | OSError):
        return on_one_line(explained(error))
    message = explained(error) if is_for_users(error) else with_place(error)
    return f"{where}: {message}" if str(where) else message


@contextmanager
def errors_in(where: object) -> Iterator[None]:
    """Begin the messages of errors in the block with their place, such as a file.

    Raises:
        CadenzaError: the block raises one.
    """
    try:
        yield
    except CadenzaError as error:
        raise CadenzaError(f"{where}: {error}") from error


@contextmanager
def errors_in_a_line() -> Iterator[None]:
    """Print errors as a line and exit with status 1, in programs outside the command line."""
    try:
        yield
    except Exception as error:
        if not is_for_users(error):
            raise
        print(f"error: {explained(error)}", file=sys.stderr)
        sys.exit(1)


@contextmanager
def extra_packages(extra: str, what: str) -> Iterator[None]:
    """Turn failed imports of the block into advice to install an `extra` of Cadenza.

    Raises CadenzaError if an import fails. The message begins with `what`, which needs the
    packages.
    """
    try:
        yield
    except ImportError as error:
        if lacks_memory(error):
            raise CadenzaError(explained(error)) from error
        raise CadenzaError(
            f"{what} needs more packages ({shortened(str(error))}): {install_line(extra)}"
        ) from error


@contextmanager
def by_others(what: str) -> Iterator[None]:
    """Turn all errors of user's code in the block into a `CadenzaError` that begins with `what`.

    The error itself is its cause. An OSError stays one, unless it is of a connection, which names
    nothing.
    """
    try:
        yield
    except (CadenzaError, OSError) as error:
        if not isinstance(error, TimeoutError | ConnectionError):
            raise
        raise CadenzaError(f"{what}: {with_place(error)}") from error
    except (Exception, SystemExit) as error:  # a module may end the process
        if lacks_memory(error):
            raise CadenzaError(explained(error)) from error
        raise CadenzaError(f"{what}: {with_place(error)}") from error
