"""The adapter to dm_env, with dm_env's own test of conformance."""

import json
from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from absl.testing import absltest
from dm_env import StepType, test_utils
from numpy.testing import assert_allclose

from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.tasks.dm_env_adapter import DmEnvAdapter, load
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


def test_discount_tells_the_score_s_end_from_a_wrong_key():
    adapter = DmEnvAdapter(PianoEnv(SHORT, initial_buffer_time=0.0))
    adapter.reset()
    steps = [adapter.step(np.zeros(39)) for _ in range(6)]
    assert steps[-1].step_type == StepType.LAST
    assert steps[-1].discount == 1.0
    strict = DmEnvAdapter(PianoEnv(SHORT, hands="none", wrong_press_termination=True))
    strict.reset()
    step = strict.step(np.ones(89))
    assert step.step_type == StepType.LAST
    assert step.discount == 0.0


def test_parts_are_those_of_the_environment():
    env = PianoEnv(SHORT)
    adapter = DmEnvAdapter(env, seed=1)
    parts = adapter.reset().observation
    observation, _ = PianoEnv(SHORT).reset(seed=1)
    assert list(parts) == list(env.observation_layout)
    np.testing.assert_array_equal(np.concatenate(list(parts.values())), observation)


def test_the_seed_is_that_of_the_first_episode_and_the_others_draw_on():
    def starts() -> list[np.ndarray]:
        adapter = DmEnvAdapter(PianoEnv(SHORT, random_hand_position=0.05), seed=3)
        return [adapter.reset().observation["joints"] for _ in range(2)]

    first, second = starts()
    assert (first != second).any()
    np.testing.assert_array_equal(starts(), [first, second])


def test_takes_what_gymnasium_makes():
    adapter = DmEnvAdapter(gym.make("cadenza/Piano-v0", song=SHORT, max_episode_steps=2), seed=1)
    observation, _ = PianoEnv(SHORT).reset(seed=1)
    parts = adapter.reset().observation
    np.testing.assert_array_equal(np.concatenate(list(parts.values())), observation)
    assert not adapter.step(np.zeros(39, np.float32)).last()
    assert adapter.step(np.zeros(39, np.float32)).last()


def test_refuses_what_has_no_such_parts():
    stacked = gym.wrappers.FrameStackObservation(PianoEnv(SHORT), 2)
    for env, message in (
        (stacked, "leave out the wrapper that changes them"),
        (PianoEnv(SHORT, pixels=True), "does not support pixels"),
        (gym.make("CartPole-v1"), "takes a PianoEnv, not CartPoleEnv"),
    ):
        with pytest.raises(CadenzaError, match=message):
            DmEnvAdapter(env)


@pytest.mark.parametrize("name", "ad")
def test_a_published_environment_replays_its_recording(name):
    """It has each reward and the metrics, by the names of the options that it was made with."""
    with np.load(Path(__file__).parents[1] / f"data/episode_{name}.npz") as file:
        recording = dict(file)
    options = {
        "n_steps_lookahead": 10,
        "trim_silence": bool(recording["trim_silence"]),
        "reduced_action_space": bool(recording["reduced_action_space"]),
        "gravity_compensation": True,
        "primitive_fingertip_collisions": True,
        "change_color_on_activation": True,
        "disable_forearm_reward": False,
    }
    env = load(f"RoboPianist-debug-{recording['song']}-v0", seed=1, task_kwargs=options)
    spec = env.action_spec()
    assert_allclose(spec.minimum, recording["action_min"], atol=1e-6)
    assert_allclose(spec.maximum, recording["action_max"], atol=1e-6)
    assert len(spec.name.split("\t")) == len(spec.minimum)
    assert_allclose(env.reset().observation["goal"], recording["goal_obs0"])
    steps = [env.step(action) for action in recording["action"]]
    assert [step.last() for step in steps] == [False] * (len(steps) - 1) + [True]
    rewards = [step.reward for step in steps]
    assert_allclose(rewards, recording["reward_total"], atol=1e-6)
    statistics = env.get_statistics()
    assert statistics["length"] == len(steps)
    assert_allclose(statistics["return"], sum(rewards))
    for metric, value in json.loads(str(recording["metrics"])).items():
        assert_allclose(env.get_musical_metrics()[metric], value, err_msg=metric)


def test_metrics_and_statistics_are_means_over_the_last_episodes():
    adapter = DmEnvAdapter(PianoEnv(SHORT), seed=0, deque_size=2)
    with pytest.raises(CadenzaError, match="no episode has ended"):
        adapter.get_musical_metrics()
    seen = []
    for action in (np.zeros(39), np.ones(39), -np.ones(39)):
        total, timestep = 0.0, adapter.reset()
        while not timestep.last():
            timestep = adapter.step(action)
            total += timestep.reward
        seen.append((total, adapter.task.episode_metrics(0)["sustain_f1"]))
    assert_allclose(adapter.get_statistics()["return"], np.mean(seen[1:], axis=0)[0])
    assert_allclose(adapter.get_musical_metrics()["sustain_f1"], np.mean(seen[1:], axis=0)[1])


def test_says_what_a_published_option_is_here():
    for option, meant in (
        ({"disable_fingering_reward": True}, "fingering='off'"),
        ({"disable_forearm_reward": False}, "forearm_term=True"),
        ({"hand_side": "right"}, "hands='right'"),
        ({"recompile_physics": True}, "not needed"),
        ({"midi": None}, "song='FILE.mid'"),
    ):
        with pytest.raises(CadenzaError, match=meant):
            gym.make("cadenza/Piano-v0", song=SHORT, **option)
    with pytest.raises(CadenzaError, match="random_stretch"):
        load(midi_file="no.mid", task_kwargs={"augmentations": []})
    with pytest.raises(
        CadenzaError, match="does not come with Cadenza; give its file as midi_file"
    ):
        load("RoboPianist-debug-TwinkleTwinkleRousseau-v0")
    with pytest.raises(CadenzaError, match="RoboPianist-debug-CMajorScaleOneHand-v0"):
        load("Twinkle")
    with pytest.raises(CadenzaError, match=r"task\.state"):
        _ = DmEnvAdapter(PianoEnv(SHORT)).physics
