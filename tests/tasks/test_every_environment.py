"""What every environment keeps to, with each registered setup, hand and keyboard."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_array_equal

from cadenza.hands.registry import HANDS
from cadenza.keyboards.registry import KEYBOARDS
from cadenza.music.score import Note, Score
from cadenza.tasks.env import PianoEnv, PianoVectorEnv
from cadenza.tasks.setups import SETUPS

TUNE = Score((Note(0.0, 0.1, 60), Note(0.1, 0.2, 64)), title="Two notes")  # every keyboard has them
LONGER = TUNE.with_initial_silence(0.1)
STEPS = 5
ONE_HAND = {"hands": "right", "hand_spacing": 0.0}
OPTIONS: dict[str, dict[str, Any]] = {
    **{f"setup {name}": {"setup": name} for name in SETUPS.own},
    **{f"hand {name}": {"hand": name} for name in HANDS.own},
    **{f"keyboard {name}": {"keyboard": name, **ONE_HAND} for name in KEYBOARDS.own},
    "onsets": {"onset_goals": True, "onset_timing_coefficient": 0.5, "loudness_coefficient": 0.2},
    "other songs": {"random_pitch_shift": 3, "random_stretch": 0.2},
    "sleeping keys": {"physics": "fast", "sleeping_keys": True},
    "hands apart": {"setup": "harsh", "hands": "apart"},
    "without hands": {"hands": "none"},
}


def stepped(envs: PianoVectorEnv, actions: np.ndarray) -> list[np.ndarray]:
    """The values that all steps return, and all infos but their masks."""
    values = list[np.ndarray]()
    for each in actions:
        *row, infos = envs.step(each)
        values += row
        values += [np.asarray(infos[name]) for name in sorted(infos) if name[0] != "_"]
    return values


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
class TestEnvironment:
    def test_gymnasium_checks_it(self, options):
        env = PianoEnv(TUNE, **options)
        check_env(env, skip_render_check=True)
        env.close()

    def test_a_batch_is_its_environments_one_by_one_to_the_bit(self, options):
        """Environment i of a batch seeded with s is a single one seeded with s + i."""
        envs = PianoVectorEnv(TUNE, num_envs=2, num_threads=2, **options)
        single = [PianoEnv(TUNE, **options) for _ in range(2)]
        rows = [env.reset(seed=7 + i)[0] for i, env in enumerate(single)]
        assert_array_equal(envs.reset(seed=7)[0], rows)
        rng = np.random.default_rng(0)
        for _ in range(STEPS):
            actions = rng.uniform(-1, 1, envs.action_space.shape)
            observations, rewards, *_ = envs.step(actions)
            steps = [env.step(action) for env, action in zip(single, actions, strict=True)]
            assert_array_equal(observations, [step[0] for step in steps])
            assert_array_equal(rewards, [step[1] for step in steps])
        for env in (envs, *single):
            env.close()

    def test_states_and_copies_go_on_to_the_bit(self, options):
        """Through the end of the episode and into the next; states also in another batch."""
        envs, other = (
            PianoVectorEnv([TUNE, LONGER], num_envs=2, privileged=True, **options) for _ in range(2)
        )
        actions = np.random.default_rng(0).uniform(-1, 1, (20, *envs.action_space.shape))
        envs.reset(seed=0, options={"song": [0, 1]})
        for each in actions[:5]:
            before = envs.step(each)[0]
        states = pickle.loads(pickle.dumps(envs.get_state()))
        copies = copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))
        expected = stepped(envs, actions[5:])
        assert_array_equal(envs.set_state(states), before)
        assert_array_equal(other.set_state(states[::-1]), before[::-1])
        for again in (envs, *copies):
            for values, known in zip(stepped(again, actions[5:]), expected, strict=True):
                assert_array_equal(values, known)
        for values, known in zip(stepped(other, actions[5:, ::-1]), expected, strict=True):
            assert_array_equal(values[::-1], known)
        for env in (envs, other, *copies):
            env.close()
