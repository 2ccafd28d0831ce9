"""Predictive sampling as the paper has it: what a plan costs, in which steps, and for how long."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from begun import begun
from cadenza.agents.agent import Agent
from cadenza.agents.baselines import predictive_sampling
from cadenza.agents.baselines.ilqg import ILQG, ILQGPlanner
from cadenza.agents.baselines.predictive_sampling import PredictiveSampling, SamplingPlanner
from cadenza.agents.planner.config import ILQGConfig, PredictiveSamplingConfig
from cadenza.music.score import Note, Score
from cadenza.scene.scene import Scene
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View
from numbered import finger
from watched import watched

STEP = 0.05  # [s]
CHORD = Score(tuple(Note(0.0, 1.0, 72 + 2 * i, finger=finger(i)) for i in range(1, 4)))


def started(agent: Agent, scene: Scene) -> PianoTask:
    return begun(PianoTask([CHORD], TaskConfig(initial_buffer_time=0.0), scene), agent)


def test_the_defaults_are_the_figures_of_the_paper():
    """RoboPianist (Zakka et al., CoRL 2023), appendix F, but for how long it searches."""
    config = PredictiveSamplingConfig()
    assert (config.num_candidates, config.sigma, config.num_knots) == (10, 0.05, 2)
    assert (config.horizon, config.planning_timestep) == (0.2, 0.01)
    assert config.budget is None  # what is played depends on the seed alone


def test_a_plan_costs_the_distance_of_keys_and_the_mean_distance_of_fingers(
    right_hand, monkeypatch
):
    rolled_out = watched(monkeypatch, PlanningSimulation, "rollout")
    planned = watched(monkeypatch, SamplingPlanner, "costs")
    agent = PredictiveSampling(PredictiveSamplingConfig(num_candidates=2))
    agent.act(started(agent, right_hand).view())
    ((_, states),), ((_, costs),) = rolled_out, planned
    assert states.key_qpos.shape == (2, 20, 88)  # a fifth of a second
    assert_allclose(costs, [cost_of(states, i, right_hand) for i in range(2)])


def cost_of(states: State, i: int, scene: Scene, smooth: tuple[float, float] = (0, 0)) -> float:
    """The cost of a rollout of the chord; norms of keys and fingers are smooth over these radii."""
    cost, keyboard = 0.0, scene.keyboard
    for k in range(states.key_qpos.shape[1]):
        expected = np.zeros(88)
        distances = []
        for note in CHORD.notes:
            key = note.pitch - 21
            expected[key] = 1.0
            point = states.key_xpos[i, k, key].copy()
            point[0] += 0.35 * keyboard.half_size[key, 0]
            point[2] += 0.5 * keyboard.half_size[key, 2]
            tip = states.fingertip_xpos[i, k, note.finger.index]
            distances.append(np.hypot(np.linalg.norm(tip - point), smooth[1]) - smooth[1])
        depth = np.clip(states.key_qpos[i, k] / keyboard.travel, 0, 1)
        cost += np.hypot(np.linalg.norm(depth - expected), smooth[0]) - smooth[0]
        cost += sum(distances) / len(distances)
    return cost


def test_ilqg_has_the_same_cost_with_smooth_norms_and_a_little_for_controls(
    right_hand, monkeypatch
):
    rolled_out = watched(monkeypatch, PlanningSimulation, "rollout")
    searched = watched(monkeypatch, ILQGPlanner, "line_search")
    agent = ILQG(ILQGConfig(horizon=STEP, num_step_sizes=2, control_weight=1e-9))
    agent.act(started(agent, right_hand).view())
    ((_, states),), (((planner, *_), (controls, cost)),) = rolled_out, searched
    cost = cost - 1e-9 / 2 * ((controls - planner.rest) ** 2).sum(axis=(1, 2))
    assert_allclose(cost, [cost_of(states, i, right_hand, (0.1, 0.01)) for i in range(3)])


@pytest.mark.parametrize(
    "agent", [PredictiveSampling(), ILQG(ILQGConfig(horizon=STEP, num_step_sizes=2))]
)
def test_plans_in_physics_steps_of_10_ms(right_hand, agent, monkeypatch):
    rolled_out = watched(monkeypatch, PlanningSimulation, "rollout")
    agent.act(started(agent, right_hand).view())
    for (simulation, _), _ in rolled_out:
        assert (simulation.num_substeps, simulation.scene.model.opt.timestep) == (1, 0.01)
    assert right_hand.model.opt.timestep == 0.005  # of the performance


def test_candidates_lie_sigma_around_the_best(right_hand, monkeypatch):
    """In radians, whatever the range of a servo; metres, of forearms."""
    drawn = list[np.ndarray]()

    def costs(_: SamplingPlanner, tried: np.ndarray, __: View) -> np.ndarray:
        drawn.append(tried)
        return np.arange(len(tried))

    monkeypatch.setattr(SamplingPlanner, "costs", costs)
    agent = PredictiveSampling(PredictiveSamplingConfig(num_candidates=500))
    task = started(agent, right_hand)
    agent.act(task.view())
    low, high = task.spec.action_low[:-1], task.spec.action_high[:-1]
    best, *others = drawn[0][:, 0]  # at the first knot
    far = np.minimum(best - low, high - best) > 0.2  # from the limits
    assert far.sum() > 5
    assert_allclose(np.std(np.array(others) - best, axis=0)[far], 0.05, rtol=0.15)


def test_iterations_never_make_a_plan_worse(right_hand, monkeypatch):
    planned = watched(monkeypatch, SamplingPlanner, "costs")
    agent = PredictiveSampling(PredictiveSamplingConfig(iterations=8))
    agent.act(started(agent, right_hand).view())
    best = [costs.min() for _, costs in planned]
    assert len(best) == 8
    assert all(after <= before for before, after in pairwise(best))
    assert best[-1] < best[0]


class Clock:
    """Goes on only while plans are tried out."""

    def __init__(self, seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.iterations = 0.0, 0

        def tried(_: SamplingPlanner, candidates: np.ndarray, *__: Any) -> np.ndarray:
            self.now += seconds
            self.iterations += 1
            return np.arange(len(candidates), dtype=float)

        monkeypatch.setattr(SamplingPlanner, "costs", tried)
        monkeypatch.setattr(predictive_sampling, "time", self)

    def perf_counter(self) -> float:
        return self.now


@pytest.mark.parametrize(
    ("budget", "seconds", "iterations"),
    [
        (1.0, 0.04, [2, 1, 1]),  # what a step takes too long is left out of the next
        (10.0, 0.04, [13, 12, 13]),
        (1.0, 3.0, [1, 1, 1]),  # too slow a machine
        (0.0, 0.001, [1, 1, 1]),
    ],
)
def test_a_budget_of_time_ends_the_search(right_hand, monkeypatch, budget, seconds, iterations):
    clock = Clock(seconds, monkeypatch)
    agent = PredictiveSampling(PredictiveSamplingConfig(budget=budget, iterations=7))
    task = started(agent, right_hand)
    done = []
    for _ in iterations:
        before = clock.iterations
        task.step(agent.act(task.view()))
        done.append(clock.iterations - before)
    assert done == iterations
