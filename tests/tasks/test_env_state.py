"""States of environments that are got and set, starts within a song, and what critics see."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import cadenza
from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.tasks.env import PianoEnv, PianoVectorEnv
from numbered import finger

UP = Score(tuple(Note(i / 5, (i + 1) / 5, 60 + i, finger=finger(i)) for i in range(5)), title="Up")
DOWN = Score(
    tuple(Note(i / 5, (i + 1) / 5, 64 - i, finger=finger(4 - i)) for i in range(5)), title="Down"
)


def test_a_state_is_not_changed_by_going_on_from_it():
    env = PianoEnv(UP, randomization={"joint_noise": 0.1})
    env.reset(seed=0)
    env.step(np.zeros(39))
    state = env.get_state()
    seen = []
    for _ in range(2):
        env.set_state(state)
        seen.append([env.step(np.ones(39))[0] for _ in range(6)])
    assert_array_equal(*seen)
    assert env.np_random.bit_generator.state == state[1].bit_generator.state


def test_one_environment_takes_over_the_state_of_another():
    envs = PianoVectorEnv([UP, DOWN], num_envs=3)
    envs.reset(seed=0, options={"song": [0, 1, 1]})
    action = np.zeros((3, 39))
    envs.step(action)
    before = envs.task.state.copy()
    state = envs.get_state()[0]
    envs.step(action)
    kept = envs.task.state.copy()
    envs.set_state([None, state, None])
    for now, then, stayed in zip(envs.task.state, before, kept, strict=True):
        assert_array_equal(now[1], then[0])
        assert_array_equal(now[[0, 2]], stayed[[0, 2]])
    assert list(envs.step(action)[4]["song"]) == ["Up", "Up", "Down"]


def test_states_that_cannot_be():
    env = PianoEnv(UP)
    with pytest.raises(CadenzaError, match=r"call reset\(\) before get_state"):
        env.get_state()
    env.reset(seed=0)
    state = env.get_state()
    for other in (PianoEnv(UP, physics="fast"), PianoEnv(UP, n_steps_lookahead=1)):
        with pytest.raises(CadenzaError, match="of an environment with other options"):
            other.set_state(state)
    with pytest.raises(CadenzaError, match="give a state for each environment"):
        PianoVectorEnv(UP, num_envs=2).set_state([state, None])
    with pytest.raises(CadenzaError, match="1 states for 2 environments"):
        PianoVectorEnv(UP, num_envs=2).set_state([state])


def test_an_episode_begins_within_its_song():
    full, part = (PianoEnv(UP, initial_buffer_time=0.0) for _ in range(2))
    full.reset(seed=0)
    for _ in range(8):
        later, *_ = full.step(np.zeros(39))
    observation, _ = part.reset(seed=0, options={"step": 8})
    goal = part.observation_layout["goal"]
    assert_array_equal(observation[goal], later[goal])
    ended, length = False, 0
    while not ended:
        *_, ended, info = part.step(-np.ones(39))
        length += 1
    assert length == part.task.goals.num_steps[0] - 8
    assert info["metrics/note_onset_f1"] == 0.0
    assert len(part.task.score(0).since(0.4).notes) == 3


def test_metrics_count_from_the_first_step_on():
    """A piano that plays itself, from the third of five notes on."""
    env = PianoEnv(UP, hands="none", initial_buffer_time=0.0)
    observation, _ = env.reset(seed=0, options={"step": 8})
    ended = False
    while not ended:
        goal = observation[env.observation_layout["goal"]][:89]
        observation, _, _, ended, info = env.step(goal * 2 - 1)
    assert info["metrics/note_onset_f1"] > 0.99
    assert [note.pitch for note in env.task.played(0).notes] == [62, 63, 64]


def test_a_step_that_the_song_does_not_have():
    env = gym.make("cadenza/Piano-v0", song=UP)
    last = env.unwrapped.task.tracks[0].goals.num_steps - 1
    env.reset(options={"step": last})
    with pytest.raises(CadenzaError, match=rf"choose one from 0 to {last}"):
        env.reset(options={"step": last + 1})


def test_velocities_of_joints_are_observed_if_they_are_asked_for():
    env = PianoEnv(UP, joint_velocities=True)
    env.reset(seed=0)
    observation, *_ = env.step(np.ones(39))
    part = env.observation_layout["joint_velocities"]
    assert_array_equal(observation[part], env.task.state.hand_qvel[0].astype(np.float32))
    assert abs(observation[part]).max() > 0.01
    assert env.observation_space.contains(observation)


def test_critics_see_the_true_state_and_what_was_drawn():
    noisy = cadenza.DomainRandomization(joint_noise=0.1, mass=(0.5, 1.5))
    envs = PianoVectorEnv(UP, num_envs=2, randomization=noisy, privileged=True)
    _, infos = envs.reset(seed=0)
    layout, seen = envs.privileged_layout, infos["privileged"]
    assert_array_equal(seen[:, layout["joints"]], envs.task.state.hand_qpos.astype(np.float32))
    assert_array_equal(seen[:, layout["mass"]], infos["randomization/mass"].astype(np.float32))
    assert seen.shape[1] == max(part.stop for part in layout.values())
    assert "privileged" not in PianoVectorEnv(UP).reset(seed=0)[1]
