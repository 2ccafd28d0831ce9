"""Optimises the controls of one hand press by press, and finds the gains to track the result with.

Iterative LQR (Tassa, Erez, Todorov, "Synthesis and stabilization of complex behaviors through
online trajectory optimization", IROS 2012) within the limits of the controls, on windows around the
presses, one after the other, each from where the one before left the hand; where the nominal plan
makes no mistake, it stays. The gains are those of time-varying LQR along the trajectory of the
whole song (e.g. Tedrake, Underactuated Robotics, chapter "Linear Quadratic Regulators").
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Progress, silent, steps_in
from cadenza.agents.baselines.box_ddp import Model, backward_pass
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.horizon_cost import HARMLESS_DEPTH
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_linearisation import HandLinearisation, HandLineariser
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State
from cadenza.tasks import reward

Policy = Callable[[int, State], Array]  # controls (N, A) for a step and states (N, ...)

_LEAD = 0.15  # [s] from the beginning of a window to its press
_LOOK_AHEAD = 0.25  # [s] after a window whose cost counts
_MIN_WINDOW = 0.15  # [s]

# Units of deviations of slides [m] and hinges [rad], and of their speeds, in these per second.
_SLIDE, _HINGE, _PER_SECOND = 0.01, 0.1, 10.0
_DIFFERENCE = 0.2  # of these units: finite differences

# Weights of half the squares in the cost of a step.
_MISTAKE = 3.0  # of a wrong key: not squared, and known to the line search only
_DEPTH = 6.0  # of a key's distance from its harmless range, in units of its travel
_PLAYING, _IDLE = 6000.0, 400.0  # [1 / m^2] of fingertip errors
_ALONG_KEY = 0.55  # errors along the key count less
_CONTROL = 0.05  # of deviations of the controls from the nominal ones
_STEP_SIZES = np.append(0.0, np.geomspace(1.0, 0.05, 7))
_REGULARISATION = 0.1
_MORE_REGULARISATION = 10.0  # times as much after a line search without success

# Weights of half the squares in the cost of tracking.
_TRACK_TIP = 1e4  # [1 / m^2] of fingertips
_TRACK_STATE = 0.1  # of joints
_TRACK_CONTROL = 1.0


class Trajectory(NamedTuple):
    """T steps of one hand, and the feedback law that tracks them: u = ctrl + gain (x - state)."""

    ctrl: Array
    """(T, A)"""
    state: Array
    """(T, 2 J) positions and speeds of the joints before each step."""
    gain: Array
    """(T, A, 2 J)"""


class _Window(NamedTuple):
    """A rollout of the K steps from `first` on."""

    first: int
    ctrl: Array
    """(K, A)"""
    before: Array
    """(K, 2 J) positions and speeds before each step."""
    cost: float
    mistakes: int


class PressOptimisation:
    """The controls of one hand for a whole song."""

    def __init__(self, plan: SongPlan, side: Side, iterations: int, num_threads: int) -> None:
        """Prepares the optimisation of a hand's nominal plan of the whole song.

        There are at most so many iterations per press, and threads that share simulations.
        """
        scene, servos, _ = hand_alone(plan.scene, side)
        dt = plan.track.config.control_timestep
        self._goals, self._tracking = HandGoals(plan, side), plan.nominal.tracking.of(servos)
        self._iterations, self._look_ahead = iterations, steps_in(_LOOK_AHEAD, dt)
        onsets = [press.first - 1 for press in plan.nominal.presses if press.side == side]
        self._starts = _starts(onsets, steps_in(_LEAD, dt), steps_in(_MIN_WINDOW, dt))
        self._servos, self._travel = servos_of(scene), scene.keyboard.travel
        self._sounds_from = scene.keyboard.sounds_from
        joint_unit = _units(scene.hand_joint_names)
        self._state_unit = np.concatenate([joint_unit, _PER_SECOND * joint_unit])
        self._ctrl_unit = _units(self._servos.names)
        self._unit = np.concatenate([self._state_unit, self._ctrl_unit])
        self._now = PlanningSimulation(scene, 1, dt)
        self._single = PlanningSimulation(scene, 1, dt)
        self._batch = PlanningSimulation(scene, len(_STEP_SIZES), dt, num_threads)
        difference = _DIFFERENCE * self._unit
        self._lineariser = HandLineariser(scene, difference, dt, num_threads)

    def optimise(self, hand_qpos: Array, progress: Progress = silent) -> Trajectory:
        """The trajectory from joints at rest at `hand_qpos` (J,).

        It reports the progress of "presses", in steps.
        """
        steps = len(self._tracking.ctrl)
        self._now.reset(hand_qpos=hand_qpos[None])
        ctrl, states = [], []
        for first, following in pairwise([*self._starts, steps]):
            progress("presses", first, steps)
            last = min(following + self._look_ahead, steps)
            window = self._improved(self._window(first, last))
            kept = following - first
            ctrl.append(window.ctrl[:kept])
            states.append(window.before[:kept])
            self._now.rollout(ctrl[-1][None])
        self._now.reset(hand_qpos=hand_qpos[None])
        whole = np.concatenate(ctrl)
        linearised = self._lineariser.linearise(self._now, whole)
        return Trajectory(whole, np.concatenate(states), self._gains(linearised))

    # One window

    def _window(self, first: int, last: int) -> _Window:
        """A rollout of the nominal plan, with feedback for each servo by itself."""

        def policy(step: int, state: State) -> Array:
            here = np.stack([state.hand_qpos[0], state.hand_qvel[0]], axis=1)
            feedback = self._tracking.feedback(step, self._servos.of_joints.T @ here)
            return (self._tracking.ctrl[step] - feedback)[None]

        return self._roll_out(self._single, first, last, policy)[0]

    def _improved(self, window: _Window) -> _Window:
        """Improves a window until no key is wrong, or the iterations are used up."""
        regularisation, model = _REGULARISATION, None
        for _ in range(self._iterations):
            if not window.mistakes:
                break
            model = model or self._approximate(window)
            better = self._line_search(window, model, regularisation)
            if better.cost < window.cost:
                window, model = better, None
            else:
                regularisation *= _MORE_REGULARISATION
        return window

    def _approximate(self, window: _Window) -> Model:
        """The Gauss-Newton model around a window, in units of deviations."""
        linearised = self._lineariser.linearise(self._now, window.ctrl)
        transition = linearised.hands * self._unit / self._state_unit[:, None]
        gradients, hessians = [], []
        for k in range(len(window.ctrl)):
            residual, jacobian = self._residual(linearised, window.first + k, k)
            jacobian = jacobian * self._unit
            gradients.append(jacobian.T @ residual)
            hessians.append(jacobian.T @ jacobian)
        gradient, hessian = np.array(gradients), np.array(hessians)
        steps = slice(window.first, window.first + len(window.ctrl))
        first = len(self._state_unit)  # of the controls
        gradient[:, first:] += _CONTROL * self._from_nominal(window.ctrl, steps)
        diagonal = np.arange(first, len(self._unit))
        hessian[:, diagonal, diagonal] += _CONTROL
        return Model(transition, gradient, hessian)

    def _from_nominal(self, ctrl: Array, steps: int | slice) -> Array:
        """Deviations of controls (..., A) from those of the nominal plan, in units."""
        return (ctrl - self._tracking.ctrl[steps]) / self._ctrl_unit

    def _line_search(self, window: _Window, model: Model, regularisation: float) -> _Window:
        """The cheapest rollout of the feedback law, of all step sizes."""
        unit = self._ctrl_unit
        low, high = self._servos.low / unit, self._servos.high / unit
        law = backward_pass(model, window.ctrl / unit, low, high, regularisation)

        def policy(step: int, state: State) -> Array:
            k = step - window.first
            deviation = (_coordinates(state) - window.before[k]) / self._state_unit
            change = _STEP_SIZES[:, None] * law.offset[k] + deviation @ law.gain[k].T
            return window.ctrl[k] + change * unit

        last = window.first + len(window.ctrl)
        tried = self._roll_out(self._batch, window.first, last, policy)
        return min(tried, key=lambda candidate: candidate.cost)

    def _roll_out(
        self, simulation: PlanningSimulation, first: int, last: int, policy: Policy
    ) -> list[_Window]:
        """Rolls a policy out from the present state, in each simulation of a batch."""
        simulation.copy_from(self._now, 0)
        ctrl, before = [], []
        cost, mistakes = np.zeros(simulation.num_envs), np.zeros(simulation.num_envs, np.intp)
        for step in range(first, last):
            before.append(_coordinates(simulation.state))
            control = self._servos.clip(policy(step, simulation.state))
            simulation.step(control)
            ctrl.append(control)
            mistakes += self._mistakes(simulation.state, step)
            cost += self._cost(simulation.state, step)
            cost += _CONTROL / 2 * (self._from_nominal(control, step) ** 2).sum(axis=1)
        cost = np.where(simulation.state.unstable, np.inf, cost + _MISTAKE * mistakes)
        controls, states = np.stack(ctrl, axis=1), np.stack(before, axis=1)
        return [
            _Window(first, controls[i], states[i], float(cost[i]), int(mistakes[i]))
            for i in range(len(cost))
        ]

    # Cost

    def _mistakes(self, state: State, step: int) -> NDArray[np.intp]:
        sounding = reward.key_activation(state.key_qpos, self._sounds_from)
        mine, wrong = self._goals.keys[step], self._goals.wrong[step]
        return ((mine & ~sounding) | (wrong & sounding)).sum(axis=1)

    def _cost(self, state: State, step: int) -> Array:
        keys, tips = self._residuals(state, step)
        return ((keys**2).sum(axis=1) + (tips**2).sum(axis=(1, 2))) / 2

    def _residuals(self, state: State, step: int) -> tuple[Array, Array]:
        """Weighted residuals (N, K), (N, F, 3) of the states after `step`."""
        goals, depth = self._goals, reward.key_state(state.key_qpos, self._travel)
        too_high = np.where(goals.keys[step], depth - 1.0, 0.0)
        too_deep = np.where(goals.wrong[step], np.maximum(depth - HARMLESS_DEPTH, 0.0), 0.0)
        error = state.fingertip_xpos[:, goals.fingers] - goals.fingertips[step + 1]
        return np.sqrt(_DEPTH) * (too_high + too_deep), self._tip_weight(step) * error

    def _tip_weight(self, step: int) -> Array:
        """(F, 3) square roots of the weights of fingertip errors."""
        weight = np.sqrt(np.where(self._goals.playing[step + 1], _PLAYING, _IDLE))
        return weight[:, None] * np.array([_ALONG_KEY, 1.0, 1.0])

    def _residual(self, linearised: HandLinearisation, step: int, k: int) -> tuple[Array, Array]:
        """Residuals (R,) of the state after the k-th step, and derivatives (R, 2 J + A) by z."""
        state = State._make(values[k : k + 1] for values in linearised.states)
        keys, tips = self._residuals(state, step)
        there = np.flatnonzero(keys[0])
        by_keys = np.sqrt(_DEPTH) * linearised.keys[k, there] / self._travel[there, None]
        by_tips = self._tip_weight(step)[..., None] * linearised.fingertips[k, self._goals.fingers]
        residual = np.concatenate([keys[0, there], tips[0].ravel()])
        return residual, np.concatenate([by_keys, by_tips.reshape(-1, by_tips.shape[-1])])

    # Tracking

    def _gains(self, linearised: HandLinearisation) -> Array:
        """(T, A, 2 J) gains of the regulator that keeps fingertips and joints on the trajectory."""
        transition = linearised.hands * self._unit / self._state_unit[:, None]
        tips = linearised.fingertips[:, self._goals.fingers] * self._unit
        rows = tips.reshape(len(tips), -1, tips.shape[-1])
        hessian = _TRACK_TIP * rows.transpose(0, 2, 1) @ rows
        hessian += _TRACK_STATE * transition.transpose(0, 2, 1) @ transition
        diagonal = np.arange(len(self._state_unit), len(self._unit))
        hessian[:, diagonal, diagonal] += _TRACK_CONTROL
        return regulator(transition, hessian) * self._ctrl_unit[:, None] / self._state_unit


def regulator(transition: Array, hessian: Array) -> Array:
    """(K, m, n) gains, u = gain x, of the time-varying linear-quadratic regulator.

    Args:
        transition: (K, n, n + m) derivatives of the next state by state and control.
        hessian: (K, n + m, n + m) the Hessian of a step's cost.
    """
    steps, n, size = transition.shape
    limit = np.full(size - n, np.inf)
    model = Model(transition, np.zeros((steps, size)), hessian)
    return backward_pass(model, np.zeros((steps, size - n)), -limit, limit, 0.0).gain


def _starts(onsets: list[int], lead: int, shortest: int) -> list[int]:
    """First steps of the windows, which are at least `shortest` steps long."""
    starts = [0]
    for onset in sorted(onsets):
        if onset - lead >= starts[-1] + shortest:
            starts.append(onset - lead)
    return starts


def _units(names: tuple[str, ...]) -> Array:
    """Units of joints or servos: forearms slide, all others turn."""
    return np.array([_SLIDE if "forearm_t" in name else _HINGE for name in names])


def _coordinates(state: State) -> Array:
    """(N, 2 J) positions and speeds of the joints."""
    return np.concatenate([state.hand_qpos, state.hand_qvel], axis=1)
