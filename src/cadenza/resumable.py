"""Folders of work that can be stopped and resumed: locked, with a manifest of what they are for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadenza.errors import CadenzaError
from cadenza.files import checked, locked, read_json, write_json

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


class ResumableFolder:
    """The folder of a command's work; its manifest says what was asked for.

    Attributes:
        path: of the folder.
        manifest: path of the manifest.
    """

    def __init__(self, path: Path, command: str) -> None:
        """`command` is what is told of the folder, such as "cadenza train"."""
        self.path, self.command, self.manifest = path, command, path / "run.json"

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keeps other processes out for the block; makes the folder.

        Raises:
            CadenzaError: another process works in it, or nothing can be written there.
        """
        with locked(self.path) as ours:
            if not ours:
                raise CadenzaError(f"{self.path}: another process is training this run")
            yield

    @property
    def begun(self) -> bool:
        """Whether there is a manifest."""
        return self.manifest.exists()

    def write_manifest(self, content: DataclassInstance) -> None:
        """Writes down what is asked for."""
        write_json(self.manifest, {"command": self.command, **asdict(content)})

    def read_manifest(self) -> dict[str, Any]:
        """The fields of `write_manifest`, unchecked.

        Raises:
            CadenzaError: there is none, it is damaged, or it is that of another command.
        """
        content = read_json(self.manifest, dict[str, Any])
        command = checked(content.pop("command", None), str, self.manifest)
        if command != self.command:
            raise CadenzaError(
                f"{self.path}: holds a run of {command}, which that command continues; for "
                f"{self.command}, choose another folder"
            )
        return content

    def begin_or_continue(self, content: DataclassInstance) -> None:
        """Writes the manifest, unless it says the same.

        Raises:
            CadenzaError: it says something else.
        """
        if self.begun and checked(self.read_manifest(), type(content), self.manifest) != content:
            raise self.other_options()
        self.write_manifest(content)

    def other_options(self) -> CadenzaError:
        """The error where the manifest says something else than what is asked for."""
        return CadenzaError(
            f"{self.path}: holds a run with other options; give the same to continue it, or "
            "choose another folder with --output"
        )

    def check_complete(self, has_checkpoints: bool) -> None:
        """Raises: CadenzaError: there are checkpoints, but no manifest says what they are of."""
        if has_checkpoints and not self.begun:  # a new run would go on from them
            raise CadenzaError(
                f"{self.manifest}: missing, but there are checkpoints; use another copy, or choose "
                "another folder with --output"
            )


@contextmanager
def errors_of_resuming(run: Path) -> Iterator[None]:
    """Names the run in errors of a block that goes on from its checkpoint.

    Raises:
        CadenzaError: the checkpoint does not fit, which shows in many ways.
    """
    try:
        yield
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise CadenzaError(
            f"{run}: its checkpoint does not belong to this run ({error!r}); use another copy, or "
            "start a new run"
        ) from error
