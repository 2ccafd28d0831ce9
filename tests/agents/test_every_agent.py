"""What every registered agent keeps to."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cadenza.agents.planner.config import ILQGConfig, PredictiveSamplingConfig
from cadenza.agents.registry import AGENTS, PLAYBACK, PRETRAINED, make_agent
from cadenza.agents.rollout import play_episode
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

# Under the right hand where it starts.
TUNE = Score((Note(0.0, 0.2, 72), Note(0.2, 0.4, 76)), (PedalEvent(0.1, 127),), "A tune")
TASK = TaskConfig(initial_buffer_time=0.1)
STEPS = 11
NAMES = sorted(AGENTS.own.keys() - {PLAYBACK, PRETRAINED})  # which depend on the song
QUICK: dict[str, Any] = {
    "predictive-sampling": PredictiveSamplingConfig(num_candidates=3),
    "ilqg": ILQGConfig(horizon=0.1, planning_timestep=0.05, num_step_sizes=2),
}
DRAWS = {"random", "predictive-sampling"}
MAY_DRAW = {"planner"}  # where a note is hard


@pytest.fixture(scope="module")
def scene():
    return build_scene(SceneConfig(hands="right"))


@pytest.fixture(scope="module", params=NAMES)
def runs(request, scene):
    """The name of an agent, and episodes: two of a seed, by one and two threads, and another."""
    results = []
    for num_threads, seed in (1, 3), (2, 3), (1, 4):
        agent = make_agent(request.param, QUICK.get(request.param))
        agent.num_threads = num_threads
        results.append(play_episode(PianoTask([TUNE], TASK, scene), agent, seed))
    return request.param, results


class TestAgent:
    def test_the_same_seed_plays_the_same_bits_with_any_number_of_threads(self, runs):
        name, (one, two, other) = runs
        assert one.episode.arrays.keys() == two.episode.arrays.keys()
        for array in one.episode.arrays.keys() - {"metrics"}:  # which have times among them
            assert_array_equal(one.episode[array], two.episode[array], err_msg=array)
        drawn = (one.episode["action"] != other.episode["action"]).any()
        assert drawn == (name in DRAWS) or name in MAY_DRAW

    def test_it_plays_to_the_end_within_the_ranges_of_its_actions(self, runs, scene):
        _, results = runs
        for result in results:
            action = result.episode["action"]
            assert action.shape == (STEPS, len(scene.action_low))
            assert (action >= scene.action_low).all()
            assert (action <= scene.action_high).all()
            assert 0 <= result.metrics["f1"] <= 1
            assert np.isfinite(result.metrics["return"])
