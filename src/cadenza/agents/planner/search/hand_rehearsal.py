"""Rehearsal of one hand: iterative learning control of the next half second of its plan.

Each iteration rolls the plan out in simulation, with feedback, and updates the controls by the
fingertip errors of this rollout. The cheapest rollout is kept. Nothing is random.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, steps_in
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.strike_model import strike_model
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.fingertip_correction import control_update
from cadenza.agents.planner.search.horizon_cost import HorizonCost
from cadenza.agents.planner.search.rollouts import Rollout, roll_out, start_rollouts
from cadenza.agents.planner.search.strike_refinement import StrikeRefinement
from cadenza.agents.planner.search.strikes import HorizonStrikes
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation

_LEARNING_RATE = 0.7  # share of the update of the linear model
_SAME_POSTURE = 1e-3  # [m, rad] between a hand and a rollout of it that goes as rehearsed


class RehearsalConfig(NamedTuple):
    """Parameters of a rehearsal; the defaults are for a hand that searches where it fails."""

    window: float = 0.5
    """The duration that is rehearsed, then played [s]."""
    cost_after: float = 0.2
    """The time after the window that counts in the cost, so that the hand can go on [s]."""
    updated_after: float = 0.4
    """The time after the window whose controls are updated, too [s]."""
    iterations: int = 5
    """The maximum number of rollouts."""
    refinements: int = 16
    """The maximum number of rollouts in which strikes are refined."""
    max_mistakes: float = 0.5
    """The maximum share of the plan's mistakes in a rollout to be kept. With more, fingers are
    caught, and a search that begins with the plan frees them sooner."""


_DEFAULT = RehearsalConfig()


class HandRehearsal:
    """Rehearsed controls of the next steps.

    Attributes:
        lookahead: the number of steps of the plan that a rehearsal needs.
        tail: (N, A) controls of the steps from `end` on, in the best rollout.
        keys: the keys near the hand.
        keys_at_end: (2, K) positions and speeds of these keys before the step `end`, in the best
            rollout [rad, rad/s].
    """

    def __init__(
        self, scene: Scene, simulator: HandRollouts, dt: float, config: RehearsalConfig = _DEFAULT
    ) -> None:
        """Begin without rehearsed steps, for a hand that is alone in a scene."""
        self._config, self._dt, self._simulator = config, dt, simulator
        self._servos, self._keyboard = servos_of(scene), scene.keyboard
        self._window = steps_in(config.window, dt)
        self._refinement = StrikeRefinement(self._servos, strike_model(scene, dt))
        self._cost_steps = self._window + steps_in(config.cost_after, dt)
        self.lookahead = self._window + steps_in(config.updated_after, dt)
        self.reset()

    def reset(self) -> None:
        """Forget all rehearsed steps."""
        self._first, self._ctrl = 0, np.zeros((0, len(self._servos.noise)))
        self._expected = np.zeros((0, 0))  # (N, J) before each step
        self.tail = self._ctrl
        self.keys, self.keys_at_end = slice(0), np.zeros((2, 0))

    @property
    def end(self) -> int:
        """The step after the last rehearsed one."""
        return self._first + len(self._ctrl)

    def ctrl(self, step: int) -> Array:
        """Rehearsed controls (N, A) from `step` on."""
        return self._ctrl[step - self._first :]

    def goes_as_rehearsed(self, step: int, hand_qpos: Array) -> bool:
        """Whether the hand is at `hand_qpos` (J,) before `step` in a rollout without mistakes."""
        row = step - self._first
        if not 0 <= row < len(self._expected):
            return False
        return bool(np.abs(hand_qpos - self._expected[row]).max() < _SAME_POSTURE)

    def rehearse(
        self,
        goals: HandGoals,
        tracking: Tracking,
        steps: NDArray[np.intp],
        simulation: PlanningSimulation,
    ) -> int:
        """Rehearse the next steps (S,) of a plan, and return the number of steps of all rollouts.

        There are `lookahead` steps, or less at the end of the plan. The simulation is of the hand
        on all keys, in its current state.
        """
        horizon = start_rollouts(self._simulator, simulation, goals, steps, self._keyboard)
        ctrl = best_ctrl = tracking.ctrl[steps]
        best = rollout = self._roll_out(ctrl, tracking, steps, horizon)
        max_mistakes, simulated = self._config.max_mistakes * rollout.mistakes, len(steps)
        for _ in range(self._config.iterations - 1):
            if not rollout.mistakes:
                break
            update = self._update(rollout, tracking.gain[steps], horizon)
            ctrl = self._servos.clip(ctrl + _LEARNING_RATE * update)
            rollout = self._roll_out(ctrl, tracking, steps, horizon)
            simulated += len(steps)
            if rollout.cost < best.cost and rollout.mistakes <= max_mistakes:
                best_ctrl, best = ctrl, rollout
        cost_steps = steps[: self._cost_steps + 1]  # with the next one, as strikes may be late
        keys = self._simulator.keys
        silent = horizon.start.silent
        strikes = HorizonStrikes(goals, cost_steps, self._keyboard, keys, self._cost_steps, silent)
        restarts = sorted({step - 1 for step in strikes.step.tolist() if step > 1})
        last: tuple[Array, Rollout] | None = None

        def roll_out_from_change(ctrl: Array) -> Rollout:
            """Rollout of controls, from where they begin to differ from the last ones."""
            nonlocal last
            ctrl, first = ctrl[: len(cost_steps)], 0
            if last is not None:
                changed = (ctrl != last[0]).any(axis=1)
                if not changed.any():
                    return last[1]
                first = max(step for step in (0, *restarts) if step <= changed.argmax())
            previous = None if last is None else last[1]
            rollout = self._roll_out(ctrl, tracking, cost_steps, horizon, previous, first, restarts)
            last = ctrl, rollout
            return rollout

        refined = self._refinement.refine(
            best_ctrl,
            best,
            strikes,
            self._simulator.fingertip_jacobian,
            roll_out_from_change,
            self._config.refinements,
        )
        simulated += refined.rollouts * len(cost_steps)
        self._keep(int(steps[0]), simulation.state.hand_qpos[0], refined.ctrl, refined.rollout)
        return simulated

    def _keep(self, first: int, hand_qpos: Array, ctrl: Array, rollout: Rollout) -> None:
        window = self._window
        expected = [] if rollout.mistakes else [hand_qpos, *rollout.hand_qpos[: window - 1]]
        self._expected = np.array(expected)
        self._first, self._ctrl, self.tail = first, ctrl[:window], ctrl[window:]
        last = min(window, len(ctrl)) - 1
        self.keys = self._simulator.keys
        self.keys_at_end = np.stack([rollout.key_qpos[last], rollout.key_qvel[last]])

    def _roll_out(
        self,
        ctrl: Array,
        tracking: Tracking,
        steps: NDArray[np.intp],
        horizon: HorizonCost,
        previous: Rollout | None = None,
        first: int = 0,
        snapshots: Sequence[int] = (),
    ) -> Rollout:
        """Simulate controls (S, A), with feedback, from the step `first` on, see `roll_out`."""

        def with_feedback() -> Iterator[Array]:
            for step, planned in zip(steps[first:], ctrl[first:], strict=True):
                feedback = tracking.feedback(step, self._simulator.servo_state())
                yield self._servos.clip(planned - feedback)

        return roll_out(
            self._simulator,
            horizon,
            with_feedback(),
            cost_steps=self._cost_steps,
            previous=previous,
            first=first,
            snapshots=snapshots,
        )

    def _update(self, rollout: Rollout, feedback: Array, horizon: HorizonCost) -> Array:
        """Update (S, A) of the controls of a rollout of all S steps."""
        fingertips, key_paths = np.array(rollout.fingertips), np.array(rollout.key_paths)
        error, weight = horizon.errors_by_sound(fingertips, key_paths)
        jacobian = self._simulator.fingertip_jacobian(np.array(rollout.hand_qpos))
        return control_update(error, weight, jacobian, feedback, self._servos, self._dt)
