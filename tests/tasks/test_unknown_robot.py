"""A robot that nobody knows: what is hidden, and how often it may be tried."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cadenza import CadenzaError, Note, Score
from cadenza.tasks.unknown_robot import PLAYS

TUNE = Score((Note(0.0, 0.2, 60), Note(0.2, 0.4, 64)), title="A tune")
ID = "cadenza/UnknownRobot-v0"


def played(env: gym.Env) -> tuple[np.ndarray, list[float], dict]:
    """All that is seen and rewarded in one play with nothing done, and the last info."""
    observation, info = env.reset(seed=3)
    seen, rewards, over = [observation], [], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(
            np.zeros(env.action_space.shape)
        )
        seen.append(observation)
        rewards.append(float(reward))
        over = terminated or truncated
    return np.array(seen), rewards, info


def test_ten_plays_to_learn_and_one_that_is_scored():
    env = gym.make(ID, song=TUNE, robot=1)
    for play in range(1, PLAYS + 1):
        _, rewards, info = played(env)
        assert info == {"song": "A tune", "play": play}
        assert not any(rewards)
    _, rewards, info = played(env)
    assert any(rewards)
    assert 0 <= info["metrics/note_onset_f1"] <= 1
    assert not [name for name in info if "randomization" in name]
    with pytest.raises(CadenzaError, match="played 10 times and once more: make another"):
        env.reset()


def test_keys_sound_or_do_not_and_joints_are_off():
    env = gym.make(ID, song=TUNE, robot=1)
    seen, *_ = played(env)
    layout = env.unwrapped.observation_layout  # type: ignore[attr-defined]
    assert set(np.unique(seen[:, layout["key_state"]])) <= {0, 1}
    task = env.unwrapped.task  # type: ignore[attr-defined]
    off = seen[-1][layout["joints"]] - task.state.hand_qpos[0]
    assert 0.002 < np.abs(off).mean() < 0.1


def test_a_robot_stays_what_it_is_and_its_noise_does_not():
    env = gym.make(ID, song=TUNE, robot=1).unwrapped
    drawn, seen = [], []
    for seed in (0, 1):
        seen.append(env.reset(seed=seed)[0])
        drawn.append({n: v.copy() for n, v in env.task.drawn.items() if n != "seed"})  # type: ignore[attr-defined]
    for name, values in drawn[0].items():
        assert_array_equal(values, drawn[1][name], err_msg=name)
    assert (seen[0] != seen[1]).any()
    other = gym.make(ID, song=TUNE, robot=2).unwrapped
    other.reset(seed=0)
    assert (other.task.drawn["mass"] != drawn[0]["mass"]).mean() > 0.9  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "option",
    [
        {"privileged": True},
        {"randomization": {"mass": (1, 2)}},
        {"reward_terms": {"mine": lambda outcome: outcome.state.hand_qpos[:, 0]}},
        {"wrong_press_termination": True},
    ],
)
def test_options_that_would_show_or_change_the_robot_are_refused(option):
    with pytest.raises(CadenzaError, match="an unknown robot has no such option"):
        gym.make(ID, song=TUNE, **option)


def test_nothing_goes_back():
    env = gym.make(ID, song=TUNE).unwrapped
    env.reset(seed=0)
    with pytest.raises(CadenzaError, match="cannot go back"):
        env.get_state()  # type: ignore[attr-defined]
    with pytest.raises(CadenzaError, match="no option 'start' of reset"):
        env.reset(options={"start": None})
