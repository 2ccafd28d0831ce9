"""Note onsets as practice and the search judge them, against the published metric."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from cadenza.agents.planner.plan.hand_goals import HandGoals, last_in_time, may_begin
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.practice.losses import KeyHistory, Losses
from cadenza.music.metrics import playing_metrics
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

KEY, PITCH = 39, 60
STEPS = [0.01, 0.02, 0.025, 0.05, 0.1]


def in_time(score: Score, played: np.ndarray, dt: float) -> bool:
    """Whether the metric finds all notes."""
    pedal = np.zeros(len(played), bool)
    return playing_metrics(played, pedal, played, pedal, dt, score)["note_onset_f1"] == 1


@pytest.mark.parametrize("dt", STEPS)
def test_notes_are_in_time_where_the_metric_says_so(dt: float) -> None:
    first, length, count = 10, 20, 40
    score = Score((Note(first * dt, (first + length) * dt, PITCH),))
    keys = np.zeros((count, 88), bool)
    keys[first : first + length, KEY] = True
    last, welcome = last_in_time(keys, dt)[:, KEY], may_begin(keys, dt)[:, KEY]
    (due,) = np.flatnonzero(last >= 0)
    for late in range(8):
        played = keys.copy()
        played[: first + late] = False
        assert in_time(score, played, dt) == (first + late <= due) == welcome[first + late]
    assert last[due] == due - first


def test_a_note_that_is_struck_again_begins_a_step_late_at_best() -> None:
    keys = np.zeros((20, 88), bool)
    keys[2:5, KEY] = keys[6:9, KEY] = True
    assert np.flatnonzero(last_in_time(keys, 0.05)[:, KEY] >= 0).tolist() == [3, 6]
    assert np.flatnonzero(last_in_time(keys, 0.02)[:, KEY] >= 0).tolist() == [4, 7]


def test_what_is_due_in_a_long_song_takes_little_memory() -> None:
    keys = np.zeros((20_000, 88), bool)
    tracemalloc.start()
    try:
        last_in_time(keys, 0.05)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 8 * keys.nbytes


def test_steps_since_keys_began_to_sound() -> None:
    sounding = np.array([[0, 1], [1, 1], [1, 0], [1, 1], [0, 1]], bool)
    history = KeyHistory.of_steps(sounding)
    assert history.since.tolist() == [3, 1]
    assert KeyHistory.of_steps(sounding[:0]).since.min() > 100


@pytest.mark.parametrize("dt", STEPS)
def test_practice_loses_what_the_metric_does(dt: float) -> None:
    score = Score((Note(0.5, 1.0, PITCH),))
    task = PianoTask([score], TaskConfig(control_timestep=dt), SceneConfig(hands="right"))
    task.reset([np.random.default_rng(0)], [0])
    plan = plan_song(task.goals.tracks[0], task.state.hand_qpos[0])
    goals, keyboard = HandGoals(plan, "right"), plan.scene.keyboard
    losses, goal = Losses(plan, goals), plan.goals.keys
    (first, *_), count = np.flatnonzero(goal[:, KEY]), len(goal)

    def lost(late: int) -> float:
        """By all notes together, beside F1."""
        history, total = KeyHistory.of_steps(np.zeros((0, 88), bool)), 0.0
        for row in range(count):
            angles = np.zeros(88)
            angles[KEY] = (goal[row, KEY] and row >= first + late) * keyboard.travel[KEY]
            loss, _, history = losses.after(row, angles, goals.fingertips[row + 1], history)
            total += loss - (goal[row, KEY] and not angles[KEY])
        return total

    for late in range(5):
        played = goal.copy()
        played[: first + late] = False
        sounds_in_time = in_time(task.score(0), played, dt)
        assert (lost(late) == pytest.approx(0.0, abs=1e-9)) == sounds_in_time, late
