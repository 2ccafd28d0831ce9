"""Runs on disk: what is found again after damage, kills, and a full disk."""

from __future__ import annotations

import json
import math
import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from rl_examples import TINY, melody

from cadenza.agents.rl.config import TrainingConfig
from cadenza.agents.rl.run_folder import RunFolder, read_rows
from cadenza.errors import CadenzaError
from cadenza.model.config import SceneConfig
from cadenza.tasks.config import TaskConfig


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    (tmp_path / "run").mkdir()
    return RunFolder(tmp_path / "run")


def gathered(step: int) -> dict[str, np.ndarray]:
    return {"frames": np.arange(step), "to": np.array([step])}


class Saving:
    """Saves checkpoints, each with what was gathered since the one before."""

    def __init__(self, run: RunFolder, keep: int = 10) -> None:
        self.run, self.keep = run, keep
        self.chunks: list[dict[str, Any]] = []

    def at(self, step: int) -> None:
        self.run.add_row({"step": step})
        self.chunks.append({"file": self.run.save_gathered(step, gathered(step)), "step": step})
        self.chunks = self.chunks[-self.keep :]
        facts = {"step": step, "replay": self.chunks, "rng": 2**100 + step}
        self.run.save(facts, {"weights": np.full(1000, step)})

    def folder(self, step: int) -> Path:
        return self.run.path / "checkpoints" / f"{step:012}"


def loaded_step(run: RunFolder) -> int:
    """After a check that all parts of what is loaded go together."""
    checkpoint = run.load()
    assert checkpoint is not None
    step = checkpoint.facts["step"]
    assert checkpoint.facts["rng"] == 2**100 + step
    assert_array_equal(checkpoint.arrays["weights"], np.full(1000, step))
    steps = [chunk["step"] for chunk in checkpoint.facts["replay"]]
    assert steps[-1] == step
    for chunk, expected in zip(checkpoint.replay, steps, strict=True):
        assert_array_equal(chunk["frames"], gathered(expected)["frames"])
    assert run.rows()[-1]["step"] == step
    return step


def damage(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


# What was asked for


def test_a_run_knows_what_was_asked_for(tmp_path: Path) -> None:
    config = TrainingConfig(
        learner=replace(TINY, target_entropy=-3.0),
        task=TaskConfig(initial_buffer_time=0.1 + 0.2, n_seconds_lookahead=0.7),
        scene=SceneConfig(forearm_dofs=("tx", "tz")),
        residual=True,
        seed=2**40,
    )
    score = replace(melody(60, 64, length=1 / 3, pedal=True), title="Für", remarks=("mended",))
    RunFolder(tmp_path / "new" / "run").begin(config, score)
    assert RunFolder(tmp_path / "new" / "run").settings() == (config, score)
    about = json.loads((tmp_path / "new" / "run" / "run.json").read_bytes())
    assert about["versions"]["numpy"] == np.__version__


def test_a_run_is_begun_once(run: RunFolder) -> None:
    run.begin(TrainingConfig(), melody(60))
    with pytest.raises(CadenzaError, match="holds a run already; go on with --resume"):
        run.begin(TrainingConfig(seed=1), melody(60))
    assert run.settings()[0].seed == 0


def test_only_its_end_can_change(run: RunFolder) -> None:
    run.begin(config := TrainingConfig(num_steps=100), melody(60))
    run.set_end(config)
    assert run.settings() == (config, melody(60))
    run.set_end(longer := replace(config, num_steps=200))
    assert run.settings() == (longer, melody(60))
    with pytest.raises(CadenzaError, match="leave out all others but --num-steps"):
        run.set_end(replace(longer, num_steps=300, seed=1))
    assert run.settings() == (longer, melody(60))


def test_a_folder_without_a_run_or_with_half_of_one_is_refused(run: RunFolder) -> None:
    with pytest.raises(CadenzaError, match="holds no run to go on with"):
        run.settings()
    run.begin(TrainingConfig(), melody(60))
    content = (run.path / "run.json").read_text()
    for changed in (content[:100], "[]", "{}", content.replace('"tau"', '"tao"')):
        (run.path / "run.json").write_text(changed)
        with pytest.raises(CadenzaError, match=r"run\.json: .* of another version"):
            run.settings()


def test_one_process_at_a_time_trains_a_run(tmp_path: Path) -> None:
    first, second = RunFolder(tmp_path / "run"), RunFolder(tmp_path / "run")
    with first.locked():  # noqa: SIM117
        with pytest.raises(CadenzaError, match="another process is training"), second.locked():
            pass
    with second.locked():
        pass


# Figures


def test_rows_come_back_and_numbers_that_are_none_as_none(run: RunFolder) -> None:
    assert run.rows() == []
    run.add_row({"step": 1, "f1": 0.1 + 0.2})
    run.add_row({"step": 2, "f1": math.nan})
    assert run.rows() == [{"step": 1, "f1": 0.1 + 0.2}, {"step": 2, "f1": None}]


def test_half_a_row_is_left_out_and_rows_after_the_checkpoint_are_dropped(run: RunFolder) -> None:
    saving = Saving(run)
    saving.at(10)
    run.add_row({"step": 12})
    with open(run.path / "metrics.jsonl", "a") as file:
        file.write('{"step": 1')
    assert [row["step"] for row in read_rows(run.path)] == [10, 12]
    assert loaded_step(run) == 10
    run.add_row({"step": 11})
    assert [row["step"] for row in run.rows()] == [10, 11]


def test_rows_before_the_first_checkpoint_are_dropped(run: RunFolder) -> None:
    run.add_row({"step": 1})
    assert run.load() is None
    assert run.rows() == []


def test_figures_that_were_lost_do_not_hinder(run: RunFolder) -> None:
    saving = Saving(run)
    saving.at(10)
    (run.path / "metrics.jsonl").unlink()
    assert run.load() is not None


# Checkpoints


def test_the_newest_checkpoint_is_loaded(run: RunFolder) -> None:
    assert run.load() is None
    saving = Saving(run)
    for step in (0, 10, 2000):
        saving.at(step)
        assert loaded_step(run) == step


def test_a_checkpoint_at_the_same_step_loses_nothing(run: RunFolder) -> None:
    """As when a run stops right after a checkpoint, or goes on and stops at once."""
    saving = Saving(run)
    saving.at(10)
    name = run.save_gathered(10, {"frames": np.zeros(0, int), "to": np.array([10])})
    saving.chunks.append({"file": name, "step": 0})
    run.save({"step": 10, "replay": saving.chunks, "rng": 0}, {"weights": np.zeros(3)})
    checkpoint = run.load()
    assert checkpoint is not None
    assert [len(chunk["frames"]) for chunk in checkpoint.replay] == [10, 0]


def test_only_what_is_needed_is_kept(run: RunFolder) -> None:
    saving = Saving(run, keep=3)
    for step in range(10, 100, 10):
        saving.at(step)
    assert sorted(path.name for path in (run.path / "checkpoints").iterdir()) == [
        f"{step:012}" for step in (80, 90)
    ]
    kept = {int(path.name[:12]) for path in (run.path / "replay").iterdir()}
    assert kept == {60, 70, 80, 90}


@pytest.mark.parametrize("file", ["manifest.json", "facts.json", "arrays.npz", "replay"])
@pytest.mark.parametrize("harm", [damage, Path.unlink])
def test_a_damaged_checkpoint_gives_way_to_the_one_before_it(
    run: RunFolder, file: str, harm: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    saving = Saving(run)
    for step in (10, 20, 30):
        saving.at(step)
    newest = saving.folder(30) / file
    harm(run.path / "replay" / saving.chunks[-1]["file"] if file == "replay" else newest)
    assert loaded_step(run) == 20
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.endswith("going back to the checkpoint before it\n")
    # From there it goes on, over the place of the damaged one, too.
    saving.chunks = saving.chunks[:-1]
    saving.at(30)
    assert loaded_step(run) == 30
    assert capsys.readouterr().err == ""
    assert [row["step"] for row in run.rows()] == [10, 20, 30]


def test_where_all_are_damaged_nothing_is_started_over(run: RunFolder) -> None:
    saving = Saving(run)
    for step in (10, 20):
        saving.at(step)
        damage(saving.folder(step) / "arrays.npz")
    with pytest.raises(CadenzaError, match="no checkpoint is whole; start a new run"):
        run.load()


def test_what_a_damaged_checkpoint_needs_is_not_deleted(run: RunFolder) -> None:
    """As it is not known; the one before it may be needed to go back to."""
    saving = Saving(run, keep=1)
    saving.at(10)
    damage(saving.folder(10) / "facts.json")
    saving.at(20)
    assert len(list((run.path / "replay").iterdir())) == 2
    assert loaded_step(run) == 20


# Stopped in the middle


@contextmanager
def no_file_over(size: int) -> Iterator[None]:
    """The system itself refuses to write more, in the middle of a file as a full disk does."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize("size", [0, 30, 700, 5000])
def test_where_there_is_no_room_the_last_checkpoint_still_loads(run: RunFolder, size: int) -> None:
    """Whether it is the row, the experience, or the checkpoint that finds none."""
    saving = Saving(run)
    for step in (10, 20):
        saving.at(step)
    with (
        no_file_over(size),
        pytest.raises(CadenzaError, match=r"could not be written \(File too large\)") as error,
    ):
        saving.at(30)
    assert "\n" not in str(error.value)
    assert f"cadenza train --resume {run.path}" in str(error.value)
    assert loaded_step(run) == 20
    saving.chunks = saving.chunks[:2]
    saving.at(30)
    assert loaded_step(run) == 30


def test_what_a_kill_left_half_written_is_dropped(run: RunFolder) -> None:
    saving = Saving(run)
    saving.at(10)
    shutil.copytree(saving.folder(10), run.path / "checkpoints" / f".{20:012}.new")
    (run.path / "replay" / f".{20:012}.0.npz.abcd").write_bytes(b"half")
    (run.path / "replay" / f"{20:012}.0.npz").write_bytes(b"whole, and of no checkpoint")
    assert loaded_step(run) == 10
    saving.at(20)
    assert loaded_step(run) == 20
    left = [path.name for path in (run.path / "replay").iterdir()]
    assert sorted(left) == [f"{10:012}.0.npz", f"{20:012}.1.npz"]
    assert len(list((run.path / "checkpoints").iterdir())) == 2
