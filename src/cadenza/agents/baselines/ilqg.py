"""iLQG, the paper's second planner (Zakka et al., RoboPianist, CoRL 2023, appendix F).

Linearises the simulation along the last plan, approximates the cost by a quadratic, and improves
the plan within the limits of the controls (Tassa, Erez, Todorov, "Synthesis and stabilization of
complex behaviors through online trajectory optimization", IROS 2012; Tassa, Mansard, Todorov,
"Control-limited differential dynamic programming", ICRA 2014).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv
from cadenza.agents.baselines.box_ddp import FeedbackLaw, Model, backward_pass
from cadenza.agents.baselines.pairs import Pairs, flattened, pairs_of
from cadenza.agents.planner.config import PLANNING_TIMESTEPS, ILQGConfig
from cadenza.configs import check_ranges
from cadenza.errors import CadenzaError
from cadenza.music.goals import Goals
from cadenza.scene.scene import build_scene, in_steps_of
from cadenza.sim.linearisation import Linearisation, Lineariser
from cadenza.sim.planning_simulation import PlanningSimulation, as_mujoco
from cadenza.tasks import reward
from cadenza.tasks.view import TaskSpec, View

Ids = NDArray[np.intp]

# Within these radii the norms of the cost are nearly squares.
_KEY_RADIUS = 0.1
_FINGER_RADIUS = 0.01  # [m]
_NO_CHANGE = 1e-6  # of controls, in half ranges
_TRUSTED_STEP = 0.3  # shorter steps say that the model is less accurate than it was taken to be


class ILQG(PlannerPerEnv["ILQGPlanner"]):
    """Plans anew at every control step. Nothing is random."""

    def __init__(self, config: ILQGConfig | None = None) -> None:
        """Raises:
        CadenzaError: an option makes no sense.
        """
        super().__init__()
        self.config = config or ILQGConfig()
        _check(self.config)

    def begin(self, view: View, rng: np.random.Generator) -> ILQGPlanner:
        """Raises:
        CadenzaError: the timesteps of task and plan do not divide.
        """
        return ILQGPlanner(view, self.config, self.threads)


class ILQGPlanner(EpisodePlanner):
    """Plays one song.

    A plan is a control for each control step of the horizon, held as the task holds it; the cost is
    counted at every planning step on the way, with derivatives over the part of the control step
    that lies behind. It is the cost of predictive sampling with smooth norms, sqrt(r'r + p^2) - p
    instead of |r|, and control_weight / 2 times the squared distance of controls from rest. Its
    Gauss-Newton approximation takes the present norms as weights of squares (iteratively reweighted
    least squares). The pedal follows the score.

    Attributes:
        seconds: wall-clock time spent so far in "derivatives", "backward pass" and
            "line search".
    """

    def __init__(self, view: View, config: ILQGConfig, num_threads: int) -> None:
        """Args:
            view: of the first step, of one environment.
            config: how to plan.
            num_threads: that share derivatives and rollouts.

        Raises:
            CadenzaError: the timesteps of task and plan do not divide.
        """
        task = view.task
        self.config, hold = config, task.config.control_timestep
        self._steps = _times(config.horizon, hold, "horizon", "control_timestep")
        planning = config.planning_timestep
        self._substeps = _times(hold, planning, "control_timestep", "planning_timestep")
        # MuJoCo has no derivatives of a scene in which keys sleep.
        waking = build_scene(replace(task.scene.config, sleeping_keys=False))
        scene = in_steps_of(waking, planning)
        self._rollouts = PlanningSimulation(scene, 1 + config.num_step_sizes, planning, num_threads)
        shape = (self._steps, self._substeps)
        self._lineariser = Lineariser(scene, *shape, num_threads, config.centred)
        self._step_sizes = np.append(0.0, np.geomspace(1.0, 1e-3, config.num_step_sizes))
        self._goals = view.tracks[0].goals
        self._task, self._cost = task, _Cost(task, self._goals, self._steps, self._substeps)
        low, high = task.action_low[:-1], task.action_high[:-1]
        self._centre, self._half_range = (low + high) / 2, (high - low) / 2
        self._rest = (np.clip(0.0, low, high) - self._centre) / self._half_range
        self._nominal = np.tile(self._rest, (self._steps, 1))  # in half ranges from the centre
        self._damping = _Damping()
        self.seconds = dict.fromkeys(("derivatives", "backward pass", "line search"), 0.0)

    def act(self, view: View) -> Array:
        with threadpool_limits(1):  # small matrices, and the same bits everywhere
            return self._act(view)

    def _act(self, view: View) -> Array:
        now = int(view.steps[0])
        start = as_mujoco(view.simulation).physics_state(int(view.env_ids[0]))
        self._cost.set_horizon(now)
        improved = True
        for _ in range(self.config.iterations):
            if improved:
                with self._timed("derivatives"):
                    model = self._approximate(start)
            improved = self._improve(model, start)
        action = self._ctrl(self._nominal[0])
        self._nominal = np.concatenate([self._nominal[1:], self._nominal[-1:]])
        return np.append(action, float(self._goals.sustain[now]))

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[part] += time.perf_counter() - started

    def _ctrl(self, controls: Array) -> Array:
        """Controls that are given in half ranges, in actuator units."""
        limits = self._task.action_low[:-1], self._task.action_high[:-1]
        return np.clip(self._centre + self._half_range * controls, *limits)

    def _approximate(self, start: Array) -> Model:
        """The Gauss-Newton model around the nominal; its controls are in half ranges."""
        linearised = self._lineariser.linearise(start, self._ctrl(self._nominal))
        n = linearised.jacobian.shape[-2]
        linearised.jacobian[..., n:] *= self._half_range
        gradient, hessian = self._cost.derivatives(linearised)
        weight = self.config.control_weight
        gradient[:, n:] += weight * (self._nominal - self._rest)
        diagonal = np.arange(n, n + len(self._rest))
        hessian[:, diagonal, diagonal] += weight
        return Model(linearised.jacobian[:, -1], gradient, hessian)

    def _improve(self, model: Model, start: Array) -> bool:
        """Takes the best step of one backward pass, and returns whether it is an improvement."""
        limit = np.ones(len(self._rest))
        try:
            with self._timed("backward pass"):
                law = backward_pass(model, self._nominal, -limit, limit, self._damping.value)
        except np.linalg.LinAlgError:
            self._damping.increase()
            return False
        if np.abs(law.offset).max() < _NO_CHANGE:
            self._damping.decrease()  # or it would be the reason
            return False
        with self._timed("line search"):
            candidates, cost = self._line_search(law, start)
        best = int(np.argmin(cost))
        self._nominal = candidates[best]
        if self._step_sizes[best] >= _TRUSTED_STEP:
            self._damping.decrease()
        else:
            self._damping.increase()
        return best > 0

    def _line_search(self, law: FeedbackLaw, start: Array) -> tuple[Array, Array]:
        """Rolls the law out with every step size, of which the first is 0: the nominal itself.

        Returns:
            Controls (N, K, A) in half ranges and their cost (N,).
        """
        sizes, rollouts = self._step_sizes[:, None], self._rollouts
        controls = np.empty((len(sizes), *self._nominal.shape))
        cost = np.zeros(len(sizes))
        rollouts.set_physics_state(start)
        for k, nominal in enumerate(self._nominal):
            coordinates = rollouts.coordinates()
            deviation = coordinates - coordinates[0]
            change = sizes * law.offset[k] + deviation @ law.gain[k].T
            controls[:, k] = np.clip(nominal + change, -1.0, 1.0)
            ctrl = self._ctrl(controls[:, k])
            states = rollouts.rollout(np.repeat(ctrl[:, None], self._substeps, axis=1))
            cost += self._cost.of_step(k, states.key_qpos, states.fingertip_xpos, states.key_xpos)
        cost += self.config.control_weight / 2 * ((controls - self._rest) ** 2).sum(axis=(1, 2))
        return controls, np.where(rollouts.state.unstable, np.inf, cost)


class _Residuals(NamedTuple):
    """Residuals of keys and fingers at R moments."""

    keys: Array
    """(R, K) state of the keys less their goals."""
    pairs: Pairs
    """Q pairs of a finger and its key, whose rows are the moments."""


class _Cost:
    """Distance of the keys from how they should be, and mean distance of fingers from theirs.

    Over K control steps, counted P times in each.
    """

    def __init__(self, task: TaskSpec, goals: Goals, num_steps: int, num_substeps: int) -> None:
        self._task, self._goals = task, goals
        self._num_steps, self._num_substeps = num_steps, num_substeps

    def set_horizon(self, now: int) -> None:
        """Makes step `now` of the song the first of the horizon."""
        self._keys, self._fingers = self._goals.at(np.arange(now, now + self._num_steps))

    def of_step(self, step: int, key_qpos: Array, tips: Array, centres: Array) -> Array:
        """(N,) cost of control step `step`; arrays (N, P, ...) as in `State`."""
        num = len(key_qpos)
        steps = np.full(num * self._num_substeps, step)
        residuals = self._residuals(steps, flattened(key_qpos), flattened(tips), flattened(centres))
        cost = _norm(residuals.keys, _KEY_RADIUS) - _KEY_RADIUS
        fingers = _norm(residuals.pairs.offset, _FINGER_RADIUS) - _FINGER_RADIUS
        fingers *= residuals.pairs.share
        cost += np.bincount(residuals.pairs.row, fingers, minlength=len(cost))
        return cost.reshape(num, -1).sum(axis=1)

    def derivatives(self, linearised: Linearisation) -> tuple[Array, Array]:
        """Gradient (K, 2 V + A) and Gauss-Newton Hessian (K, 2 V + A, 2 V + A) of each step."""
        jacobian = flattened(linearised.jacobian)
        steps = np.repeat(np.arange(self._num_steps), self._num_substeps)
        tips, centres = flattened(linearised.fingertip_xpos), flattened(linearised.key_xpos)
        residuals = self._residuals(steps, flattened(linearised.key_qpos), tips, centres)
        by_keys, by_offset = self._jacobians(linearised, residuals, jacobian)
        gradients, hessians = [], []
        for step in range(self._num_steps):
            mine, pairs = steps == step, steps[residuals.pairs.row] == step
            offset, share = residuals.pairs.offset[pairs], residuals.pairs.share[pairs]
            of_keys = _weighted(residuals.keys[mine], by_keys[mine], _KEY_RADIUS)
            of_fingers = _weighted(offset, by_offset[pairs], _FINGER_RADIUS, share)
            residual, rows = map(np.concatenate, zip(of_keys, of_fingers, strict=True))
            gradients.append(rows.T @ residual)
            hessians.append(rows.T @ rows)
        return np.array(gradients), np.array(hessians)

    def _jacobians(
        self, linearised: Linearisation, residuals: _Residuals, jacobian: Array
    ) -> tuple[Array, Array]:
        """Derivatives of the residuals, (R, K, 2 V + A) and (Q, 3, 2 V + A).

        A key's state is taken to go on beyond its stops, or one at rest would seem immovable.
        """
        moment, finger, key = residuals.pairs[:3]
        keys = self._task.scene.key_qpos
        of_keys = jacobian[:, keys]
        of_tips = flattened(linearised.fingertip_jacobian)[moment, finger]
        of_centres = flattened(linearised.key_jacobian)[moment, key]
        by_offset = of_tips @ jacobian[moment, : of_tips.shape[-1]]
        by_offset -= of_centres[:, :, None] * of_keys[moment, key][:, None]
        return of_keys / self._task.scene.keyboard.travel[:, None], by_offset

    def _residuals(self, steps: Ids, key_qpos: Array, tips: Array, centres: Array) -> _Residuals:
        keys = self._keys[steps]
        pairs = pairs_of(self._task, tips, centres, keys, self._fingers[steps])
        travel = self._task.scene.keyboard.travel
        return _Residuals(reward.key_state(key_qpos, travel) - keys, pairs)


def _norm(residual: Array, radius: float) -> Array:
    """Smooth norms over the last axis."""
    return np.sqrt(np.vecdot(residual, residual) + radius**2)


def _weighted(
    residual: Array, jacobian: Array, radius: float, share: Array | float = 1.0
) -> tuple[Array, Array]:
    """Rows (R r, ...) of a least squares problem: residuals (R, r), derivatives (R, r, z)."""
    weight = (share / _norm(residual, radius)) ** 0.5
    return (residual * weight[:, None]).ravel(), flattened(jacobian * weight[:, None, None])


class _Damping:
    """The schedule of the regularisation (Tassa, Erez, Todorov 2012, II-F)."""

    _FACTOR = 1.6
    _LEAST, _MOST = 0.1, 1e10

    def __init__(self) -> None:
        self.value, self._change = 1.0, 1.0

    def increase(self) -> None:
        self._change = max(self._FACTOR, self._change * self._FACTOR)
        self.value = min(max(self._LEAST, self.value * self._change), self._MOST)

    def decrease(self) -> None:
        self._change = min(1 / self._FACTOR, self._change / self._FACTOR)
        value = self.value * self._change
        self.value = value if value >= self._LEAST else 0.0


def _check(config: ILQGConfig) -> None:
    check_ranges(
        config,
        {
            "iterations": (1, 10_000),
            "num_step_sizes": (1, 1000),
            "horizon": (0, 60),
            "planning_timestep": PLANNING_TIMESTEPS,
        },
    )
    for name in ("horizon", "control_weight"):
        if not 0 < (value := getattr(config, name)) < math.inf:
            raise CadenzaError(f"{name} {value}: choose more than 0")


def _times(whole: float, part: float, name: str, part_name: str) -> int:
    times = round(whole / part)
    if times < 1 or abs(times * part - whole) > 1e-9:
        raise CadenzaError(f"{name} {whole} s is not a multiple of {part_name} {part} s")
    return times
