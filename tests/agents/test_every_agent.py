"""What every registered agent keeps to."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from begun import begun
from cadenza.agents.planner.config import ILQGConfig, PredictiveSamplingConfig
from cadenza.agents.registry import AGENTS, PLAYBACK, PRETRAINED, agent_options, make_agent
from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError
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
AS_WRITTEN = set(NAMES) - {"zero", "random"}  # press the pedal
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
        name, results = runs
        for result in results:
            action = result.episode["action"]
            assert action.shape == (STEPS, len(scene.action_low))
            assert (action >= scene.action_low).all()
            assert (action <= scene.action_high).all()
            if name in AS_WRITTEN:
                assert_array_equal(action[:, -1], result.episode["goal_sustain"])
                assert result.metrics["sustain_f1"] == 1.0
            assert 0 <= result.metrics["f1"] <= 1
            assert np.isfinite(result.metrics["return"])

    def test_to_act_leaves_the_task_as_it_is(self, runs, scene):
        agent = make_agent(runs[0], QUICK.get(runs[0]))
        task = begun(PianoTask([TUNE], TASK, scene), agent)
        seen, physics = task.observation(), task.simulation.physics_state(0)
        agent.act(task.view())
        assert_array_equal(task.observation(), seen)
        assert_array_equal(task.simulation.physics_state(0), physics)
        assert task.goals.steps_done.tolist() == [0]


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("predictive-sampling", {"num_candidates": 0}, "num_candidates 0: choose 1 to"),
        ("predictive-sampling", {"num_knots": 1}, "num_knots 1: choose 2 to"),
        ("predictive-sampling", {"iterations": 0}, "iterations 0: choose 1 to"),
        ("predictive-sampling", {"sigma": -0.1}, "sigma -0.1: choose 0 to"),
        ("predictive-sampling", {"sigma": np.nan}, "sigma nan"),
        ("predictive-sampling", {"horizon": 0.005}, "must be at least one planning timestep"),
        ("predictive-sampling", {"horizon": np.inf}, "horizon inf: choose 0 to 60"),
        ("predictive-sampling", {"planning_timestep": 0.3}, "timestep 0.3: choose 0.0001 to 0.1"),
        ("predictive-sampling", {"budget": -1.0}, "budget -1.0: choose 0 to"),
        ("predictive-sampling", {"budget": np.inf}, "budget inf: choose 0 to"),
        ("predictive-sampling", {"budget": np.nan}, "budget nan: choose 0 to"),
        ("ilqg", {"iterations": 0}, "iterations 0: choose 1 to"),
        ("ilqg", {"num_step_sizes": 0}, "num_step_sizes 0: choose 1 to"),
        ("ilqg", {"control_weight": 0.0}, "control_weight 0.0: choose more than 0"),
        ("ilqg", {"horizon": np.nan}, "horizon nan: choose 0 to 60"),
        ("ilqg", {"horizon": 0.12}, "0.12 s is not a multiple of control_timestep 0.05 s"),
        ("ilqg", {"planning_timestep": 0.02}, "not a multiple of planning_timestep 0.02 s"),
        ("ilqg", {"planning_timestep": 0.0}, "planning_timestep 0.0: choose 0.0001 to"),
        ("planner", {"num_candidates": 1}, "num_candidates"),
        ("planner", {"iterations": 0}, "iterations"),
        ("planner", {"horizon": -1.0}, "horizon"),
    ],
)
def test_options_that_make_no_sense_are_refused(name, options, message, scene):
    config = agent_options(name)
    assert config
    with pytest.raises(CadenzaError, match=message):
        play_episode(PianoTask([TUNE], TASK, scene), make_agent(name, config(**options)))
