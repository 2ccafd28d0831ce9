"""The environments as rsl_rl's `VecEnv`: what its runner reads is what Gymnasium's have."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_array_equal

from cadenza import CadenzaError, PianoVectorEnv
from cadenza.music.score import Note, Score

torch = pytest.importorskip("torch")
pytest.importorskip("rsl_rl")
from rsl_rl.runners import OnPolicyRunner  # noqa: E402

from cadenza.tasks.device_env import DevicePianoVectorEnv  # noqa: E402
from cadenza.tasks.rsl_rl_adapter import RslRlPiano  # noqa: E402
from tasks.test_playground import Obedient  # noqa: E402

UP = Score(tuple(Note(i / 5, (i + 1) / 5, 60 + i) for i in range(4)), title="Up")
ALONE = {"hands": "none", "n_steps_lookahead": 0, "initial_buffer_time": 0.0}


def on_host(**options):
    return PianoVectorEnv(UP, 3, autoreset_mode=AutoresetMode.SAME_STEP, **ALONE, **options)


def on_device():
    return DevicePianoVectorEnv(UP, 3, make_physics=Obedient, **ALONE)


def right_keys(observation):
    return observation["policy"][:, :89] * 4 - 2  # beyond the range, as of a Gaussian policy


@pytest.mark.parametrize("make", [on_host, on_device])
def test_an_episode_is_that_of_the_environment(make):
    env, own = RslRlPiano(make()), make()
    expected, _ = own.reset(seed=0)
    assert (env.num_envs, env.num_actions) == (3, 89)
    returns = torch.zeros(3)
    for step in range(1, env.max_episode_length + 1):
        observation = env.get_observations()
        assert observation.batch_size == (3,)
        assert_array_equal(observation["policy"], expected)
        actions = right_keys(observation)
        actions[0] = -1.0
        given = np.clip(np.asarray(actions), -1, 1)
        expected, reward, _, truncated, _ = own.step(given)
        after, rewards, dones, extras = env.step(actions)
        assert_array_equal(after["policy"], expected)
        assert_array_equal(rewards, np.asarray(reward, np.float32))
        assert_array_equal(extras["time_outs"], truncated)
        over = step == env.max_episode_length
        assert_array_equal(dones, [over] * 3)
        assert_array_equal(env.episode_length_buf, [0 if over else step] * 3)
        assert ("/f1" in extras["log"]) == over
        returns += rewards
    assert returns[0] < returns[1] == returns[2]
    assert extras["log"]["/f1"][0] < extras["log"]["/f1"][1]


def test_privileged_values_are_a_group_of_their_own():
    env = RslRlPiano(on_host(privileged=True))
    assert set(env.get_observations().keys()) == {"policy", "privileged"}
    assert set(env.step(torch.zeros(3, 89))[0].keys()) == {"policy", "privileged"}


def test_environments_that_begin_later_are_refused():
    with pytest.raises(CadenzaError, match="give gymnasium"):
        RslRlPiano(gym.make_vec("cadenza/Piano-v0", num_envs=1, song=UP, **ALONE))


@pytest.mark.slow
def test_rsl_rl_learns_on_it():
    """The keys of a piano that plays itself, by its PPO."""
    torch.manual_seed(0)
    env = RslRlPiano(
        PianoVectorEnv(UP, 16, autoreset_mode=AutoresetMode.SAME_STEP, **ALONE, physics="fast")
    )
    network = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "elu"}
    gaussian = {"class_name": "GaussianDistribution", "init_std": 0.5}
    settings = {
        "num_steps_per_env": 16,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "actor": network | {"distribution_cfg": gaussian},
        "critic": network,
        "algorithm": {"class_name": "PPO", "gamma": 0.8, "rnd_cfg": None},
    }
    runner = OnPolicyRunner(env, settings)

    def mean_reward():
        policy, total = runner.get_inference_policy(), 0.0
        with torch.inference_mode():
            for _ in range(env.max_episode_length):
                total += float(env.step(policy(env.get_observations()))[1].mean())
        return total / env.max_episode_length

    before = mean_reward()
    runner.learn(30)
    assert mean_reward() > before + 0.1
