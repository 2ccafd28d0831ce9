"""Predictive sampling, the paper's planner (Zakka et al., RoboPianist, CoRL 2023, appendix F).

Howell et al., "Predictive Sampling: Real-time Behaviour Synthesis with MuJoCo" (2022): draw N plans
around the last one, which is one of them, keep the cheapest in simulation, and repeat.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv
from cadenza.agents.baselines.residuals import residuals_of
from cadenza.agents.planner.config import PLANNING_TIMESTEPS, PredictiveSamplingConfig
from cadenza.configs import check_ranges
from cadenza.errors import CadenzaError
from cadenza.scene.scene import in_steps_of
from cadenza.sim.planning_simulation import PlanningSimulation, as_mujoco
from cadenza.sim.protocol import State
from cadenza.tasks.view import View


class PredictiveSampling(PlannerPerEnv["SamplingPlanner"]):
    """An agent that plans anew at every control step."""

    def __init__(self, config: PredictiveSamplingConfig | None = None) -> None:
        """Check the options, and raise a `CadenzaError` if one makes no sense."""
        super().__init__()
        self.config = config or PredictiveSamplingConfig()
        config = self.config
        check_ranges(
            config,
            {
                "num_candidates": (1, 10_000),
                "num_knots": (2, 1000),
                "iterations": (1, 10_000),
                "sigma": (0, 1000),
                "horizon": (0, 60),
                "planning_timestep": PLANNING_TIMESTEPS,
            },
        )
        if config.budget is not None:
            check_ranges(config, {"budget": (0, 10_000)})
        if config.planning_timestep > config.horizon:
            raise CadenzaError(
                f"horizon {config.horizon} s and planning_timestep {config.planning_timestep} s: "
                "the horizon must be at least one planning timestep"
            )

    def begin(self, view: View, rng: np.random.Generator) -> SamplingPlanner:
        return SamplingPlanner(view, rng, self.config, self.threads)


class SamplingPlanner(EpisodePlanner):
    """A planner of one song.

    A plan is a cubic spline through knots over the horizon. It is sampled at the task's control
    steps, and held in between as the task holds its actions. The pedal follows the score, as the
    cost does not depend on it.

    Attributes:
        nominal: (num_knots, A) the knots of the plan, in actuator units.
    """

    def __init__(
        self,
        view: View,
        rng: np.random.Generator,
        config: PredictiveSamplingConfig,
        num_threads: int,
    ) -> None:
        """Begin with a plan at rest, from the view of the first step of one environment."""
        task, step = view.task, config.planning_timestep
        self.config, self._task, self._rng = config, task, rng
        self._goals = view.tracks[0].goals
        self._low, self._high = task.action_low[:-1], task.action_high[:-1]
        self._rollouts = PlanningSimulation(
            in_steps_of(task.scene, step), config.num_candidates, step, num_threads
        )
        self._seconds_left = 0.0  # of the budget; below 0 after steps that took too long
        self._knot_times = np.linspace(0.0, config.horizon, config.num_knots)
        self.nominal = np.tile(np.clip(0.0, self._low, self._high), (config.num_knots, 1))

    def act(self, view: View) -> Array:
        for _ in self._iterations():
            candidates = self._draw()
            self.nominal = candidates[np.argmin(self.costs(candidates, view))]
        best = CubicSpline(self._knot_times, self.nominal)
        shifted = self._knot_times + self._task.config.control_timestep
        self.nominal = self._clip(best(np.minimum(shifted, self.config.horizon)))
        pedal = float(self._goals.sustain[view.steps[0]])
        return np.append(self._clip(best(0.0)), pedal)

    def _iterations(self) -> Iterator[None]:
        """Yield for each iteration of this control step: one or more, as the budget allows."""
        if self.config.budget is None:
            yield from [None] * self.config.iterations
            return
        self._seconds_left += self.config.budget * self._task.config.control_timestep
        while True:
            started = time.perf_counter()
            yield
            self._seconds_left -= time.perf_counter() - started
            if self._seconds_left <= 0.0:
                return

    def _draw(self) -> Array:
        """Candidates (N, num_knots, A); the first is the nominal itself."""
        shape = (self.config.num_candidates, *self.nominal.shape)
        noise = self.config.sigma * self._rng.standard_normal(shape)
        noise[0] = 0.0
        return self._clip(self.nominal + noise)

    def _clip(self, ctrl: Array) -> Array:
        return np.clip(ctrl, self._low, self._high)

    def costs(self, candidates: Array, view: View) -> Array:
        """Costs (N,) of candidates (N, num_knots, A) in rollouts from the state of `view`."""
        config, hold = self.config, self._task.config.control_timestep
        steps = round(config.horizon / config.planning_timestep)
        times = np.arange(steps) * config.planning_timestep
        rows = np.floor(times / hold + 1e-9).astype(np.intp)  # control step of each planning step
        ctrl = self._clip(CubicSpline(self._knot_times, candidates, axis=1)(rows * hold))
        self._rollouts.copy_from(as_mujoco(view.simulation), int(view.env_ids[0]))
        states = self._rollouts.rollout(ctrl)
        cost = self.cost(states, view.steps[0] + rows).sum(axis=1)
        return np.where(states.unstable.any(axis=1), np.inf, cost)

    def cost(self, states: State, rows: NDArray[np.intp]) -> Array:
        """Distances of keys from goals, plus mean distances of fingers from their keys (N, K).

        The states (N, K) are of K planning steps, which belong to control steps `rows` (K,).
        """
        shape = states.key_qpos.shape[:2]
        keys, fingers = self._goals.at(np.tile(rows, shape[0]))
        residuals = residuals_of(self._task, states, keys, fingers)
        norms = (
            np.linalg.norm(residual, axis=1) for residual in (residuals.keys, residuals.offset)
        )
        return residuals.cost(*norms).reshape(shape)
