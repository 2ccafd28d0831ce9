"""The candidate that networks compute for the planner's search."""

import numpy as np
import pytest

from begun import begun
from cadenza.agents.agent import Array
from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.generalist.generalist import Generalist, shipped_for
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner, SongPlanner
from cadenza.agents.planner.search.candidates import NetworkCandidate
from cadenza.agents.rollout import play_episode
from cadenza.music.libraries.library import load_score
from cadenza.scene.config import SceneConfig
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from watched import watched

TASK = TaskConfig(initial_buffer_time=0.5)
STEPS = 7


def test_proposes_what_the_generalist_plays(monkeypatch: pytest.MonkeyPatch) -> None:
    # Nothing proposes how fingers strike: the search refines that.
    monkeypatch.setattr(CorrectedHands, "touched", lambda *given: given[2:4])
    score = load_score("OdeToJoy").beginning(3.0)
    agent = Generalist()
    task = begun(PianoTask([score], TASK, SceneConfig(hands="right")), agent)
    trials = HandRollouts(task.scene, TASK.control_timestep)
    played, proposed = list[Array](), list[Array]()
    before = np.zeros(task.spec.action_size - 1)
    for step in range(6 * STEPS):
        state = task.view().state
        action = agent.act(task.view())[0]
        played.append(action[:-1])
        song = agent.planners[0]
        assert isinstance(song, SongPlanner)
        plan, (hands,) = song.plan, song.hands
        assert isinstance(hands, CorrectedHands)
        if step % STEPS == 0:
            weights = shipped_for(task.scene)
            assert weights
            ahead = NetworkCandidate(plan, "right", weights, step)
            ctrl = plan.nominal.tracking.ctrl
            trials.start_from(
                task.simulation, *np.quantile(plan.nominal.fingertips[..., 1], (0, 1))
            )
            planned, keys = ctrl[step : step + STEPS], state.key_qpos[0]
            coming = ahead.controls(trials, step, planned, before, keys)
            for _ in trials.run(proposed.append(row) or row for row in coming):  # type: ignore[func-returns-value]
                pass
        (before,) = hands.corrections.ctrl(hands.output)
        task.step(action[None])
    # Before the first step nothing has drifted; products of matrices round by their shapes.
    np.testing.assert_allclose(proposed[::STEPS], played[::STEPS], rtol=1e-12)
    np.testing.assert_allclose(proposed, played, atol=1e-5)
    assert np.ptp(played, axis=0).max() > 0.1  # it moves


@pytest.fixture
def proposed(monkeypatch):
    """What networks have proposed."""
    return watched(monkeypatch, NetworkCandidate, "controls")


def test_search_begins_with_what_is_proposed(proposed):
    score = load_score("CMajorChordProgressionTwoHands").beginning(2.0)
    planner = Planner()
    planner.num_threads = 1  # so that both hands search here
    with_it = play_episode(PianoTask([score], TASK), planner, 0)
    assert proposed
    proposed.clear()
    without = play_episode(PianoTask([score], TASK), Planner(PlannerConfig(proposals="none")), 0)
    assert not proposed
    assert (with_it.episode["action"] != without.episode["action"]).any()


@pytest.mark.parametrize(
    "scene", [SceneConfig(hand="allegro"), SceneConfig(reduced_action_space=False)]
)
def test_nothing_is_proposed_to_hands_that_it_was_not_learnt_with(scene, proposed):
    score = load_score("OdeToJoy").beginning(0.5)
    config = PlannerConfig(proposals="learnt")
    play_episode(PianoTask([score], TASK, scene), Planner(config), 0)
    assert not proposed
