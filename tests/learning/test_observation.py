"""Tests of what a policy observes, against what the task itself shows."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import melody, reset

from cadenza.learning.observation import GoalTable, ObservationSpec, Observer, pruned
from cadenza.music.score import NUM_KEYS, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

SONGS = [melody(60, 64, 67, pedal=True), melody(72, 50, length=0.3)]
TASKS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "published": ({}, {}),
    "pedal and buffer": ({"sustain_term": True, "initial_buffer_time": 0.2}, {}),
    "one hand": ({}, {"hands": "left"}),
    "no hands": ({}, {"hands": "none"}),
    "touch": ({}, {"hands": "right", "touch": True}),
    "without fingers": ({"fingering": "off", "n_seconds_lookahead": 0.22}, {}),
    "no lookahead": ({"n_steps_lookahead": 0}, {"reduced_action_space": False}),
    "onsets": ({"onset_goals": True, "random_stretch": 0.3}, {"hands": "right", "touch": True}),
    "onsets, no lookahead": ({"onset_goals": True, "n_steps_lookahead": 0}, {"hands": "none"}),
    "random": ({"random_stretch": 0.3, "random_hand_position": 0.1}, {}),
}


class Acting:
    """Random actions, before several observers."""

    def __init__(self, task: PianoTask, scores: GoalTable, seed: int = 0) -> None:
        self.task, self.scores = task, scores
        self.rng = np.random.default_rng(seed)
        reset(task, seed)
        shape = (task.num_envs, task.spec.action_size)
        self.action = self.rng.uniform(-1, 1, shape).astype(np.float32)  # of the episode before
        self.reward = np.full(task.num_envs, 3.0, np.float32)
        self.first_row = np.array([scores.add(track) for track in task.goals.tracks])

    def step(self) -> None:
        task = self.task
        self.action = self.rng.uniform(-1, 1, self.action.shape).astype(np.float32)
        self.reward = task.step(task.spec.scale_action(self.action)).reward.astype(np.float32)

    def seen_by(self, observer: Observer) -> np.ndarray:
        return observer.observation(
            self.first_row + self.task.goals.row,
            observer.proprioception(self.task.observation()),
            self.action,
            self.reward,
            self.task.goals.steps_done == 0,
        )


@pytest.fixture(params=TASKS)
def task(request):
    options, scene = TASKS[request.param]
    return PianoTask(SONGS, TaskConfig(**options), SceneConfig(**scene), num_envs=3)


def test_is_what_the_task_shows_at_every_step_and_past_the_end(task):
    scores = GoalTable(task.spec)
    observer = Observer(task.spec, scores)
    for seed in range(3):
        acting = Acting(task, scores, seed)
        for _ in range(int(task.goals.num_steps.max()) + 3):
            assert_array_equal(
                acting.seen_by(observer)[:, : task.spec.observation_size], task.observation()
            )
            acting.step()


def test_what_is_left_out_is_zero_and_the_rest_is_the_same(task):
    scores = GoalTable(task.spec, task.tracks)
    inputs = pruned(ObservationSpec.of(task.spec), *scores.goals_used())
    observer = Observer(task.spec, scores, inputs)
    full = Observer(task.spec, scores)
    kept = np.array(inputs.kept)
    left_out = np.setdiff1d(np.arange(task.spec.observation_size), kept)
    # Some 80 keys that no song asks for, in all the steps ahead.
    assert len(left_out) > 80 * (task.spec.observation_layout["goal"].stop // (NUM_KEYS + 1))
    for seed in range(3):
        acting = Acting(task, scores, seed)
        for _ in range(int(task.goals.num_steps.max()) + 1):
            assert not task.observation()[:, left_out].any()
            assert_array_equal(acting.seen_by(observer), acting.seen_by(full)[:, kept])
            acting.step()


def test_every_input_that_is_kept_of_the_goal_is_used():
    """One song asks for a key in all steps ahead for which it is kept."""
    task = PianoTask([SONGS[0]])
    scores = GoalTable(task.spec, task.tracks)
    inputs = pruned(ObservationSpec.of(task.spec), *scores.goals_used())
    acting = Acting(task, scores)
    seen = np.zeros(task.spec.observation_size, bool)
    seen[task.spec.observation_layout["key_state"].start :] = True
    for _ in range(int(task.goals.num_steps[0])):
        seen |= task.observation()[0] != 0
        acting.step()
    kept_of_task = [i for i in inputs.kept if i < task.spec.observation_size]
    assert len(kept_of_task) < task.spec.observation_size
    # What only the first steps ask for is never seen far ahead.
    assert set(np.flatnonzero(seen)) <= set(kept_of_task)
    assert np.mean(seen[kept_of_task]) > 0.9


def test_the_previous_action_and_reward_follow_as_the_published_wrappers_put_them():
    """CanonicalSpec maps [-1, 1] to the range, ObservationActionReward shows that and the reward.

    (dm_env_wrappers; there the action before the first is the least, and here it is zero.)
    """
    task = PianoTask(SONGS, num_envs=2)
    low, high = task.spec.action_low, task.spec.action_high
    observer = Observer(task.spec, scores := GoalTable(task.spec))
    acting = Acting(task, scores)
    previous = np.zeros((2, task.spec.action_size + 1))
    for _ in range(6):
        shown = acting.seen_by(observer)[:, task.spec.observation_size :]
        assert shown.dtype == np.float32
        assert_allclose(shown, previous, rtol=1e-6, atol=1e-6)
        acting.step()
        in_range = low + 0.5 * (acting.action.astype(np.float64) + 1) * (high - low)
        previous = np.concatenate([in_range, task.reward[:, None]], axis=1)
    assert np.abs(previous).max() > 0


def test_with_a_reference_its_next_action_comes_last():
    task = PianoTask(SONGS[:1])
    scores = GoalTable(task.spec, task.tracks)
    reset(task)
    steps = int(task.goals.num_steps[0])
    reference = (
        np.random.default_rng(0).uniform(-1, 1, (steps, task.spec.action_size)).astype(np.float32)
    )
    observer = Observer(task.spec, scores, reference=reference)
    acting = Acting(task, scores)
    for step in range(steps + 2):
        shown = acting.seen_by(observer)[0, -task.spec.action_size :]
        assert_array_equal(shown, reference[min(step, steps - 1)])
        acting.step()


def test_a_score_that_comes_again_takes_no_room():
    task = PianoTask(SONGS, num_envs=4)
    scores = GoalTable(task.spec, task.tracks)
    room = scores.arrays()["rows"].nbytes
    for seed in range(4):
        Acting(task, scores, seed)  # adds what is drawn
    assert scores.arrays()["rows"].nbytes == room


def test_scores_that_differ_in_their_onsets_alone_have_rows_of_their_own():
    """If these are shown."""
    louder = Score(tuple(replace(note, velocity=100) for note in SONGS[0].notes), SONGS[0].pedal)
    for shown in (True, False):
        scores = GoalTable(
            (task := PianoTask([SONGS[0], louder], TaskConfig(onset_goals=shown))).spec
        )
        first, other = (scores.add(track) for track in task.tracks)
        assert (first != other) == shown


@pytest.mark.parametrize("onset_goals", [False, True])
def test_scores_are_restored_with_their_rows(onset_goals):
    config = TaskConfig(random_stretch=0.5, random_pitch_shift=3, onset_goals=onset_goals)
    task = PianoTask(SONGS, config, num_envs=4)
    scores = GoalTable(task.spec)
    for seed in range(3):
        Acting(task, scores, seed)
    again = GoalTable(task.spec)
    again.restore({name: array.copy() for name, array in scores.arrays().items()})
    for seed in range(5):  # of which the last two are new to both
        assert_array_equal(
            Acting(task, again, seed).first_row, Acting(task, scores, seed).first_row
        )
    for name, array in scores.arrays().items():
        assert_array_equal(again.arrays()[name], array)


def test_scores_of_many_rows_are_looked_up_together():
    """A batch of rows gives for each what it gives alone."""
    task = PianoTask(SONGS)
    scores = GoalTable(task.spec, task.tracks)
    observer = Observer(
        task.spec, scores, pruned(ObservationSpec.of(task.spec), *scores.goals_used())
    )
    rng = np.random.default_rng(0)
    rows = rng.integers(8, size=(2, 5))
    rest = rng.random((2, 5, observer.proprioception_size), np.float32)
    action = rng.random((2, 5, task.spec.action_size), np.float32)
    reward, first = rng.random((2, 5), np.float32), rng.random((2, 5)) < 0.5
    together = observer.observation(rows, rest, action, reward, first)
    for i in np.ndindex(2, 5):
        alone = observer.observation(rows[i], rest[i], action[i], reward[i], first[i])
        assert_array_equal(together[i], alone)
        assert alone.shape == (len(observer.inputs.kept),)


@pytest.mark.parametrize("residual", [False, True])
def test_its_shape_is_the_same_for_every_song(residual):
    """It follows from the task and the scene."""
    specs = {ObservationSpec.of(PianoTask([song]).spec, residual) for song in SONGS}
    assert len(specs) == 1
    (spec,) = specs
    task = PianoTask(SONGS[:1]).spec
    assert {n: spec.layout[n] for n in task.observation_layout} == task.observation_layout
    assert spec.size == task.observation_size + task.action_size + 1 + residual * task.action_size
    assert spec.inputs.kept == tuple(range(spec.size))
    less = PianoTask(SONGS[:1], TaskConfig(n_steps_lookahead=3), SceneConfig(hands="left"))
    assert ObservationSpec.of(less.spec).goal == 4 * (NUM_KEYS + 1)
    assert ObservationSpec.of(less.spec).joints < spec.joints


@pytest.mark.parametrize("name", TASKS)
def test_the_shape_is_that_of_what_is_observed(name):
    options, scene = TASKS[name]
    task = PianoTask(SONGS, TaskConfig(**options), SceneConfig(**scene))
    acting = Acting(task, GoalTable(task.spec))
    observer = Observer(task.spec, acting.scores)
    assert acting.seen_by(observer).shape == (1, ObservationSpec.of(task.spec).size)
