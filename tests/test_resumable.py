"""Folders of work that is stopped and resumed: the lock, the manifest and what a kill leaves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from cadenza.errors import CadenzaError
from cadenza.files import TEMPORARY
from cadenza.resumable import ResumableFolder


@dataclass(frozen=True)
class Options:
    song: str
    seed: int = 0


@pytest.fixture
def folder(tmp_path: Path) -> ResumableFolder:
    return ResumableFolder(tmp_path / "work", "cadenza dream", "somebody dreams there")


def test_one_process_at_a_time_works_in_a_folder(folder: ResumableFolder) -> None:
    other = ResumableFolder(folder.path, "cadenza dream", "somebody dreams there")
    with folder.locked():
        with pytest.raises(CadenzaError, match="work: somebody dreams there"), other.locked():
            pass
        with other.claimed() as ours:
            assert not ours
    with other.claimed() as ours:
        assert ours


def test_what_a_killed_process_was_writing_is_removed_by_the_next(folder: ResumableFolder) -> None:
    folder.path.mkdir()
    names = (f"{TEMPORARY}0123456789abcdef", "result.json", f"{TEMPORARY}folder")
    for name in names[:2]:
        (folder.path / name).write_text("half")
    (folder.path / names[2]).mkdir()  # of somebody else, who makes a new folder here
    with folder.locked():
        left = {path.name for path in folder.path.iterdir()} - {"lock"}
    assert left == set(names[1:])


def test_a_folder_is_continued_with_the_options_with_which_it_was_begun(
    folder: ResumableFolder,
) -> None:
    assert folder.known(Options) is None
    folder.begin_or_continue(Options("joy"), None)
    folder.begin_or_continue(Options("joy"), folder.known(Options))
    with pytest.raises(CadenzaError, match="holds a run with other options"):
        folder.begin_or_continue(Options("joy", seed=1), folder.known(Options))
    assert folder.known(Options) == Options("joy")


def test_the_work_of_another_command_is_refused(folder: ResumableFolder) -> None:
    folder.begin_or_continue(Options("joy"), None)
    other = ResumableFolder(folder.path, "cadenza sleep", "somebody sleeps there")
    with pytest.raises(CadenzaError, match="holds a run of cadenza dream"):
        other.known(Options)


def test_checkpoints_without_a_manifest_are_not_continued(folder: ResumableFolder) -> None:
    folder.check_complete(has_checkpoints=False)
    with pytest.raises(CadenzaError, match=r"run\.json: missing, but there are checkpoints"):
        folder.check_complete(has_checkpoints=True)
