"""Runs on disk: what is found again after damage, kills, and a full disk."""

from __future__ import annotations

import errno
import json
import math
import os
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

from cadenza.errors import CadenzaError
from cadenza.files import TEMPORARY
from cadenza.learning.config import TrainingConfig
from cadenza.learning.metrics_log import MetricsLog
from cadenza.learning.run_folder import Chunk, Facts, RunFolder
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    (tmp_path / "run").mkdir()
    return RunFolder(tmp_path / "run")


def gathered(step: int) -> dict[str, np.ndarray]:
    return {"frames": np.arange(step), "to": np.array([step])}


def facts(step: int, chunks: list[Chunk]) -> Facts:
    rng = {"state": 2**100 + step}
    finished, ends = ((0.5, None),), ((0, 100),)
    return Facts(
        step, step / 10, {"eval/f1": None}, rng, {}, finished, tuple(chunks), ends, None, 0
    )


class Saving:
    """Saves checkpoints, each with what was gathered since the one before."""

    def __init__(self, run: RunFolder, keep: int = 10) -> None:
        self.run, self.keep = run, keep
        self.chunks: list[Chunk] = []

    def at(self, step: int) -> None:
        self.run.add_row({"step": step, "seconds": step / 10})
        self.chunks.append(Chunk(self.run.save_experience(step, gathered(step)), (step,)))
        self.chunks = self.chunks[-self.keep :]
        self.run.save(facts(step, self.chunks), {"weights": np.full(1000, step)})

    def folder(self, step: int) -> Path:
        return self.run.path / "checkpoints" / f"{step:012}"


def loaded_step(run: RunFolder) -> int:
    """Returns the step of what is loaded, after a check that all its parts go together."""
    checkpoint = run.load()
    assert checkpoint is not None
    step = checkpoint.facts.step
    kept = replace(checkpoint.facts, metrics_size=0)
    assert kept == facts(step, list(kept.replay))
    assert_array_equal(checkpoint.arrays["weights"], np.full(1000, step))
    steps = [chunk.frames for chunk in checkpoint.facts.replay]
    assert steps[-1] == step
    for chunk, expected in zip(checkpoint.replay, steps, strict=True):
        if chunk is not None:
            assert_array_equal(chunk["frames"], gathered(expected)["frames"])
    assert run.metrics.rows()[-1]["step"] == step
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
    RunFolder(tmp_path / "new" / "run").begin(config, [score])
    assert RunFolder(tmp_path / "new" / "run").settings() == (config, (score,))
    about = json.loads((tmp_path / "new" / "run" / "run.json").read_bytes())
    assert about["versions"]["numpy"] == np.__version__


def test_a_run_is_begun_once(run: RunFolder) -> None:
    run.begin(TrainingConfig(), [melody(60)])
    with pytest.raises(CadenzaError, match="already holds a run; continue it with --resume"):
        run.begin(TrainingConfig(seed=1), [melody(60)])
    assert run.settings()[0].seed == 0


def test_what_is_left_of_a_run_is_not_taken_for_a_new_one(run: RunFolder) -> None:
    run.begin(TrainingConfig(), [melody(60)])
    Saving(run).at(10)
    (run.path / "run.json").unlink()
    with pytest.raises(CadenzaError, match=r"run\.json: missing, but there are checkpoints"):
        run.begin(TrainingConfig(seed=1), [melody(62)])


def test_no_two_runs_have_the_same_id(tmp_path: Path) -> None:
    runs = [RunFolder(tmp_path / name / "run") for name in "ab"]
    for run in runs:
        run.begin(TrainingConfig(), [melody(60)])
    a, b = (run.id for run in runs)
    assert a != b
    runs[0].set_end(TrainingConfig(num_steps=7))
    assert runs[0].id == a


def test_only_its_end_can_change(run: RunFolder) -> None:
    run.begin(config := TrainingConfig(num_steps=100), [melody(60)])
    run.set_end(config)
    assert run.settings() == (config, (melody(60),))
    run.set_end(longer := replace(config, num_steps=200))
    assert run.settings() == (longer, (melody(60),))
    with pytest.raises(CadenzaError, match="leave out all but --num-steps"):
        run.set_end(replace(longer, num_steps=300, seed=1))
    with pytest.raises(CadenzaError, match="num_steps 0: choose 1 or more"):
        run.set_end(replace(longer, num_steps=0))
    assert run.settings() == (longer, (melody(60),))


def test_a_folder_without_a_run_or_with_half_of_one_is_refused(run: RunFolder) -> None:
    with pytest.raises(CadenzaError, match="holds no run to resume"):
        run.settings()
    run.begin(TrainingConfig(), [melody(60)])
    content = (run.path / "run.json").read_text()
    (run.path / "run.json").write_text('{"command": "cadenza clone"}')
    with pytest.raises(CadenzaError, match="holds a run of cadenza clone, which that"):
        run.settings()
    for changed in (content[:100], "[]", "{}", content.replace('"tau"', '"tao"')):
        (run.path / "run.json").write_text(changed)
        with pytest.raises(CadenzaError, match=r"run\.json: .* from another version"):
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
    assert run.metrics.rows() == []
    run.add_row({"step": 1, "seconds": 0.5, "f1": 0.1 + 0.2})
    run.add_row({"step": 2, "seconds": 1.0, "f1": math.nan, "loss": math.inf})
    assert run.metrics.rows() == [
        {"step": 1, "seconds": 0.5, "f1": 0.1 + 0.2},
        {"step": 2, "seconds": 1.0, "f1": None, "loss": None},
    ]


def test_half_a_row_is_left_out_and_rows_after_the_checkpoint_are_dropped(run: RunFolder) -> None:
    saving = Saving(run)
    saving.at(10)
    run.add_row({"step": 12, "seconds": 1.2})
    with open(run.path / "metrics.jsonl", "a") as file:
        file.write('{"step": 1')
    assert [row["step"] for row in MetricsLog(run.path).rows()] == [10, 12]
    assert loaded_step(run) == 10
    run.add_row({"step": 11, "seconds": 1.1})
    assert [row["step"] for row in run.metrics.rows()] == [10, 11]


def test_rows_before_the_first_checkpoint_are_dropped(run: RunFolder) -> None:
    run.add_row({"step": 1, "seconds": 0.1})
    assert run.load() is None
    assert run.metrics.rows() == []


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
    """This is so when a run stops right after a checkpoint, or goes on and stops at once."""
    saving = Saving(run)
    saving.at(10)
    name = run.save_experience(10, {"frames": np.zeros(0, int), "to": np.array([10])})
    saving.chunks.append(Chunk(name, (10,)))
    run.save(facts(10, saving.chunks), {"weights": np.zeros(3)})
    checkpoint = run.load()
    assert checkpoint is not None
    assert [len(chunk["frames"]) for chunk in checkpoint.replay if chunk] == [10, 0]


def test_only_what_is_needed_is_kept(run: RunFolder) -> None:
    saving = Saving(run, keep=3)
    for step in range(10, 100, 10):
        saving.at(step)
    assert sorted(path.name for path in (run.path / "checkpoints").iterdir()) == [
        f"{step:012}" for step in (80, 90)
    ]
    kept = {int(path.name[:12]) for path in (run.path / "replay").iterdir()}
    assert kept == {60, 70, 80, 90}


@pytest.mark.parametrize("file", ["manifest.json", "facts.json", "arrays.safetensors", "replay"])
@pytest.mark.parametrize("harm", [damage, Path.unlink])
def test_a_damaged_checkpoint_gives_way_to_the_one_before_it(
    run: RunFolder, file: str, harm: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    saving = Saving(run)
    for step in (10, 20, 30):
        saving.at(step)
    newest = saving.folder(30) / file
    harm(run.path / "replay" / saving.chunks[-1].file if file == "replay" else newest)
    assert loaded_step(run) == 20
    what, then = capsys.readouterr().err.splitlines()
    assert str(run.path / ("replay" if file == "replay" else "checkpoints")) in what
    assert then == f"{run.path}: going back to step 20"
    # From there it goes on, over the place of the damaged one, too.
    saving.chunks = saving.chunks[:-1]
    saving.at(30)
    assert loaded_step(run) == 30
    assert capsys.readouterr().err == ""
    assert [row["step"] for row in run.metrics.rows()] == [10, 20, 30]


def test_where_all_are_damaged_nothing_is_started_over(run: RunFolder) -> None:
    saving = Saving(run)
    for step in (10, 20):
        saving.at(step)
        damage(saving.folder(step) / "arrays.safetensors")
    with pytest.raises(CadenzaError, match="no checkpoint is intact; start a new run"):
        run.load()


def test_what_a_damaged_checkpoint_needs_is_not_deleted(run: RunFolder) -> None:
    """It is not known what it needs, and the one before it may have to serve."""
    saving = Saving(run, keep=1)
    saving.at(10)
    damage(saving.folder(10) / "facts.json")
    saving.at(20)
    assert len(list((run.path / "replay").iterdir())) == 2
    assert loaded_step(run) == 20


# Strangers, and losses


@pytest.mark.parametrize("name", [".DS_Store", ".nfs000001", "notes.txt", "²", "x.npz", ".x"])
@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_is_not_of_a_run_is_left_alone(run: RunFolder, name: str, kind: str) -> None:
    saving = Saving(run)
    saving.at(10)
    strange = [run.path / part / name for part in ("checkpoints", "replay", "")]
    for path in strange:
        if kind == "file":
            path.touch()
        else:
            (path / "more").mkdir(parents=True)
    assert loaded_step(run) == 10
    for step in (20, 30, 40):
        saving.at(step)
    assert loaded_step(run) == 40
    assert all(path.exists() for path in strange)


def test_a_file_named_like_a_checkpoint_is_none(run: RunFolder) -> None:
    saving = Saving(run)
    saving.at(10)
    saving.folder(20).touch()
    assert loaded_step(run) == 10
    saving.at(20)
    assert loaded_step(run) == 20


def lose(run: RunFolder, chunk: Chunk) -> None:
    (run.path / "replay" / chunk.file).unlink()


def test_one_lost_file_of_old_experience_costs_that_experience(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    saving = Saving(run)
    for step in (10, 25, 30, 40):
        saving.at(step)
    lose(run, saving.chunks[1])
    assert loaded_step(run) == 40
    what, then = capsys.readouterr().err.splitlines()
    assert saving.chunks[1].file in what
    assert then == f"{run.path}: up to 15 transitions are lost"


def test_goes_back_where_less_is_lost_by_it(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    """The checkpoint before does not need the newest file; both need the oldest."""
    saving = Saving(run)
    for step in (10, 20, 100):
        saving.at(step)
    for chunk in (saving.chunks[0], saving.chunks[2]):
        lose(run, chunk)
    assert loaded_step(run) == 20
    *_, back, without = capsys.readouterr().err.splitlines()
    assert back.endswith("going back to step 20")
    assert without.endswith("up to 10 transitions are lost")


def test_shortened_figures_are_not_lengthened(
    run: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    saving = Saving(run)
    for step in (10, 20):
        saving.at(step)
    path = run.path / "metrics.jsonl"
    path.write_bytes(path.read_bytes()[:-5])
    assert run.load() is not None
    assert capsys.readouterr().err == f"{path}: rows of metrics are missing\n"
    run.add_row({"step": 30, "seconds": 3.0})
    assert [row["step"] for row in run.metrics.rows()] == [10, 30]
    assert b"\0" not in path.read_bytes()


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"[1, 2]",
        b"3",
        b"null",
        b"{'step': 1}",
        b'{"step": 1}',
        b'{"step": null, "seconds": 1}',
        b'{"step": 1, "seconds": "2"}',
        b'{"step": true, "seconds": 2}',
        b'{"step": 1, "seconds": 2, "eval/f1": [0.5]}',
        b'{"step": 1, "seconds": 2, "eval/f1": Infinity}',
        b'{"step": 1, "seconds": 2, "eval/f1": 1e999}',
        b'{"step": ' + b"1" * 400 + b', "seconds": 2}',
        b'{"step": 1, "seconds": 2, "\\ud800": 1}',
        b"\xff\xfe",
        b"[" * 100_000,
    ],
)
def test_lines_that_are_no_rows_are_left_out(
    run: RunFolder, line: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    good = b'{"step": 1, "seconds": 0.5, "eval/f1": null}\n'
    (run.path / "metrics.jsonl").write_bytes(good + line + b"\n" + bytes(9) + good + b"half")
    row = {"step": 1, "seconds": 0.5, "eval/f1": None}
    assert run.metrics.rows() == [row, row]
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "skipped lines that are not rows of metrics: 1\n" in said


# Links


def test_links_are_not_followed(run: RunFolder, tmp_path: Path) -> None:
    dear = tmp_path / "dear"
    dear.write_text("dear")
    (run.path / "lock").symlink_to(dear)
    with pytest.raises(CadenzaError, match="lock: cannot be locked"), run.locked():
        pass
    assert run.load() is None
    assert dear.read_text() == "dear"


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES])
def test_a_run_where_nothing_can_be_written_is_to_be_copied(
    run: RunFolder, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def fail(path: str, *_: object) -> int:
        raise OSError(number, os.strerror(number), path)

    monkeypatch.setattr(os, "open", fail)
    with pytest.raises(CadenzaError, match=r"cannot be locked .*; copy the folder"), run.locked():
        pass


def test_what_a_lock_holds_is_kept(run: RunFolder) -> None:
    (run.path / "lock").write_text("dear")
    with run.locked():
        pass
    assert (run.path / "lock").read_text() == "dear"


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


def test_a_kill_between_two_renames_loses_no_checkpoint(run: RunFolder) -> None:
    """A checkpoint that replaces one of the same step sets that aside for a moment."""
    saving = Saving(run)
    saving.at(10)
    aside, new = (run.path / "checkpoints" / f".{10:012}.{end}" for end in ("old", "new"))
    shutil.copytree(saving.folder(10), new)
    saving.folder(10).rename(aside)
    assert loaded_step(run) == 10
    assert [path.name for path in (run.path / "checkpoints").iterdir()] == [f"{10:012}"]


def test_what_a_kill_left_half_written_is_dropped(run: RunFolder) -> None:
    saving = Saving(run)
    saving.at(10)
    shutil.copytree(saving.folder(10), run.path / "checkpoints" / f".{20:012}.new")
    (run.path / "replay" / f"{TEMPORARY}0123456789abcdef").write_bytes(b"half")
    (run.path / "replay" / f"{20:012}.0.npz").write_bytes(b"whole, and of no checkpoint")
    assert loaded_step(run) == 10
    saving.at(20)
    assert loaded_step(run) == 20
    left = [path.name for path in (run.path / "replay").iterdir()]
    assert sorted(left) == [f"{10:012}.0.npz", f"{20:012}.1.npz"]
    assert len(list((run.path / "checkpoints").iterdir())) == 2
