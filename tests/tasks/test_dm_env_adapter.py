"""The adapter to dm_env, with dm_env's own test of conformance."""

from __future__ import annotations

from collections.abc import Iterator

import gymnasium as gym
import numpy as np
import pytest
from absl.testing import absltest
from dm_env import StepType, test_utils

from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.tasks.dm_env_adapter import DmEnvAdapter
from cadenza.tasks.env import PianoEnv
from numbered import finger

SHORT = Score((Note(0.0, 0.1, 60, finger=finger(0)), Note(0.1, 0.25, 62, finger=finger(1))))


class ConformanceTest(test_utils.EnvironmentTestMixin, absltest.TestCase):
    def make_object_under_test(self) -> DmEnvAdapter:
        return DmEnvAdapter(PianoEnv(SHORT), seed=0)

    def make_action_sequence(self) -> Iterator[np.ndarray]:
        rng = np.random.default_rng(0)
        spec = self.environment.action_spec()
        for _ in range(20):
            yield rng.uniform(-1, 1, spec.shape).astype(spec.dtype)


def test_discount_tells_the_score_s_end_from_a_wrong_key() -> None:
    adapter = DmEnvAdapter(PianoEnv(SHORT))
    adapter.reset()
    steps = [adapter.step(np.zeros(39)) for _ in range(6)]
    assert steps[-1].step_type == StepType.LAST
    assert steps[-1].discount == 1.0
    strict = DmEnvAdapter(PianoEnv(SHORT, hands="none", wrong_press_termination=True))
    strict.reset()
    step = strict.step(np.ones(89))
    assert step.step_type == StepType.LAST
    assert step.discount == 0.0


def test_parts_are_those_of_the_environment() -> None:
    env = PianoEnv(SHORT)
    adapter = DmEnvAdapter(env, seed=1)
    parts = adapter.reset().observation
    whole, _ = PianoEnv(SHORT).reset(seed=1)
    assert list(parts) == list(env.observation_layout)
    np.testing.assert_array_equal(np.concatenate(list(parts.values())), whole)


def test_the_seed_is_that_of_the_first_episode_and_the_others_draw_on() -> None:
    def starts() -> list[np.ndarray]:
        adapter = DmEnvAdapter(PianoEnv(SHORT, random_hand_position=0.05), seed=3)
        return [adapter.reset().observation["joints"] for _ in range(2)]

    first, second = starts()
    assert (first != second).any()
    np.testing.assert_array_equal(starts(), [first, second])


def test_takes_what_gymnasium_makes() -> None:
    adapter = DmEnvAdapter(gym.make("cadenza/Piano-v0", song=SHORT, max_episode_steps=2), seed=1)
    whole, _ = PianoEnv(SHORT).reset(seed=1)
    parts = adapter.reset().observation
    np.testing.assert_array_equal(np.concatenate(list(parts.values())), whole)
    assert not adapter.step(np.zeros(39, np.float32)).last()
    assert adapter.step(np.zeros(39, np.float32)).last()


def test_refuses_what_has_no_such_parts() -> None:
    stacked = gym.wrappers.FrameStackObservation(PianoEnv(SHORT), 2)
    for env, message in (
        (stacked, "leave out the wrapper that changes them"),
        (PianoEnv(SHORT, pixels=True), "does not support pixels"),
        (gym.make("CartPole-v1"), "takes a PianoEnv, not CartPoleEnv"),
    ):
        with pytest.raises(CadenzaError, match=message):
            DmEnvAdapter(env)
