"""The store of work that is stopped and resumed at any moment: training, benches, practice.

A folder holds a manifest, which describes the work and is written before it begins, and a lock,
which one process holds at a time. Work with a state of its own keeps it in a checkpoint. Every file
is replaced as a whole (`cadenza.files.write_atomically`) and a checkpoint has a digest: a kill at
any moment leaves the last complete files, and damage is noticed.

    FOLDER/run.json                  the manifest
    FOLDER/checkpoint.safetensors    arrays, and facts as JSON in its header
    FOLDER/lock

Orbax, the library for checkpoints of JAX, is not used: it saves PyTrees for many hosts and devices
as a folder of many small files, and restores them into a structure that the caller already has.
Here one host keeps a few megabytes, with their shapes in the file; arrays are NumPy's as often as
JAX's (practice and playing work without JAX); and facts, the manifest, the lock, and the refusal of
damaged checkpoints or those of other commands would be needed all the same.
"""

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

from numpy.typing import NDArray

from cadenza.errors import CadenzaError, quoted
from cadenza.files import (
    ANY,
    checked,
    locked,
    plain,
    read_json,
    read_tensors,
    remove_half_written,
    write_json,
    write_tensors,
)

T = TypeVar("T")
Arrays = dict[str, NDArray[Any]]

CHECKPOINT = "checkpoint.safetensors"  # the name of the file of a checkpoint
_COMMAND = "command"  # in manifests and checkpoints
_MAX_CHECKPOINT = 2**30  # bytes; learners' take some ten million


class ResumableFolder:
    """The folder of one piece of work of a command.

    Attributes:
        path: The folder.
        command: The command that begins and resumes the work, such as "cadenza train".
        manifest: The path of the manifest.
        checkpoint: The path of the checkpoint.
    """

    def __init__(
        self, path: Path, command: str, locked_out: str, manifest: str = "run.json"
    ) -> None:
        """Make nothing yet, of work that a command begins and resumes in a folder.

        `locked_out` is what the error of `locked` says when another process holds the lock.
        """
        self.path, self.command = path, command
        self.manifest, self.checkpoint = path / manifest, path / CHECKPOINT
        self._locked_out = locked_out

    @contextmanager
    def claimed(self, patience: float = 0.0) -> Iterator[bool]:
        """Yield whether this process holds the lock of the folder, which is made if need be.

        Another process has `patience` [s] to release it. Files that a killed process has left
        half-written are removed. Raises CadenzaError if nothing can be written in the folder.
        """
        with locked(self.path, patience) as ours:
            if ours:
                remove_half_written(self.path)
            yield ours

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the lock of the folder for the block; see `claimed`.

        Raises CadenzaError if another process holds it, or nothing can be written in the folder.
        """
        with self.claimed() as ours:
            if not ours:
                raise CadenzaError(f"{self.path}: {self._locked_out}")
            yield

    # The manifest

    @property
    def begun(self) -> bool:
        """Whether there is a manifest; raises CadenzaError if there is only a checkpoint."""
        if not self.manifest.exists() and self.checkpoint.exists():
            raise CadenzaError(
                f"{self.manifest}: missing, but there is a checkpoint; use another copy, or choose "
                "another folder with --output"
            )
        return self.manifest.exists()

    def write_manifest(self, fields: Mapping[str, Any]) -> None:
        """Write the manifest, with the command besides its fields."""
        write_json(self.manifest, {_COMMAND: self.command, **fields})

    def read_manifest(self) -> dict[str, Any]:
        """The fields of the manifest, unchecked.

        Raises CadenzaError if there is no manifest, it is damaged, or it is that of another
        command.
        """
        fields = read_json(self.manifest, dict[str, Any])
        command = checked(fields.pop(_COMMAND, None), str, self.manifest)
        if command != self.command:
            raise CadenzaError(
                f"{self.path}: holds a run of {command}, which that command continues; for "
                f"{self.command}, choose another folder"
            )
        return fields

    def begin_or_continue(
        self, fields: Mapping[str, Any], changeable: Collection[str] = ()
    ) -> None:
        """Write the manifest of new work, or of the same work: its `fields`, as JSON has them.

        Only `changeable` ones may differ from the manifest so far. Raises CadenzaError if
        the folder holds other work, or a damaged manifest.
        """
        expected = plain(fields)
        if self.begun:
            known = self.read_manifest()
            if known | {name: expected[name] for name in changeable} != expected:
                raise CadenzaError(
                    f"{self.path}: holds a run with other options; give the same to continue it, "
                    "or choose another folder with --output"
                )
        self.write_manifest(expected)

    # The checkpoint

    def save(self, facts: Mapping[str, Any], arrays: Arrays) -> None:
        """Write a checkpoint in place of the one before; raises CadenzaError if it is too large."""
        about = {_COMMAND: self.command, **facts}
        write_tensors(self.checkpoint, arrays, about, _MAX_CHECKPOINT)

    def load(self, kind: type[T]) -> tuple[T, Arrays] | None:
        """The facts of the checkpoint, as this type, and its arrays; None if there is none.

        Raises CadenzaError if it is damaged, or that of another command.
        """
        if not self.checkpoint.exists():
            return None
        arrays, facts = read_tensors(self.checkpoint, ANY, _MAX_CHECKPOINT)
        if facts.pop(_COMMAND, None) != self.command:
            raise CadenzaError(f"{self.checkpoint}: is no checkpoint of {self.command}")
        return checked(facts, kind, self.checkpoint), arrays

    @contextmanager
    def errors_of_writing(self) -> Iterator[None]:
        """Raise a CadenzaError with advice where the block cannot write in the folder."""
        try:
            yield
        except OSError as error:
            raise CadenzaError(
                f"{self.path}: could not be written ({error.strerror}); make room there, and "
                "continue from the last checkpoint"
            ) from error

    @contextmanager
    def errors_of_resuming(self) -> Iterator[None]:
        """Name the folder in errors of a block that restores its checkpoint.

        Raises CadenzaError if the checkpoint does not fit the work.
        """
        try:
            yield
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            raise CadenzaError(
                f"{self.path}: its checkpoint does not belong to this run ({quoted(error)}); "
                "use another copy, or start a new run"
            ) from error


class RateLimited:
    """A function that is called often, and limits how often it works."""

    def __init__(self, work: Callable[[], None], interval: float, share: float) -> None:
        """Work at most every `interval` [s], and for at most a `share` of the time."""
        self._work, self._interval, self._share = work, interval, share
        self._last_time, self._duration = time.monotonic(), 0.0

    def __call__(self, at_once: bool = False) -> None:
        """Do the work if it is due, or `at_once`."""
        began = time.monotonic()
        if at_once or began - self._last_time > max(self._interval, self._duration / self._share):
            self._work()
            self._last_time = time.monotonic()
            self._duration = self._last_time - began


def installed_versions(packages: Iterable[str]) -> dict[str, str]:
    """The versions of the installed ones among packages, by their names."""
    versions = {}
    for package in packages:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions
