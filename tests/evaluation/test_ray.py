"""The same runs on a Ray cluster: one that is started for them, and one of several nodes."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread

import pytest

from cadenza.cli import main
from cadenza.evaluation.results import read_results
from cadenza.evaluation.run_status import RunProgress, read_progress
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score

pytestmark = pytest.mark.slow
ray = pytest.importorskip("ray")

_PATIENCE = 600.0  # [s] a machine may be busy


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with three songs of one note each."""
    for pitch in 60, 64, 67:
        write_midi(Score((Note(0.0, 0.3, pitch),)), tmp_path / "songs" / f"{pitch}.mid")
    monkeypatch.chdir(tmp_path)
    agents = Path(__file__).parent
    monkeypatch.setenv("PYTHONPATH", str(agents), prepend=os.pathsep)
    yield tmp_path
    ray.shutdown()


def bench(agents: str, *others: str) -> None:
    chosen = ["--songs", "songs", "--agents", agents, "-o", "out", "--pages", "none"]
    main(["bench", *chosen, "--executor", "ray", *others])


def meanwhile(folder: Path, act: Callable[[RunProgress], None]) -> Thread:
    """Does something about the first run that plays."""

    def wait() -> None:
        end = time.monotonic() + _PATIENCE
        while time.monotonic() < end:
            for run in (folder / "out" / "runs").glob("*"):
                if (at := read_progress(run)) is not None and at.stage == "playing":
                    act(at)
                    return
            time.sleep(0.02)

    thread = Thread(target=wait)
    thread.start()
    return thread


def test_a_worker_that_dies_loses_only_its_own_run_which_is_taken_up_again(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    killed = list[int]()

    def kill(at: RunProgress) -> None:
        os.kill(at.pid, signal.SIGKILL)
        killed.append(at.pid)

    thread = meanwhile(folder, kill)
    bench("bench_agents:Counted", "--jobs", "3")
    thread.join()
    assert killed
    assert "3 of 3 runs finished" in capsys.readouterr().out
    assert len(list(folder.glob("begun-*"))) == 4
    assert len(read_results(folder / "out").results) == 3


def test_one_that_always_crashes_is_reported(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for song in "64.mid", "67.mid":
        (folder / "songs" / song).unlink()
    with pytest.raises(SystemExit):
        bench("bench_agents:Aborts,zero", "--jobs", "2")
    said = capsys.readouterr()
    assert "1 of 2 runs finished, 1 failed" in said.out
    assert "crashed on the cluster" in said.err


def test_runs_of_a_node_that_dies_go_on_on_another(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    try:
        nodes = [cluster.add_node(num_cpus=2) for _ in range(2)]
        thread = meanwhile(folder, lambda _: cluster.remove_node(nodes[0], allow_graceful=False))
        bench("bench_agents:Slow", "--stretch", "10", "--address", cluster.address)
        thread.join()
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert "3 of 3 runs finished" in capsys.readouterr().out
