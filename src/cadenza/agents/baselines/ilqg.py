"""iLQG, the paper's second planner (Zakka et al., RoboPianist, CoRL 2023, appendix F).

Linearises the simulation along the last plan, approximates the cost by a quadratic, and improves
the plan within the limits of the controls (Tassa, Erez, Todorov, "Synthesis and stabilization of
complex behaviors through online trajectory optimization", IROS 2012; Tassa, Mansard, Todorov,
"Control-limited differential dynamic programming", ICRA 2014).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Array, EpisodePlanner, Ids, PlannerPerEnv
from cadenza.agents.baselines.control_limited_ddp import FeedbackLaw, Model, backward_pass
from cadenza.agents.baselines.residuals import Residuals, flattened, residuals_of
from cadenza.agents.planner.config import PLANNING_TIMESTEPS, ILQGConfig
from cadenza.configs import check_positive, check_ranges
from cadenza.scene.scene import build_scene, in_steps_of
from cadenza.sim.linearisation import Linearisation, Lineariser
from cadenza.sim.mujoco_simulation import steps_of
from cadenza.sim.planning_simulation import PlanningSimulation, as_mujoco
from cadenza.sim.protocol import State
from cadenza.tasks.view import View

# Within these radii the norms of the cost are nearly squares.
_KEY_RADIUS = 0.1
_FINGER_RADIUS = 0.01  # [m]
_NO_CHANGE = 1e-6  # change of controls that ends the search, in half ranges
_TRUSTED_STEP = 0.3  # if the best step is shorter, the model is inaccurate


class ILQG(PlannerPerEnv["ILQGPlanner"]):
    """An agent that plans anew at every control step. Nothing is random."""

    def __init__(self, config: ILQGConfig | None = None) -> None:
        """Check the options, and raise a `CadenzaError` if one makes no sense."""
        super().__init__()
        self.config = config or ILQGConfig()
        check_ranges(
            self.config,
            {
                "iterations": (1, 10_000),
                "num_step_sizes": (1, 1000),
                "horizon": (0, 60),
                "planning_timestep": PLANNING_TIMESTEPS,
            },
        )
        check_positive(self.config, ["horizon", "control_weight"])

    def begin(self, view: View, rng: np.random.Generator) -> ILQGPlanner:
        return ILQGPlanner(view, self.config, self.threads)


class ILQGPlanner(EpisodePlanner):
    """A planner of one song.

    A plan is a control for each control step of the horizon, held as the task holds it; the cost is
    counted at every planning step on the way, with derivatives over the part of the control step
    that lies behind. It is the cost of predictive sampling with smooth norms, sqrt(r'r + p^2) - p
    instead of |r|, and control_weight / 2 times the squared distance of controls from rest. Its
    Gauss-Newton approximation takes the present norms as weights of squares (iteratively reweighted
    least squares). The pedal follows the score.

    Attributes:
        nominal: (K, A) the plan of K control steps, in half ranges of the controls from their
            middle.
        rest: (A,) the controls at rest, likewise.
    """

    def __init__(self, view: View, config: ILQGConfig, num_threads: int) -> None:
        """Begin with a plan at rest, from the view of the first step of one environment.

        Raises CadenzaError if the timestep of the plan does not divide that of the task.
        """
        task = self._task = view.task
        self.config, hold, planning = config, task.config.control_timestep, config.planning_timestep
        steps = steps_of(config.horizon, hold, "horizon", "control_timestep")
        self._substeps = steps_of(hold, planning, "control_timestep", "planning_timestep")
        # MuJoCo has no derivatives of a scene in which keys sleep.
        waking = build_scene(replace(task.scene.config, sleeping_keys=False))
        scene = in_steps_of(waking, planning)
        self._rollouts = PlanningSimulation(scene, 1 + config.num_step_sizes, planning, num_threads)
        shape = steps, self._substeps
        self._lineariser = Lineariser(scene, *shape, num_threads, config.centred)
        self._step_sizes = np.append(0.0, np.geomspace(1.0, 1e-3, config.num_step_sizes))
        self._goals = view.tracks[0].goals
        low, high = task.action_low[:-1], task.action_high[:-1]
        self._centre, self._half_range = (low + high) / 2, (high - low) / 2
        self.rest = (np.clip(0.0, low, high) - self._centre) / self._half_range
        self.nominal = np.tile(self.rest, (steps, 1))
        self._damping = _Damping()

    def act(self, view: View) -> Array:
        with threadpool_limits(1):  # small matrices, and the same bits everywhere
            return self._act(view)

    def _act(self, view: View) -> Array:
        now = int(view.steps[0])
        start = as_mujoco(view.simulation).physics_state(int(view.env_ids[0]))
        self._keys, self._fingers = self._goals.at(np.arange(now, now + len(self.nominal)))
        improved = True
        for _ in range(self.config.iterations):
            if improved:
                model = self.approximate(start)
            improved = self.improve(model, start)
        action = self._ctrl(self.nominal[0])
        self.nominal = np.concatenate([self.nominal[1:], self.nominal[-1:]])
        return np.append(action, float(self._goals.sustain[now]))

    def _ctrl(self, controls: Array) -> Array:
        """Convert controls in half ranges to actuator units."""
        limits = self._task.action_low[:-1], self._task.action_high[:-1]
        return np.clip(self._centre + self._half_range * controls, *limits)

    def approximate(self, start: Array) -> Model:
        """Gauss-Newton model around the nominal plan from a physics state."""
        linearised = self._lineariser.linearise(start, self._ctrl(self.nominal))
        n = linearised.jacobian.shape[-2]
        linearised.jacobian[..., n:] *= self._half_range
        gradient, hessian = self._cost_derivatives(linearised)
        weight = self.config.control_weight
        gradient[:, n:] += weight * (self.nominal - self.rest)
        diagonal = np.arange(n, n + len(self.rest))
        hessian[:, diagonal, diagonal] += weight
        return Model(linearised.jacobian[:, -1], gradient, hessian)

    def improve(self, model: Model, start: Array) -> bool:
        """Take the best step of one backward pass, and return whether it is an improvement."""
        limit = np.ones(len(self.rest))
        try:
            law = backward_pass(model, self.nominal, -limit, limit, self._damping.value)
        except np.linalg.LinAlgError:
            self._damping.increase()
            return False
        if np.abs(law.offset).max() < _NO_CHANGE:
            self._damping.decrease()  # it may be the reason
            return False
        candidates, cost = self.line_search(law, start)
        best = int(np.argmin(cost))
        self.nominal = candidates[best]
        if self._step_sizes[best] >= _TRUSTED_STEP:
            self._damping.decrease()
        else:
            self._damping.increase()
        return best > 0

    def line_search(self, law: FeedbackLaw, start: Array) -> tuple[Array, Array]:
        """Roll the law out with every step size; the first is 0, the nominal itself.

        Returns controls (N, K, A) in half ranges and their cost (N,).
        """
        sizes, rollouts = self._step_sizes[:, None], self._rollouts
        controls = np.empty((len(sizes), *self.nominal.shape))
        cost = np.zeros(len(sizes))
        rollouts.set_physics_state(start)
        for k, nominal in enumerate(self.nominal):
            coordinates = rollouts.coordinates()
            deviation = coordinates - coordinates[0]
            change = sizes * law.offset[k] + deviation @ law.gain[k].T
            controls[:, k] = np.clip(nominal + change, -1.0, 1.0)
            ctrl = self._ctrl(controls[:, k])
            states = rollouts.rollout(np.repeat(ctrl[:, None], self._substeps, axis=1))
            cost += self._cost(k, states)
        cost += self.config.control_weight / 2 * ((controls - self.rest) ** 2).sum(axis=(1, 2))
        return controls, np.where(rollouts.state.unstable, np.inf, cost)

    def _cost(self, step: int, states: State) -> Array:
        """Costs (N,) of a control step of the horizon, in states (N, P)."""
        steps = np.full(states.key_qpos.shape[:2], step)
        residuals = self._residuals(steps, states)
        keys = _norm(residuals.keys, _KEY_RADIUS) - _KEY_RADIUS
        fingers = _norm(residuals.offset, _FINGER_RADIUS) - _FINGER_RADIUS
        return residuals.cost(keys, fingers).reshape(steps.shape).sum(axis=1)

    def _residuals(self, steps: Ids, states: State | Linearisation) -> Residuals:
        """Residuals in states (N, P) of control steps (N, P) of the horizon."""
        rows = steps.ravel()
        return residuals_of(self._task, states, self._keys[rows], self._fingers[rows])

    def _cost_derivatives(self, linearised: Linearisation) -> tuple[Array, Array]:
        """Gradient (K, 2 V + A) and Gauss-Newton Hessian (K, 2 V + A, 2 V + A) of each step.

        The state of a key is extrapolated beyond its stops: a key at rest would seem immovable.
        """
        jacobian, scene = flattened(linearised.jacobian), self._task.scene
        steps = np.repeat(np.arange(len(self.nominal))[:, None], self._substeps, axis=1)
        residuals = self._residuals(steps, linearised)
        row, finger, key = residuals.row, residuals.finger, residuals.key
        of_keys = jacobian[:, scene.key_qpos]
        of_tips = flattened(linearised.fingertip_jacobian)[row, finger]
        of_centres = flattened(linearised.key_jacobian)[row, key]
        of_offsets = of_tips @ jacobian[row, : of_tips.shape[-1]]
        of_offsets -= of_centres[:, :, None] * of_keys[row, key][:, None]
        of_depths = of_keys / scene.keyboard.travel[:, None]
        gradients, hessians = [], []
        for step in range(len(self.nominal)):
            inside = steps.ravel() == step
            pairs = inside[row]
            of_key = _weighted(residuals.keys[inside], of_depths[inside], _KEY_RADIUS)
            of_finger = _weighted(
                residuals.offset[pairs], of_offsets[pairs], _FINGER_RADIUS, residuals.share[pairs]
            )
            residual, rows = map(np.concatenate, zip(of_key, of_finger, strict=True))
            gradients.append(rows.T @ residual)
            hessians.append(rows.T @ rows)
        return np.array(gradients), np.array(hessians)


def _norm(residual: Array, radius: float) -> Array:
    """Smooth norms of residuals over their last axis."""
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
    _MIN, _MAX = 0.1, 1e10

    def __init__(self) -> None:
        self.value, self._change = 1.0, 1.0

    def increase(self) -> None:
        self._change = max(self._FACTOR, self._change * self._FACTOR)
        self.value = min(max(self._MIN, self.value * self._change), self._MAX)

    def decrease(self) -> None:
        self._change = min(1 / self._FACTOR, self._change / self._FACTOR)
        value = self.value * self._change
        self.value = value if value >= self._MIN else 0.0
