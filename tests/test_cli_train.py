"""`cadenza train` as a person meets it, and what it leaves to play with."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cadenza.cli import main, train
from cadenza.learning import problem
from cadenza.learning.policy_folder import load_policy
from cadenza.learning.run_folder import RunFolder
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score

TUNE = Score((Note(0.0, 0.25, 60), Note(0.25, 0.5, 64), Note(0.25, 0.6, 67)))
SMALL = ["--hidden-sizes", "16", "16", "--batch-size", "8", "--num-envs", "2", "--no-video"]
SMALL += ["--no-residual", "--onset-timing-coefficient", "0.5"]
SHORT = ["--num-steps", "200", "--learning-starts", "64", "--eval-interval", "100"]
SHORT += ["--log-interval", "50", "--train-freq", "8"]


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    assert stop.value.code == 1
    *before, line = capsys.readouterr().err.splitlines()
    assert all("cores are in use" in other for other in before), before
    return line


@pytest.fixture(scope="module")
def tune(tmp_path_factory):
    path = tmp_path_factory.mktemp("songs") / "tune.mid"
    write_midi(TUNE, path)
    return path


@pytest.fixture(scope="module")
def run(tune, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "tune"
    main(["train", str(tune), "-o", str(folder), *SMALL, *SHORT])
    return folder


def rows(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def test_a_run_leaves_what_the_readme_names(run):
    for name in ("run.json", "metrics.jsonl", "report.html", "best", "last", "best_played"):
        assert (run / name).exists(), name
    assert list((run / "tensorboard").glob("events.out.tfevents.*"))
    evaluated = [row for row in rows(run) if "eval/f1" in row]
    assert [row["eval_step"] for row in evaluated] == [112, 208]
    assert "best_played/report.html" in (run / "report.html").read_text()


def test_tensorboard_has_the_figures(run):
    from tensorboardX.proto.event_pb2 import Event  # of the library that wrote them
    from tensorboardX.record_writer import masked_crc32c

    (path,) = (run / "tensorboard").glob("events.*")
    data, seen = path.read_bytes(), {}
    while data:  # a record: length, its checksum, content, its checksum
        size = int.from_bytes(data[:8], "little")
        content, data = data[12 : 12 + size], data[16 + size :]
        assert masked_crc32c(content) is not None
        event = Event.FromString(content)
        for value in event.summary.value:
            seen[event.step, value.tag] = value.simple_value
    for row in rows(run):
        if "eval/f1" in row:
            assert seen[row["eval_step"], "eval/f1"] == pytest.approx(row["eval/f1"])


def test_a_policy_learns_when_notes_begin_and_how_loud_and_plays(run, tune, capsys):
    """It is evaluated and played with the terms that it learnt by."""
    terms = {name for row in rows(run) for name in row if name.startswith("eval/reward/")}
    assert {"eval/reward/onset_timing", "eval/reward/loudness"} <= terms
    task = load_policy(run / "best").task
    assert (task.onset_goals, task.onset_timing_coefficient) == (True, 0.5)
    metrics = json.loads((run / "best_played" / "metrics.json").read_text())
    assert metrics["reward/loudness"] >= 0
    assert "was trained with onset_goals True, but here it is False" in refused(
        capsys, "play", tune, "--agent", run, "--no-onset-goals"
    )


def test_help_shows_the_named_preset(capsys):
    shown = {}
    for name in ("paper", "published", "fast"):
        with pytest.raises(SystemExit):
            main(["train", "--preset", name, "--help-all"])
        shown[name] = " ".join(capsys.readouterr().out.split())
    assert "--discount FLOAT" in shown["paper"]
    for name, discount in (("paper", "0.99"), ("published", "0.8"), ("fast", "0.84")):
        assert f"(default: {discount})" in shown[name], name
    with pytest.raises(SystemExit):
        main(["train", "--setup", "mini-allegro", "--help-all"])
    assert "(default: 128 128)" in " ".join(capsys.readouterr().out.split())


def test_a_finished_run_stays_finished(run, capsys):
    before = rows(run)
    main(["train", "--resume", str(run), "--no-video"])
    assert "Learning curves in" in capsys.readouterr().out
    assert rows(run) == before


def test_a_run_goes_on_to_another_end(run, tmp_path, capsys, monkeypatch):
    pages = []
    monkeypatch.setattr(
        "cadenza.report.training_page.training_page", lambda *page: pages.append(page) or iter(())
    )
    longer = tmp_path / "longer"
    shutil.copytree(run, longer)
    main(["train", "--resume", str(longer), "--num-steps", "300", "--no-video"])
    capsys.readouterr()
    assert rows(longer)[: len(rows(run))] == rows(run)
    assert rows(longer)[-1]["eval_step"] == 304
    *before, last = [page[-1] for page in pages]
    assert all(before)  # while it went on: once or, where that takes long, more often
    assert len(before) > 0
    assert not last
    with pytest.raises(SystemExit):
        main(["train", "--resume", str(longer), "--help-all"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "(default: 300)" in shown  # the run's own
    assert "(default: 16 16)" in shown


def test_curves_of_several_runs_make_one_page(run, tmp_path, capsys):
    other, page = tmp_path / "other", tmp_path / "curves.html"
    shutil.copytree(run, other)
    main(["curves", str(run), str(other), "-o", str(page)])
    assert all(f.name in page.read_text() for f in (run, other))
    assert "mean of" not in page.read_text()  # they do not differ, but for the seed
    about = json.loads((other / "run.json").read_text())
    about["config"]["num_steps"] = 300
    (other / "run.json").write_text(json.dumps(about))
    main(["curves", str(run), str(other), "-o", str(page)])
    assert 'class="run1"></i>num steps 300<' in page.read_text()
    bare = tmp_path / "elise_3"
    bare.mkdir()
    shutil.copy(run / "metrics.jsonl", bare)
    main(["curves", str(run), str(bare), "-o", str(page)])
    assert "<h1>tune · elise</h1>" in page.read_text()
    picture = tmp_path / "curves.png"
    assert "a .html page" in refused(capsys, "curves", run, "-o", picture)
    assert "holds no metrics" in refused(capsys, "curves", tmp_path, "-o", page)
    assert not picture.exists()


def test_ctrl_c_leaves_a_checkpoint_and_says_how_to_go_on(tune, tmp_path):
    folder = tmp_path / "run"
    code = "from cadenza.cli import main; main()"
    command = [sys.executable, "-c", code, "train", str(tune), "-o", str(folder), *SMALL]
    process = subprocess.Popen(
        [*command, "--log-interval", "50"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "JAX_PLATFORMS": "cpu"},
    )
    metrics, waited = folder / "metrics.jsonl", time.monotonic()
    while not (metrics.exists() and metrics.read_text()):
        assert time.monotonic() - waited < 120
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, output = process.communicate(timeout=120)
    assert process.returncode == 130, output
    assert f"cadenza train --resume {folder}" in output
    assert "Traceback" not in output
    assert (folder / "checkpoint.safetensors").exists()
    assert (folder / "report.html").exists()


@contextmanager
def at_once(_: str) -> Iterator[Callable[[], bool]]:
    """In place of `stop_on_signal`."""
    yield lambda: True


@pytest.mark.parametrize("when", ["while it is made", "before the first figures"])
def test_a_run_that_is_stopped_at_once_can_go_on(when, tune, tmp_path, capsys, monkeypatch):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    folder = tmp_path / "run"
    with monkeypatch.context() as patch:
        if when == "while it is made":
            patch.setattr(problem, "reference_of", interrupted)
        else:
            patch.setattr(train, "stop_on_signal", at_once)
        with pytest.raises(SystemExit) as stop:
            main(["train", str(tune), "-o", str(folder), *SMALL, "--residual"])
    assert stop.value.code == 130
    message = capsys.readouterr().err
    assert f"to continue: cadenza train --resume {folder}" in message
    assert "figures" not in message
    assert RunFolder(folder).settings()[1][0].notes == load_score(str(tune)).notes


def test_a_run_with_a_hand_of_ones_own_goes_on_where_that_is_given_again(
    tune, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, ""])
    Path("own_hand.py").write_text("from cadenza.hands.shadow import SHADOW as MINE")
    hand = ["--hand", "own_hand:MINE"]
    monkeypatch.setattr(train, "stop_on_signal", at_once)
    go_on = ["train", "--resume", "run", *hand]
    for begin_or_go_on in ["train", str(tune), "-o", "run", *SMALL, *hand], go_on:
        with pytest.raises(SystemExit):
            main(begin_or_go_on)
        assert f"to continue: cadenza {' '.join(go_on)}\n" in capsys.readouterr().err
        del sys.modules["own_hand"]  # as at the end of the process
    assert "give --hand own_hand:MINE if you trust it" in refused(capsys, *go_on[:3])
    Path("run/metrics.jsonl").write_text(
        '{"step": 9, "seconds": 1, "eval_step": 9, "eval/f1": 1}\n'
    )
    main(["curves", "run"])  # needs no hand
    assert "own_hand" not in sys.modules


def test_a_run_is_begun_by_one_process_alone(tune, tmp_path, capsys):
    """The second neither begins another run in the folder nor changes the first."""
    with RunFolder(tmp_path / "run").locked():
        assert "another process" in refused(capsys, "train", tune, "-o", tmp_path / "run", *SMALL)
    assert not (tmp_path / "run" / "run.json").exists()


def test_a_run_that_cannot_be_made_leaves_its_folder_free(tune, tmp_path, capsys, monkeypatch):
    command = "train", tune, "-o", tmp_path / "run", *SMALL, *SHORT
    assert "not enough memory" in refused(capsys, *command, "--buffer-size", 10**14)
    assert "control_timestep" in refused(capsys, *command, "--control-timestep", 0.0333)
    monkeypatch.setattr(train, "stop_on_signal", at_once)
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in command])
    assert stop.value.code == 130  # it had begun


def test_what_makes_no_sense_is_said_in_a_line(run, tune, tmp_path, capsys):
    assert "give a song" in refused(capsys, "train")
    assert "give a song" in refused(capsys, "train", tune, "--resume", run)
    assert "already holds a run" in refused(capsys, "train", tune, "-o", run)
    assert "no run" in refused(capsys, "train", "--resume", tmp_path / "none")
    options = ("--resume", run, "--batch-size", 9)
    assert "its own options" in refused(capsys, "train", *options)
    options = ("--resume", run, "--preset", "paper")
    assert "leave out --preset" in refused(capsys, "train", *options)
    hand = "hand nowhere:HAND: cannot import 'nowhere': ModuleNotFoundError"
    assert hand in refused(capsys, "train", tune, "--hand", "nowhere:HAND")
    assert "num_cores 0" in refused(capsys, "train", tune, "--num-cores", 0)
    assert "no agent 'nobody'" in refused(capsys, "play", tune, "--agent", "nobody")
    assert "no pretrained policy" in refused(capsys, "play", tune, "--agent", "pretrained")
