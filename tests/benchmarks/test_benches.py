"""What the benches count: planners, drills, disturbances, what a song holds."""

from __future__ import annotations

import csv
import sys

import mujoco
import numpy as np
import pytest

from benchmarks import limits, planners, robustness
from benchmarks.drills import succeeds
from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View


class Clock:
    """Goes on only where somebody thinks."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now


class Thinker(PlannerPerEnv["Begun"]):
    """An agent that takes 10 s to begin, and 1 s for every action."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def begin(self, view: View, rng: np.random.Generator) -> Begun:
        self._clock.now += 10.0
        return Begun(self._clock)


class Begun(EpisodePlanner):
    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def act(self, view: View) -> Array:
        self._clock.now += 1.0
        return np.zeros(view.task.action_size)


def test_every_action_counts_and_a_beginning_by_its_share(monkeypatch):
    monkeypatch.setattr(planners, "time", clock := Clock())
    task = PianoTask(
        [Score((Note(0.0, 0.95, 60),))],
        TaskConfig(initial_buffer_time=0.0),
        SceneConfig(hands="right"),
    )
    result = planners.perform(Thinker(clock), task, num_steps=5, seed=0)
    assert task.goals.num_steps[0] == 20
    assert result.ratio == pytest.approx((10 * 5 / 20 + 5 * 1) / (5 * 0.05))


GOAL = np.zeros((12, 3), bool)
GOAL[2:6, 0] = GOAL[7:11, 1] = True


def sounding(*wrong: tuple[int, int]) -> np.ndarray:
    """What should sound, but for these steps and keys."""
    result = GOAL.copy()
    for place in wrong:
        result[place] = ~result[place]
    return result


@pytest.mark.parametrize(
    ("wrong", "success"),
    [
        ((), True),
        (((1, 0), (6, 0)), True),  # a step too early and too late
        (((2, 0), (3, 0)), True),  # half of a note
        (((2, 0), (3, 0), (4, 0)), False),
        (((8, 0),), False),  # a key that was right before
        (((3, 2),), False),
    ],
)
def test_all_keys_have_to_be_right(wrong, success):
    assert succeeds(GOAL, sounding(*wrong)) == success


def test_no_hand_gets_there_before_one_that_need_not_stop():
    """In MuJoCo, with the control at the end of its range all the way."""
    scene = build_scene(SceneConfig(hands="right"))
    least = dict(zip(limits.WAYS.round(3).tolist(), limits.least_seconds(scene), strict=True))
    assert sorted(least.values()) == list(least.values())
    model = scene.model
    place = model.joint("rh_forearm_tx").qposadr[0]
    servo = model.actuator("rh_A_forearm_tx").id
    low, high = model.actuator_ctrlrange[servo]
    for way in (0.05, 0.1, 0.2, 0.4):
        fastest = np.inf
        for start in np.linspace(low, high - way, 9, endpoint=False):
            data = mujoco.MjData(model)
            data.qpos[place], data.ctrl[servo] = start, high
            while data.qpos[place] < start + way and data.time < 1.0:
                mujoco.mj_step(model, data)
            fastest = min(fastest, data.time)
        assert fastest < least[way] < 2 * fastest


def test_faster_jumps_and_better_fingers_hold_more(monkeypatch, capsys):
    command = ["limits", "debug", "--first-seconds", "6", "--fingerings", "3"]
    monkeypatch.setattr(sys, "argv", command)
    limits.main()
    rows = capsys.readouterr().out.splitlines()[2:]
    f1 = np.array([[float(cell) for cell in row.split("|")[2:4]] for row in rows])
    assert f1.shape == (3, 2)
    assert (np.diff(f1, axis=0) >= 0).all()
    assert (np.diff(f1, axis=1) >= 0).all()
    assert (f1 > 0.9).all()
    assert (f1 <= 1).all()


def test_a_row_for_each_disturbance_that_is_not_there_yet(tmp_path, monkeypatch):
    write_midi(Score((Note(0.0, 0.3, 72), Note(0.3, 0.6, 76))), tmp_path / "tune.mid")
    head = "disturbance,agent,song,seed,note_onset_f1,f1\n"
    (tmp_path / "robustness.csv").write_text(f"{head}nothing,planner,tune.mid,0,0.5,0.25\n")
    monkeypatch.chdir(tmp_path)
    command = ["robustness", "tune.mid", "--seeds", "1", "-o", ".", "--agents"]
    monkeypatch.setattr(sys, "argv", [*command, "planner", "nobody=zero"])
    robustness.main()
    with open("robustness.csv", newline="") as file:
        kept, *rows = csv.DictReader(file)
    assert kept["f1"] == "0.25"
    played = [(name, who) for name in robustness.DISTURBANCES for who in ("planner", "nobody")]
    assert [(row["disturbance"], row["agent"]) for row in rows] == played[1:]
    assert all((float(row["note_onset_f1"]) == 0) == (row["agent"] == "nobody") for row in rows)
