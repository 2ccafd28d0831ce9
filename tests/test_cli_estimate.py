"""What is said before long work begins."""

from __future__ import annotations

import pytest

from cadenza.agents.agent import Agent, ZeroAgent
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.cli import estimate
from cadenza.cli.progress import QUIET
from cadenza.music.score import Note, Score
from cadenza.performing.setup import Setup
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.piano_task import PianoTask


@pytest.fixture(autouse=True)
def one_millisecond(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estimate, "seconds_of_a_step", lambda *_: 1e-3)
    monkeypatch.setattr("cadenza.sim.threads.available_cores", lambda: 2)


def setup(seconds: int, agent: Agent | None = None) -> Setup:
    score = Score(tuple(Note(0.2 * i, 0.2 * i + 0.2, 60 + i % 8) for i in range(5 * seconds)))
    task = PianoTask([score], scene=SceneConfig(hands="right"))
    return Setup(score, agent or Planner(), task, 0, {}, {})


def test_a_long_song_is_announced(capsys: pytest.CaptureFixture[str]) -> None:
    estimate.print_estimate(setup(192))
    told = capsys.readouterr().err
    assert told == "planning and playing 3:12 of music takes about 1 to 4 min\n"
    estimate.print_estimate(setup(60))
    assert "1:00 of music takes about 20 to 70 s" in capsys.readouterr().err


def test_practice_is_part_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    estimate.print_estimate(setup(20, Planner(PlannerConfig(effort=8.0))))
    assert "0:20 of music takes about 5 to 15 min" in capsys.readouterr().err


def test_short_work_is_not_announced(capsys: pytest.CaptureFixture[str]) -> None:
    estimate.print_estimate(setup(20))
    estimate.print_estimate(setup(192, ZeroAgent()))
    token = QUIET.set(True)
    estimate.print_estimate(setup(192))
    QUIET.reset(token)
    assert capsys.readouterr() == ("", "")


def test_a_step_takes_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    scene = build_scene(SceneConfig(hands="right"))
    assert 1e-5 < estimate.seconds_of_a_step(scene, 0.05) < 1
