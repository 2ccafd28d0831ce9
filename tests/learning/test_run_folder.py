"""Runs on disk: what is found again after damage, kills, and a full disk."""

import errno
import json
import math
import os
from dataclasses import replace

import numpy as np
import pytest
from rl_examples import TINY, melody

from cadenza.errors import CadenzaError
from cadenza.learning.config import TrainingConfig
from cadenza.learning.metrics_log import MetricsLog
from cadenza.learning.run_folder import RunFolder
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig


@pytest.fixture
def run(tmp_path):
    (tmp_path / "run").mkdir()
    return RunFolder(tmp_path / "run")


# What was asked for


def test_a_run_knows_what_was_asked_for(tmp_path):
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


def test_a_run_is_begun_once(run):
    run.begin(TrainingConfig(), [melody(60)])
    with pytest.raises(CadenzaError, match="already holds a run; continue it with --resume"):
        run.begin(TrainingConfig(seed=1), [melody(60)])
    assert run.settings()[0].seed == 0


def test_no_two_runs_have_the_same_id(tmp_path):
    runs = [RunFolder(tmp_path / name / "run") for name in "ab"]
    for run in runs:
        run.begin(TrainingConfig(), [melody(60)])
    a, b = (run.id for run in runs)
    assert a != b
    runs[0].set_end(TrainingConfig(num_steps=7))
    assert runs[0].id == a


def test_only_its_end_can_change(run):
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


def test_a_folder_without_a_run_or_with_half_of_one_is_refused(run):
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


# Figures


def test_rows_come_back_and_numbers_that_are_none_as_none(run):
    assert run.metrics.rows() == []
    run.metrics.add({"step": 1, "seconds": 0.5, "f1": 0.1 + 0.2})
    run.metrics.add({"step": 2, "seconds": 1.0, "f1": math.nan, "loss": math.inf})
    assert run.metrics.rows() == [
        {"step": 1, "seconds": 0.5, "f1": 0.1 + 0.2},
        {"step": 2, "seconds": 1.0, "f1": None, "loss": None},
    ]


def test_half_a_row_is_left_out_and_rows_after_a_checkpoint_are_dropped(run):
    run.metrics.add({"step": 10, "seconds": 1.0})
    size = run.metrics.size
    run.metrics.add({"step": 12, "seconds": 1.2})
    with open(run.path / "metrics.jsonl", "a") as file:
        file.write('{"step": 1')
    assert [row["step"] for row in MetricsLog(run.path).rows()] == [10, 12]
    run.metrics.truncate(size)
    run.metrics.add({"step": 11, "seconds": 1.1})
    assert [row["step"] for row in run.metrics.rows()] == [10, 11]


def test_shortened_figures_are_not_lengthened(run, capsys):
    for step in (10, 20):
        run.metrics.add({"step": step, "seconds": 1.0})
    path, size = run.path / "metrics.jsonl", run.metrics.size
    path.write_bytes(path.read_bytes()[:-5])
    run.metrics.truncate(size)
    assert capsys.readouterr().err == f"{path}: rows of metrics are missing\n"
    run.metrics.add({"step": 30, "seconds": 3.0})
    assert [row["step"] for row in run.metrics.rows()] == [10, 30]
    assert b"\0" not in path.read_bytes()


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"[1, 2]",
        b'{"step": 1}',
        b'{"step": null, "seconds": 1}',
        b'{"step": 1, "seconds": "2"}',
        b'{"step": 1, "seconds": 2, "eval/f1": [0.5]}',
        b'{"step": 1, "seconds": 2, "eval/f1": 1e999}',
        b'{"step": ' + b"1" * 400 + b', "seconds": 2}',
        b"\xff\xfe",
        b"[" * 100_000,
    ],
)
def test_lines_that_are_no_rows_are_left_out(run, line, capsys):
    good = b'{"step": 1, "seconds": 0.5, "eval/f1": null}\n'
    (run.path / "metrics.jsonl").write_bytes(good + line + b"\n" + bytes(9) + good + b"half")
    row = {"step": 1, "seconds": 0.5, "eval/f1": None}
    assert run.metrics.rows() == [row, row]
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "skipped lines that are not rows of metrics: 1\n" in message


# Links


def test_links_are_not_followed(run, tmp_path):
    dear = tmp_path / "dear"
    dear.write_text("dear")
    (run.path / "lock").symlink_to(dear)
    with pytest.raises(CadenzaError, match="lock: cannot be locked"), run.locked():
        pass
    assert dear.read_text() == "dear"


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES])
def test_a_run_where_nothing_can_be_written_is_to_be_copied(run, monkeypatch, number):
    def fail(path: str, *_: object) -> int:
        raise OSError(number, os.strerror(number), path)

    monkeypatch.setattr(os, "open", fail)
    with pytest.raises(CadenzaError, match=r"cannot be locked .*; copy the folder"), run.locked():
        pass


def test_what_a_lock_holds_is_kept(run):
    (run.path / "lock").write_text("dear")
    with run.locked():
        pass
    assert (run.path / "lock").read_text() == "dear"
