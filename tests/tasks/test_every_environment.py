"""What every environment keeps to, with each registered setup, hand and keyboard."""

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
STEPS = 5
ONE_HAND = {"hands": "right", "hand_spacing": 0.0}
OPTIONS: dict[str, dict[str, Any]] = {
    **{f"setup {name}": {"setup": name} for name in SETUPS.own},
    **{f"hand {name}": {"hand": name} for name in HANDS.own},
    **{f"keyboard {name}": {"keyboard": name, **ONE_HAND} for name in KEYBOARDS.own},
    "onsets": {"onset_goals": True, "onset_timing_coefficient": 0.5, "loudness_coefficient": 0.2},
    "randomization": {
        "randomization": {"mass": (0.8, 1.2), "control_noise": 0.1, "latency": (0, 0.1)}
    },
    "without hands": {"hands": "none"},
}


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
