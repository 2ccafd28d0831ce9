"""Tests of what the collector hands to learning, against what happened in the task."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import melody

from cadenza.learning.actions import ActionMapping, reference_of
from cadenza.learning.collector import Collector, Finished
from cadenza.learning.observation import GoalTable, Observer
from cadenza.learning.policy import Perceptron
from cadenza.learning.replay_buffer import Batch, ReplayBuffer
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask
from learnt import random_policy

# Episodes of different lengths that begin anywhere, and one may end at a wrong key.
RANDOM = TaskConfig(
    initial_buffer_time=0.1,
    sustain_term=True,  # so that the policy plays the pedal
    random_stretch=0.4,
    random_hand_position=0.1,
    random_pitch_shift=2,
)
RANDOMIZED = replace(
    RANDOM,
    randomization=DomainRandomization(
        mass=(0.5, 2.0), latency=(0.0, 0.1), joint_noise=0.1, key_noise=0.1, control_noise=0.1
    ),
)
ENDING = replace(RANDOM, wrong_press_termination=True)
FIXED = TaskConfig(initial_buffer_time=0.1, sustain_term=True)


class Watched(PianoTask):
    """A task with a record of its transitions, as a learner with whole observations keeps it."""

    def __init__(self, *args: Any, **options: Any) -> None:
        self.log: list[tuple[Any, ...]] = []
        self.finished: list[Finished] = []
        super().__init__(*args, **options)
        self.previous = np.zeros((self.num_envs, self.spec.action_size + 1))
        self.total = np.zeros(self.num_envs)

    def reset(self, rngs: Any, env_ids: Any) -> None:
        super().reset(rngs, env_ids)
        self.previous[list(env_ids)] = 0
        self.total[list(env_ids)] = 0

    def shown(self) -> np.ndarray:
        return np.concatenate([self.observation(), self.previous], axis=1).astype(np.float32)

    def step(self, ctrl: Any, env_ids: Any = None) -> Any:
        before = self.shown()
        result = super().step(ctrl, env_ids)
        self.previous = np.concatenate([ctrl, result.reward[:, None]], axis=1)
        self.total += result.reward
        after = self.shown()
        discount = np.where(result.terminated, 0.0, 1.0)
        self.log += zip(before, ctrl.copy(), result.reward, discount, after, strict=True)
        for env in np.flatnonzero(result.terminated | result.truncated):
            metrics = self.episode_metrics(env)
            scores = metrics["f1"], metrics["note_onset_f1"]
            self.finished.append(Finished(*scores, float(self.total[env])))
        return result


class Run:
    """A collector and all that it works with."""

    def __init__(self, config: TaskConfig, residual: bool = False, capacity: int = 5000) -> None:
        songs = [melody(60, 64), melody(50, 53, 72, pedal=True)][: 1 if residual else 2]
        self.task = Watched(songs, config, SceneConfig(), num_envs=3)
        self.scores = GoalTable(self.task.spec, self.task.tracks)
        reference = reference_of(PianoTask(songs, config)) if residual else None
        mapping = ActionMapping(self.task.spec, reference)
        self.observer = Observer(self.task.spec, self.scores, reference=mapping.reference)
        self.replay = ReplayBuffer(self.observer, 3, capacity, self.task.spec.action_size)
        rng = np.random.default_rng(0)
        self.collector = Collector(self.task, self.scores, self.observer, self.replay, mapping, rng)

    def sample(self, seed: int, number: int) -> Batch:
        return self.replay.sample(np.random.default_rng(seed), (number,))


def some_policy(run: Run) -> Perceptron:
    return random_policy(len(run.observer.inputs.kept), run.task.spec.action_size, 8)


def test_the_transitions_are_those_of_the_task():
    """Each of them can be drawn, whole, and nothing else; also across the ends of episodes."""
    run = Run(ENDING)
    run.collector.begin()
    run.collector.collect(None, 12)
    finished = run.collector.collect(some_policy(run), 25)
    log = run.task.log
    assert len(run.replay) == len(log) == 3 * 37
    discounts = [entry[3] for entry in log]
    assert 0.0 in discounts
    assert len(finished) > 3
    drawn = run.sample(0, 40 * len(log))
    reward = np.array([entry[2] for entry in log], np.float32)
    assert len(set(reward.tolist())) == len(log)  # so that it names the transition
    at = np.array([np.flatnonzero(reward == r)[0] for r in drawn.reward])
    assert set(at.tolist()) == set(range(len(log)))
    task = run.task
    close = {"rtol": 1e-6, "atol": 1e-6}
    for column, ours in ((0, drawn.observation), (3, drawn.discount), (4, drawn.next_observation)):
        assert_allclose(ours, np.array([entry[column] for entry in log])[at], **close)
    ctrl = np.array([entry[1] for entry in log])[at]
    assert_allclose(task.spec.scale_action(drawn.action), ctrl, **close)


def test_tells_how_episodes_ended():
    run = Run(ENDING)
    run.collector.begin()
    finished = run.collector.collect(None, 20)
    finished += run.collector.collect(None, 10)
    assert len(finished) == len(run.task.finished) > 3
    assert_allclose(finished, run.task.finished)


def test_random_actions_fill_the_range():
    run = Run(FIXED)
    run.collector.begin()
    run.collector.collect(None, 30)
    action = run.sample(0, 2000).action
    assert np.abs(action).max() <= 1
    assert_allclose(action.mean(), 0, atol=0.03)
    assert_allclose(action.std(), 1 / np.sqrt(3), atol=0.03)


def test_the_policy_acts_on_what_is_shown():
    run = Run(FIXED)
    seen = []

    class Spy:
        def sample(self, observation: Any, rng: Any) -> Any:
            seen.append((observation.copy(), run.task.shown()))
            return np.zeros((3, run.task.spec.action_size), np.float32)

    run.collector.begin()
    run.collector.collect(Spy(), 20)  # type: ignore[arg-type]
    for observation, shown in seen:
        assert_allclose(observation, shown, rtol=1e-6, atol=1e-6)


def test_a_residual_policy_corrects_the_plan():
    """It is shown the plan's next action last; without correction about that is done."""
    run = Run(FIXED, residual=True)

    class Nothing:
        def sample(self, observation: Any, rng: Any) -> Any:
            return np.zeros((3, run.task.spec.action_size), np.float32)

    run.collector.begin()
    for _ in range(10):
        plan = run.task.spec.scale_action(
            run.collector.observation[:, -run.task.spec.action_size :]
        )
        run.collector.collect(Nothing(), 1)  # type: ignore[arg-type]
        done = np.array([entry[1] for entry in run.task.log[-3:]])
        size = run.task.spec.action_high - run.task.spec.action_low
        assert np.median(np.abs(done - plan) / size) < 0.02
        assert_array_equal(done[:, -1], plan[:, -1])  # the pedal is the score's


@pytest.mark.parametrize(
    ("config", "residual"), [(RANDOM, False), (RANDOMIZED, False), (FIXED, True)]
)
def test_goes_on_after_a_stop_with_the_same_bits(config, residual):
    """The three environments are at different steps of different songs."""
    full = Run(config, residual)
    full.collector.begin()
    policy = some_policy(full)
    full.collector.collect(None, 9)
    full.collector.collect(policy, 8)
    plain, arrays = full.collector.state()
    plain = json.loads(json.dumps(plain))
    chunk, scores = full.replay.since(0), full.scores.arrays()

    again = Run(config, residual)
    again.scores.restore({name: array.copy() for name, array in scores.items()})
    again.replay.restore({name: array.copy() for name, array in chunk.items()})
    again.collector.restore(plain, {name: array.copy() for name, array in arrays.items()})
    if not residual:
        assert len(set(again.task.goals.steps_done.tolist())) > 1
    assert_array_equal(again.collector.observation, full.collector.observation)
    for steps, using in ((20, policy), (7, None)):
        assert again.collector.collect(using, steps) == full.collector.collect(using, steps)
        assert_array_equal(again.collector.observation, full.collector.observation)
    for ours, theirs in zip(again.sample(0, 500), full.sample(0, 500), strict=True):
        assert_array_equal(ours, theirs)
