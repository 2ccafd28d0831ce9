"""`cadenza bench` as a person meets it, with Ctrl-C, kills and others, and `cadenza results`."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from cadenza.cli import main
from cadenza.evaluation.bench import BenchState
from cadenza.evaluation.jobs import BenchJob, JobSpec
from cadenza.evaluation.results import BenchResults, read_results
from cadenza.evaluation.run_status import read_progress
from cadenza.learning.config import preset
from cadenza.learning.policy_folder import load_policy
from cadenza.learning.pretrained import pretrained_folder
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.tasks.config import TaskConfig
from evaluation.made_up import write_bench
from refusals import refused

AGENTS = Path(__file__).parent / "evaluation"
CHANGES = ("planning_seconds", "playing_seconds")  # from run to run
_PATIENCE = 600.0  # [s] a machine may be busy


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """With two songs of one note each, and the folder out for results."""
    for pitch in 60, 64:
        write_midi(Score((Note(0.0, 0.3, pitch),)), tmp_path / "songs" / f"{pitch}.mid")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def options(agents: str, *others: str) -> list[str]:
    chosen = ["--songs", "songs", "--agents", agents, "-o", "out", "--pages", "none"]
    return ["bench", *chosen, "--jobs", "2", *others]


def started(agents: str, *others: str) -> subprocess.Popen[str]:
    """The command, under way."""
    paths = os.pathsep.join([*filter(None, sys.path), str(AGENTS)])
    return subprocess.Popen(
        [sys.executable, "-m", "cadenza", *options(agents, *others)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": paths},
        start_new_session=True,
    )


def of(command: subprocess.Popen[str], status: int = 0) -> str:
    """All that it says until it ends."""
    try:
        out, err = command.communicate(timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        command.kill()
        raise
    assert command.returncode == status, out + err
    return out + err


def until(what: Callable[[], object]) -> None:
    """Wait for a condition."""
    end = time.monotonic() + _PATIENCE
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def under_way(folder: Path, stage: str = "playing") -> list[int]:
    """Processes of runs that are that far."""
    at = [read_progress(run) for run in (folder / "out" / "runs").glob("*")]
    return [status.pid for status in at if status is not None and status.stage == stage]


def in_short(results: BenchResults) -> dict[str, object]:
    """What is the same whenever and however often it is done."""
    return {
        result.folder.name: {n: v for n, v in result.metrics.items() if n not in CHANGES}
        for result in results.results
    }


def test_those_that_crash_take_nothing_else_with_them(folder, monkeypatch, capsys):
    (folder / "songs" / "64.mid").unlink()
    monkeypatch.syspath_prepend(AGENTS)
    monkeypatch.setattr("cadenza.evaluation.bench._MAX_ATTEMPTS", 1)
    with pytest.raises(SystemExit) as stop:
        main(options("bench_agents:Aborts,bench_agents:IsToldToEnd,zero"))
    assert stop.value.code == 1
    out, err = capsys.readouterr()
    assert "1 of 3 runs finished, 2 failed" in out
    assert "2 of 3 runs failed, as told above; once the causes are mended, add --retry" in err
    assert "3 of 3: " in err
    results = read_results(folder / "out")
    assert [result.agent for result in results.results] == ["zero"]
    reasons = sorted(run.reason for run in results.unfinished)
    assert ["SIGABRT" in reasons[0], "SIGTERM" in reasons[1]] == [True, True]


@pytest.mark.parametrize(
    ("others", "what"),
    [
        (("--seeds", "x"), "seeds x: give whole numbers"),
        (("--seeds", "3-1"), "FIRST-LAST"),
        (("--seeds", ","), "no seed"),
        (("--seeds", "0-9999,10000-19999"), "2 songs, 1 agent, 20,000 seeds: 40,000 runs, but"),
        (("--agents", ","), "nobody plays"),
        (("--agents", "playback"), "playback plays a single file"),
        (("--agents", "nobody"), "no agent 'nobody'"),
        (("--agents", "pretrained"), "nothing to run"),
        (("--agents", "train:fats"), "choose from train:fast"),
        (("--agents", "train:fast", "--num-steps", "0"), "num_steps 0"),
        (("--songs", "nothing"), "no song library 'nothing'"),
        (("--jobs", "0"), "jobs 0"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(folder, others, what, capsys):
    *warned, last = refused(capsys, *options("zero", *others)).splitlines()
    assert what in last
    assert all("no policy comes with it" in line for line in warned)
    assert not (folder / "out").exists()


def test_a_policy_plays_as_it_was_trained_unless_told_otherwise(folder, monkeypatch):
    planned: dict[str, JobSpec] = {}

    def plan(jobs: list[BenchJob], *_: object) -> BenchState:
        planned.update({job.spec.agent: job.spec for job in jobs})
        return BenchState(folder, 0)

    monkeypatch.setattr("cadenza.evaluation.bench.bench", plan)
    policy = str(pretrained_folder("OdeToJoy"))
    main(options(f"{policy}/,train:paper,train:fast-residual,zero", "--stretch", "2"))
    learnt = load_policy(Path(policy))
    assert planned[policy].task == replace(learnt.task, stretch=2.0)
    assert planned[policy].scene == learnt.scene
    assert planned[policy].agent_digest
    paper = preset("paper")
    paper = replace(paper, task=replace(paper.task, stretch=2.0))
    assert planned["train:paper"].config == paper
    residual = preset("fast", residual=True)
    residual = replace(residual, task=replace(residual.task, stretch=2.0))
    assert planned["train:fast-residual"].config == residual
    assert planned["zero"].task == replace(TaskConfig(), stretch=2.0)


def test_other_weights_in_the_same_file_are_another_run(folder, monkeypatch, tmp_path):
    weights, planned = tmp_path / "weights.npz", list[JobSpec]()

    def plan(jobs: list[BenchJob], *_: object) -> BenchState:
        planned.append(jobs[0].spec)
        return BenchState(folder, 0)

    monkeypatch.setattr("cadenza.evaluation.bench.bench", plan)
    for content in b"one", b"other", b"one":
        weights.write_bytes(content)
        main(options("generalist", "--generalist.weights", str(weights)))
    main(options("generalist"))
    one, other, again, without = planned
    assert one.name == again.name
    assert len({spec.name for spec in (one, other, without)}) == 3
    assert without.agent_digest == ""


@pytest.mark.slow
def test_control_c_says_what_is_left_and_the_same_command_goes_on(folder):
    command = started("bench_agents:Slow")
    until(lambda: under_way(folder))
    os.killpg(command.pid, signal.SIGINT)  # as a terminal does
    message = of(command, status=130)
    assert "0 of 2 runs finished, 2 left" in message
    assert "run the same command again" in message
    assert "Traceback" not in message
    assert "2 of 2 runs finished" in of(started("bench_agents:Slow"))


@pytest.mark.slow
def test_a_run_that_is_killed_loses_only_itself_and_is_taken_up_again(folder):
    command = started("bench_agents:Counted")
    until(lambda: under_way(folder))
    os.kill(under_way(folder)[0], signal.SIGKILL)
    message = of(command)
    assert "its process was killed (SIGKILL)" in message
    assert "it will be taken up again" in message
    assert "2 of 2 runs finished" in message
    assert len(list(folder.glob("begun-*"))) == 3


@pytest.mark.slow
def test_runs_end_with_the_bench_that_was_killed(folder):
    command = started("bench_agents:Slow", "--stretch", "100")
    until(lambda: under_way(folder))
    (pid, *_) = under_way(folder)
    command.kill()
    command.communicate()
    until(lambda: not Path(f"/proc/{pid}").exists())


@pytest.mark.slow
def test_killed_at_random_it_finishes_with_the_same_results(folder):
    chosen = "bench_agents:Slow,planner", "--seeds", "0-1"
    rng = random.Random(0)
    for _ in range(6):
        command = started(*chosen)
        time.sleep(rng.uniform(1.0, 12.0))
        if rng.random() < 0.5:  # one run only
            for pid in under_way(folder)[:1]:
                os.kill(pid, signal.SIGKILL)
            time.sleep(rng.uniform(0.0, 2.0))
        command.kill()
        command.communicate()
    assert "8 of 8 runs finished" in of(started(*chosen))
    results = read_results(folder / "out")
    assert not results.broken
    of(started(*chosen, "-o", "afresh"))
    assert in_short(results) == in_short(read_results(folder / "afresh"))


@pytest.mark.slow
def test_two_benches_share_the_runs_of_a_folder(folder):
    commands = [started("bench_agents:Counted", "--seeds", "0-1") for _ in range(2)]
    for command in commands:
        assert "4 of 4 runs finished" in of(command)
    assert len(list(folder.glob("begun-*"))) == 4
    assert len(read_results(folder / "out").results) == 4


@pytest.mark.slow
def test_a_run_of_a_bench_that_was_killed_is_taken_up_by_another(folder):
    chosen = "bench_agents:Slow", "--stretch", "10"
    first = started(*chosen)
    until(lambda: len(under_way(folder)) == 2)
    second = started(*chosen)
    time.sleep(2.0)
    first.kill()
    first.communicate()
    assert "2 of 2 runs finished" in of(second)


@pytest.mark.slow
def test_training_goes_through_the_same_matrix_and_is_resumed(folder):
    (folder / "songs" / "64.mid").unlink()
    chosen = "train:fast", "--num-steps", "6000"
    command = started(*chosen)
    until(lambda: under_way(folder, "learning"))
    os.killpg(command.pid, signal.SIGINT)
    assert "1 left" in of(command, status=130)
    assert list((folder / "out").rglob("checkpoint.safetensors"))  # to go on from
    assert "1 of 1 runs finished" in of(started(*chosen))
    (result,) = read_results(folder / "out").results
    assert result.training is not None
    assert result.training.steps == 6000
    assert (result.folder / "training" / "best" / "policy.safetensors").exists()
    assert not (result.folder / "training" / "checkpoint.safetensors").exists()


def test_progress_tells_runs_apart(folder, monkeypatch, capsys):
    def watched(jobs: list[BenchJob], *others: Any) -> BenchState:
        state = BenchState(folder, len(jobs), running={job.spec.name: job for job in jobs})
        monkeypatch.setattr("time.monotonic", count(0.0, 100.0).__next__)
        for _ in range(2):
            others[3](state)
        return state

    monkeypatch.setattr("cadenza.evaluation.bench.bench", watched)
    with pytest.raises(SystemExit):
        main(options("zero,random", "--seeds", "0-1"))
    line = capsys.readouterr().err.splitlines()[0]
    assert line.startswith("running: 0 of 8 runs, ")
    assert len(set(line.split(", ")[1:])) == 8
    assert line.count("beginning") == 8


@pytest.fixture
def bench(tmp_path):
    write_bench(tmp_path / "bench", pieces=3, agents=("planner", "ilqg"), seeds=2)
    return tmp_path / "bench"


def test_a_page_and_tables_are_left_and_agents_told(bench, capsys):
    (bench / "runs" / "begun").mkdir()
    main(["results", str(bench)])
    left = {path.name for path in (bench / "results").iterdir()}
    assert left == {"index.html", "agents.csv", "pieces.csv", "runs.csv", "differences.csv"}
    output = capsys.readouterr().out
    assert "planner" in output
    assert "1 run is not finished." in output
    assert output.endswith(f"Open {bench / 'results' / 'index.html'}\n")


def test_folders_may_have_names_that_are_no_text(bench, tmp_path):
    strange = bench.rename(tmp_path / os.fsdecode(b"b\xfc"))
    main(["results", str(strange), "-o", str(tmp_path / "out")])
    assert "b%FC/runs/" in (tmp_path / "out" / "index.html").read_text()


def test_another_folder_and_a_figure(bench, tmp_path):
    main(["results", str(bench), "-o", str(tmp_path / "out"), "--figure", str(tmp_path / "f.svg")])
    assert (tmp_path / "out" / "index.html").exists()
    assert (tmp_path / "f.svg").read_text().startswith("<svg")
    assert not (bench / "results").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: holds no runs; give the folder of a bench"),
        (["bench", "--figure", "f.png"], "f.png: the figure is an .svg picture"),
        (["empty"], "empty: no run is finished"),
    ],
)
def test_what_cannot_be_summed_up(bench, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(bench.parent)
    Path("empty", "runs").mkdir(parents=True)
    assert message in refused(capsys, "results", *arguments)
