"""Folders of work that is stopped and resumed: the lock, the manifest and what a kill leaves."""

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.files import TEMPORARY
from cadenza.resumable import RateLimited, ResumableFolder


@dataclass(frozen=True)
class Facts:
    step: int
    seconds: float
    rng: dict[str, Any]


@pytest.fixture
def folder(tmp_path):
    return ResumableFolder(tmp_path / "work", "cadenza dream", "somebody dreams there")


def test_one_process_at_a_time_works_in_a_folder(folder):
    other = ResumableFolder(folder.path, "cadenza dream", "somebody dreams there")
    with folder.locked():
        with pytest.raises(CadenzaError, match="work: somebody dreams there"), other.locked():
            pass
        with other.claimed() as ours:
            assert not ours
    with other.claimed() as ours:
        assert ours


def test_what_a_killed_process_was_writing_is_removed_by_the_next(folder):
    folder.path.mkdir()
    names = (f"{TEMPORARY}0123456789abcdef", "result.json", f"{TEMPORARY}folder")
    for name in names[:2]:
        (folder.path / name).write_text("half")
    (folder.path / names[2]).mkdir()  # of somebody else, who makes a new folder here
    with folder.locked():
        left = {path.name for path in folder.path.iterdir()} - {"lock"}
    assert left == set(names[1:])


def test_a_folder_is_continued_with_the_options_with_which_it_was_begun(folder):
    for steps in (10, 20):
        fields = {"song": "joy", "seed": 0, "places": (Path("a"),), "steps": steps}
        folder.begin_or_continue(fields, changeable=("steps",))
    with pytest.raises(CadenzaError, match="holds a run with other options"):
        folder.begin_or_continue(fields | {"seed": 1}, changeable=("steps",))
    with pytest.raises(CadenzaError, match="holds a run with other options"):
        folder.begin_or_continue(fields | {"steps": 30})
    assert folder.read_manifest() == fields | {"places": ["a"]}


def test_the_work_of_another_command_is_refused(folder):
    folder.begin_or_continue({"song": "joy"})
    folder.save({}, {})
    other = ResumableFolder(folder.path, "cadenza sleep", "somebody sleeps there")
    with pytest.raises(CadenzaError, match="holds a run of cadenza dream"):
        other.begin_or_continue({"song": "joy"})
    with pytest.raises(CadenzaError, match="is no checkpoint of cadenza sleep"):
        other.load(Facts)


def test_a_checkpoint_without_a_manifest_is_not_continued(folder):
    assert not folder.begun
    folder.save({}, {})
    with pytest.raises(CadenzaError, match=r"run\.json: missing, but there is a checkpoint"):
        folder.begin_or_continue({})


# Checkpoints

ARRAYS = {
    "a/kernel": np.arange(6, dtype=np.float32).reshape(2, 3),
    "b": np.array(7, np.int64),
    "none": np.zeros((0, 4), bool),
}


def saved(folder: ResumableFolder, step: int) -> None:
    folder.save(asdict(Facts(step, 0.1 + 0.2, {"state": 2**127 + 1})), ARRAYS)


def test_a_checkpoint_gives_back_what_was_saved(folder):
    assert folder.load(Facts) is None
    for step in (1, 2):
        saved(folder, step)
        checkpoint = folder.load(Facts)
        assert checkpoint is not None
        facts, arrays = checkpoint
        assert facts == Facts(step, 0.1 + 0.2, {"state": 2**127 + 1})
        assert arrays.keys() == ARRAYS.keys()
        for name, array in ARRAYS.items():
            assert arrays[name].dtype == array.dtype
            np.testing.assert_array_equal(arrays[name], array)
    assert [path.name for path in folder.path.iterdir()] == [folder.checkpoint.name]


def test_facts_of_something_else_are_refused(folder):
    folder.save({"step": "three"}, {})
    with pytest.raises(CadenzaError, match=r"checkpoint\.safetensors: .*step"):
        folder.load(Facts)


@contextmanager
def no_file_over(size: int) -> Iterator[None]:
    """The system itself refuses to write more, in the middle of a file as a full disk does."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize("size", [0, 30, 300])
def test_where_there_is_no_room_the_last_checkpoint_still_loads(folder, size):
    saved(folder, 1)
    with (
        pytest.raises(CadenzaError, match=r"could not be written \(File too large\); make room"),
        no_file_over(size),
        folder.errors_of_writing(),
    ):
        saved(folder, 2)
    facts = folder.load(Facts)
    assert facts is not None
    assert facts[0].step == 1


def test_what_takes_long_is_done_less_often(monkeypatch):
    clock, began = [0.0], list[float]()

    def work() -> None:
        began.append(clock[0])
        clock[0] += 10.0

    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    now_and_then = RateLimited(work, interval=5.0, share=0.1)
    for clock[0] in (4.0, 6.0, 30.0, 115.0, 117.0):
        now_and_then()
    assert began == [6.0, 117.0]
    now_and_then(at_once=True)
    assert began[-1] == 127.0
