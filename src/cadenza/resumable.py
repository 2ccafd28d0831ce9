"""Folders of work that is stopped and resumed at any moment, such as training, benches, practice.

One process at a time holds the folder's lock. A manifest says what the work is, and is written
before the work begins. Every file is replaced as a whole (`cadenza.files.write_atomically`), so
that a kill at any moment leaves what was finished last.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cadenza.errors import CadenzaError, quoted
from cadenza.files import checked, locked, read_json, remove_half_written, write_json

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Manifest = TypeVar("Manifest", bound=DataclassInstance)


class ResumableFolder:
    """The folder of one piece of work of a command.

    Attributes:
        path: The folder.
        command: The command that begins and resumes the work, such as "cadenza train".
        manifest: The path of the manifest, which says what the work is.
    """

    def __init__(
        self, path: Path, command: str, locked_out: str, manifest: str = "run.json"
    ) -> None:
        """Make nothing yet.

        Args:
            path: The folder.
            command: The command that begins and resumes the work.
            locked_out: What the error of `locked` says when another process holds the lock.
            manifest: The name of the manifest.
        """
        self.path, self.command, self.manifest = path, command, path / manifest
        self._locked_out = locked_out

    @contextmanager
    def claimed(self, patience: float = 0.0) -> Iterator[bool]:
        """Yield whether this process holds the lock of the folder, which is made if need be.

        Files that a killed process has left half-written are removed.

        Args:
            patience: The time to wait for another process to release the lock [s].

        Raises:
            CadenzaError: Nothing can be written in the folder.
        """
        with locked(self.path, patience) as ours:
            if ours:
                remove_half_written(self.path)
            yield ours

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the lock of the folder for the block; see `claimed`.

        Raises:
            CadenzaError: Another process holds it, or nothing can be written in the folder.
        """
        with self.claimed() as ours:
            if not ours:
                raise CadenzaError(f"{self.path}: {self._locked_out}")
            yield

    @property
    def begun(self) -> bool:
        """Whether there is a manifest."""
        return self.manifest.exists()

    def write_manifest(self, fields: dict[str, Any]) -> None:
        """Write the manifest, with the command besides its fields."""
        write_json(self.manifest, {"command": self.command, **fields})

    def read_manifest(self) -> dict[str, Any]:
        """The fields of the manifest, unchecked.

        Raises:
            CadenzaError: There is no manifest, it is damaged, or it is that of another command.
        """
        fields = read_json(self.manifest, dict[str, Any])
        command = checked(fields.pop("command", None), str, self.manifest)
        if command != self.command:
            raise CadenzaError(
                f"{self.path}: holds a run of {command}, which that command continues; for "
                f"{self.command}, choose another folder"
            )
        return fields

    def known(self, kind: type[Manifest]) -> Manifest | None:
        """The manifest as a dataclass, None where there is none.

        Raises:
            CadenzaError: The manifest is damaged, or that of another command.
        """
        return checked(self.read_manifest(), kind, self.manifest) if self.begun else None

    def begin_or_continue(self, wanted: Manifest, known: Manifest | None) -> None:
        """Write the manifest that is wanted, unless the `known` one is of other work.

        Raises:
            CadenzaError: The two manifests differ.
        """
        self.check_same(wanted, known)
        self.write_manifest(asdict(wanted))

    def check_same(self, wanted: Manifest, known: Manifest | None) -> None:
        """Raise a CadenzaError if there is a `known` manifest, and it is not the `wanted` one."""
        if known not in (None, wanted):
            raise CadenzaError(
                f"{self.path}: holds a run with other options; give the same to continue it, or "
                "choose another folder with --output"
            )

    def check_complete(self, has_checkpoints: bool) -> None:
        """Raise a CadenzaError if there are checkpoints, but no manifest says what they are of."""
        if has_checkpoints and not self.begun:  # a new run would go on from them
            raise CadenzaError(
                f"{self.manifest}: missing, but there are checkpoints; use another copy, or choose "
                "another folder with --output"
            )


class RateLimited:
    """A function that is called again and again, and works only now and then."""

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
    """The versions of those packages that are installed, by their names."""
    versions = {}
    for package in packages:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions


@contextmanager
def errors_of_resuming(run: Path) -> Iterator[None]:
    """Names the run in errors of a block that restores its checkpoint.

    Raises:
        CadenzaError: The checkpoint does not fit the run, which shows in many ways.
    """
    try:
        yield
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise CadenzaError(
            f"{run}: its checkpoint does not belong to this run ({quoted(error)}); "
            "use another copy, or "
            "start a new run"
        ) from error
