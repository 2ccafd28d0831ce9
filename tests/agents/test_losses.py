"""Note onsets as practice and the search judge them, against the published metric."""

import tracemalloc

import numpy as np
import pytest

from begun import begun
from cadenza.agents.planner.plan.hand_goals import HandGoals, last_in_time, may_begin
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.practice.losses import KeyEvents, Losses, StepLoss, WrittenNotes
from cadenza.music.metrics import matched_notes, playing_metrics
from cadenza.music.performance import key_events, performed_score
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

KEY, PITCH = 39, 60
DT = 0.05
TIMELY = TaskConfig(repeats="shortened")
NO_EVENTS = KeyEvents(*np.full((3, 88), np.nan))
STEPS = [0.01, 0.02, 0.025, 0.05, 0.1]


def in_time(score: Score, played: np.ndarray, dt: float) -> bool:
    """Whether the metric finds all notes."""
    pedal = np.zeros(len(played), bool)
    return playing_metrics(played, pedal, played, pedal, dt, score)["note_onset_f1"] == 1


@pytest.mark.parametrize("dt", STEPS)
def test_notes_are_in_time_where_the_metric_says_so(dt):
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


def test_a_note_that_is_struck_again_begins_a_step_late_at_best():
    keys = np.zeros((20, 88), bool)
    keys[2:5, KEY] = keys[6:9, KEY] = True
    assert np.flatnonzero(last_in_time(keys, 0.05)[:, KEY] >= 0).tolist() == [3, 6]
    assert np.flatnonzero(last_in_time(keys, 0.02)[:, KEY] >= 0).tolist() == [4, 7]


def test_what_is_due_in_a_long_song_takes_little_memory():
    keys = np.zeros((20_000, 88), bool)
    tracemalloc.start()
    try:
        last_in_time(keys, 0.05)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 8 * keys.nbytes


def drawn_events(rng: np.random.Generator, steps: int, keys: list[int]) -> tuple[np.ndarray, ...]:
    """Whether keys sound after each step, and when they began and ceased in it (T, K) [s]."""
    sounding, events = np.zeros((steps, 88), bool), np.full((2, steps, 88), np.nan)
    for key in keys:
        for i, time in enumerate(np.cumsum(rng.choice([0.006, 0.03, 0.12, 0.4], 60))):
            step = int(time / DT)
            if step < steps:
                events[i % 2, step, key] = time - step * DT
                sounding[step:, key] = i % 2 == 0
    return sounding, *events


@pytest.mark.parametrize("seed", range(5))
def test_faults_of_notes_are_those_of_note_onset_f1(seed):
    rng, keys = np.random.default_rng(seed), [KEY, KEY + 1, KEY + 4]
    notes = [
        Note(start, start + 0.15, PITCH + key - KEY)
        for key in keys
        for start in np.cumsum(rng.uniform(0.22, 0.6, 18)).round(3).tolist()
    ]
    task = begun(PianoTask([Score(tuple(notes))], TIMELY, SceneConfig(hands="right")))
    plan = plan_song(task.goals.tracks[0], task.state.hand_qpos[0])
    written, steps = WrittenNotes(plan, HandGoals(plan, "right")), plan.goals.num_steps
    sounding, onset, offset = drawn_events(rng, steps, [*keys, KEY + 2])
    history, faults = written.history(0, sounding, onset, offset), 0
    for step in range(steps):
        again = written.history(step, sounding, onset, offset)
        np.testing.assert_array_equal(again.decided, history.decided)
        events = KeyEvents(onset[step], offset[step], onset[step])
        after = written.events(step, sounding[step], events, history, slice(None))
        faults += after.missed + int(after.extra.sum())
        history = after.history
    loudness, pedal = np.full_like(onset, 60.0), np.zeros(steps, bool)
    played = performed_score(sounding, pedal, DT, key_events(onset, offset, loudness))
    written_notes = sorted(task.score(0).notes, key=lambda note: note.start)
    matches = len(matched_notes(written_notes, played.notes, 0.05))
    assert 5 < matches < len(notes)
    assert faults == len(notes) + len(played.notes) - 2 * matches


def test_a_strike_loses_by_its_time_and_speed_but_less_than_a_key_or_an_onset():
    score = Score((Note(0.52, 1.0, PITCH, 60), Note(0.52, 1.0, PITCH + 4, 60)))
    task = begun(PianoTask([score], TaskConfig(), SceneConfig(hands="right")))
    plan = plan_song(task.goals.tracks[0], task.state.hand_qpos[0], strikes=True)
    goals, keyboard = HandGoals(plan, "right"), plan.scene.keyboard
    losses, strikes = Losses(plan, goals), goals.strikes
    step, unplayed = int(strikes.step[0]), np.zeros((len(goals.keys), 88))
    before = losses.notes.history(step, unplayed > 0, unplayed * np.nan, unplayed * np.nan)
    angles = plan.goals.keys[step] * keyboard.travel

    def evaluated(late: float = 0.0, louder: float = 1.0, keys: slice = slice(None)) -> StepLoss:
        onset, speed = NO_EVENTS.onset.copy(), NO_EVENTS.speed.copy()
        onset[strikes.key], speed[strikes.key] = strikes.time, strikes.speed
        onset[KEY] += late
        speed[KEY] *= louder
        events = KeyEvents(onset[keys], NO_EVENTS.offset[keys], speed[keys])
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
