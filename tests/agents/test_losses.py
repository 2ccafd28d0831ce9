"""Note onsets as practice and the search judge them, against the published metric."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from cadenza.agents.planner.plan.hand_goals import HandGoals, last_in_time, may_begin
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.practice.losses import (
    KeyEvents,
    KeyHistory,
    Losses,
    StepLoss,
)
from cadenza.music.metrics import playing_metrics
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

KEY, PITCH = 39, 60
NO_EVENTS = KeyEvents(np.full(88, np.nan), np.full(88, np.nan))
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
            tips = goals.fingertips[row + 1]
            after = losses.after(row, angles, NO_EVENTS, tips, history)
            total += after.loss - (goal[row, KEY] and not angles[KEY])
            history = after.history
        return total

    for late in range(5):
        played = goal.copy()
        played[: first + late] = False
        sounds_in_time = in_time(task.score(0), played, dt)
        assert (lost(late) == pytest.approx(0.0, abs=1e-9)) == sounds_in_time, late


def test_a_strike_loses_by_its_time_and_speed_but_less_than_a_key_or_an_onset() -> None:
    score = Score((Note(0.52, 1.0, PITCH, 60), Note(0.52, 1.0, PITCH + 4, 60)))
    task = PianoTask([score], TaskConfig(), SceneConfig(hands="right"))
    task.reset([np.random.default_rng(0)], [0])
    plan = plan_song(task.goals.tracks[0], task.state.hand_qpos[0], strikes=True)
    goals, keyboard = HandGoals(plan, "right"), plan.scene.keyboard
    losses, strikes = Losses(plan, goals), goals.strikes
    step, before = int(strikes.step[0]), KeyHistory.of_steps(np.zeros((0, 88), bool))
    angles = plan.goals.keys[step] * keyboard.travel

    def evaluated(late: float = 0.0, louder: float = 1.0, keys: slice = slice(None)) -> StepLoss:
        onset, speed = NO_EVENTS.onset.copy(), NO_EVENTS.speed.copy()
        onset[strikes.key], speed[strikes.key] = strikes.time, strikes.speed
        onset[KEY] += late
        speed[KEY] *= louder
        events = KeyEvents(onset[keys], speed[keys])
        tips, history = goals.fingertips[step + 1], before.of(keys)
        return losses.after(step, angles[keys], events, tips, history, keys)

    perfect = evaluated()
    assert perfect.loss == perfect.strike_loss == 0.0
    assert evaluated(late=0.002).strike_loss == 0.0
    for errors in ((0.005, 0.01), (-0.005, -0.01)):
        small, large = (evaluated(late=late) for late in errors)
        assert 0.0 < small.strike_loss < large.strike_loss
        assert perfect.cost < small.cost < large.cost
    for factors in ((1.2, 1.4), (0.8, 0.6)):
        small, large = (evaluated(louder=factor) for factor in factors)
        assert 0.0 < small.strike_loss < large.strike_loss
    near = slice(KEY - 3, KEY + 5)
    assert evaluated(0.01, 1.3, near).strike_loss == evaluated(0.01, 1.3).strike_loss
    assert evaluated(0.01, 1.3, slice(KEY + 1, 88)).strike_loss == 0.0
    worst = evaluated(late=0.02, louder=4.0)
    assert worst.loss == 0.0
    angles[KEY] = 0.0
    assert evaluated().loss > worst.strike_loss
