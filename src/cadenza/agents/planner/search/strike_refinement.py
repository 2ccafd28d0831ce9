"""Refinement of strikes: controls with which keys sound in time, and as loud as they should.

Each strike has two parameters: how much lower its fingertip is before the control step in which the
key is to sound, and how much lower its control leads it in that step. Each rollout evaluates one
Levenberg-Marquardt step of every strike. The Jacobian begins as that of the inverse model, and is
updated by Broyden's rule.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.strike_model import StrikeModel
from cadenza.agents.planner.search.rollouts import Rollout
from cadenza.agents.planner.search.strikes import TOLERANCE, UNIT, WEIGHT, HorizonStrikes
from cadenza.scene.servos import Servos

_MAX_SQUARED_ERROR = 30.0  # that counts, in units
_MISSED = 50.0  # cost of a key that does not sound
_FAULT = 3.0  # cost of a wrong key or onset, as in `horizon_cost`
_LOWER = np.array([0.001, 0.003])  # [m] where a key did not sound, times the iteration
_MAX_STEP = np.array([0.004, 0.008])  # [m] of the parameters
_RANGE = np.array([0.02, 0.04])  # [m] of the parameters
_DAMPING = 1e3  # [1/m^2] initial damping of Levenberg-Marquardt
_INCREASE, _DECREASE = 3.0, 1 / 3  # factors of the damping after a failure and after a success
_MIN_DAMPING = 0.3  # factor
_STUCK = 20.0  # factor of the damping above which steps are random, too: contacts are not smooth
_NOISE = np.array([0.0006, 0.002])  # [m] of random steps
_PATIENCE = 3  # rollouts without progress after which it ends
_THUMB = 0
_WRIST = 0.5  # weight of the wrist in the motion of a thumb, beside its own servos
_BROYDEN = 0.5  # share of Broyden's update, as contacts are not smooth


class Refined(NamedTuple):
    """Controls whose strikes have been refined."""

    ctrl: Array  # (H, A)
    rollout: Rollout  # the rollout of these controls
    rollouts: int  # the number of rollouts that it took


class StrikeRefinement:
    """Refinement of the strikes of one hand."""

    def __init__(self, servos: Servos, model: StrikeModel) -> None:
        """Take the servos of the hand, and the model by which strikes are planned."""
        self._servos, self._model = servos, model
        lag = servos.damping / servos.stiffness
        self._ease = servos.noise**2 * np.median(lag) / lag
        lifts_hand = (servos.finger < 0) & (servos.lift != 0)
        self._wrist = _WRIST * servos.noise**2 * lifts_hand

    def refine(
        self,
        ctrl: Array,
        rollout: Rollout,
        strikes: HorizonStrikes,
        jacobian: Callable[[Array], Array],
        roll_out: Callable[[Array], Rollout],
        iterations: int,
    ) -> Refined:
        """Find the cheapest controls with no more mistakes than `ctrl` (H, A), and their rollout.

        `jacobian` returns derivatives (S, F, 3, A) of fingertips by servos at joints (S, J), and
        `roll_out` simulates controls (H, A), at most `iterations` times.
        """
        if not len(strikes):
            return Refined(ctrl, rollout, 0)
        directions = self._directions(strikes, jacobian(np.array(rollout.hand_qpos)[strikes.step]))
        search = _Search(strikes, self._model)
        best, rollouts, in_vain = (ctrl, rollout), 0, 0
        for iteration in range(iterations + 1):
            search.update(strikes.outcome(rollout.key_paths), strikes.faults(rollout.key_paths))
            if search.done or iteration == iterations or in_vain == _PATIENCE:
                break
            last = iteration == iterations - 1
            in_vain += 1
            lower = search.best if last else search.next()
            candidate = self._lowered(ctrl, strikes, directions, lower)
            rollout, rollouts = roll_out(candidate), rollouts + 1
            if rollout.cost < best[1].cost and rollout.mistakes <= best[1].mistakes:
                best, in_vain = (candidate, rollout), 0
        return Refined(*best, rollouts)

    def _directions(self, strikes: HorizonStrikes, jacobian: Array) -> Array:
        """(N, A) smallest changes of servos that lower a strike's fingertip by 1 m.

        Slow servos change less. The servos are those of the finger, and for a thumb the wrist as
        well: a thumb has little room downwards, and one of its servos is slow.
        """
        weight = self._ease * (self._servos.finger == strikes.finger[:, None])
        weight += self._wrist * (strikes.finger[:, None] == _THUMB)
        down = -jacobian[np.arange(len(strikes)), strikes.finger, 2]
        return down * weight / (down * down * weight).sum(axis=1, keepdims=True)

    def _lowered(
        self, ctrl: Array, strikes: HorizonStrikes, directions: Array, lower: Array
    ) -> Array:
        """Controls (H, A) with fingertips lower by (N, 2) [m], before strikes and in them."""
        result, has_step_before = ctrl.copy(), strikes.step > 0
        before, during = (lower[:, i, None] * directions for i in range(2))
        np.add.at(result, strikes.step[has_step_before] - 1, before[has_step_before])
        np.add.at(result, strikes.step, during)
        return self._servos.clip(result)


class _Search:
    """Levenberg-Marquardt for N strikes of two parameters each, side by side.

    Attributes:
        best: (N, 2) the best parameters so far [m].
    """

    def __init__(self, strikes: HorizonStrikes, model: StrikeModel) -> None:
        count = len(strikes)
        time, speed = strikes.target[:, 0], 2.0 ** strikes.target[:, 1]
        self._jacobian = model.response(time, speed * strikes.lever, strikes.sounds_at)
        self._target, self._rng = strikes.target, np.random.default_rng(count)
        self.best, self._trial = np.zeros((count, 2)), np.zeros((count, 2))
        self._outcome = np.full((count, 2), np.nan)
        self._cost, self._damping = np.full(count, np.inf), np.ones(count)
        self._iteration = 0

    def update(self, outcome: Array, faults: Array) -> None:
        """Take the outcome (N, 2) of the last trial: times and log2 of speeds.

        `faults` (N,) are the numbers of wrong keys and onsets near the strikes.
        """
        self._update_jacobian(outcome)
        error = (outcome - self._target) / UNIT
        cost = np.minimum(error * error, _MAX_SQUARED_ERROR) @ WEIGHT
        cost[np.isnan(cost)] = _MISSED
        cost += _FAULT * faults
        better = cost < self._cost
        self.best[better], self._cost[better] = self._trial[better], cost[better]
        self._outcome[better] = outcome[better]
        self._damping = np.where(
            better, np.maximum(self._damping * _DECREASE, _MIN_DAMPING), self._damping * _INCREASE
        )
        self._iteration += 1

    def _update_jacobian(self, outcome: Array) -> None:
        """Broyden's rule, by the difference from the best so far."""
        step, change = self._trial - self.best, outcome - self._outcome
        length = (step * step).sum(axis=1)
        rows = (length > 0) & np.isfinite(change).all(axis=1)
        residual = change - np.einsum("nij,nj->ni", self._jacobian, step)
        update = residual[rows, :, None] * step[rows, None, :] / length[rows, None, None]
        self._jacobian[rows] += _BROYDEN * update

    @property
    def done(self) -> bool:
        """Whether the last trial is good enough, and the best."""
        return bool(self._good.all() and (self._trial == self.best).all())

    @property
    def _good(self) -> NDArray[np.bool_]:
        return (np.abs(self._outcome - self._target) < TOLERANCE).all(axis=1)

    def next(self) -> Array:
        """(N, 2) the parameters to try next."""
        error = (self._outcome - self._target) / UNIT
        missed = np.isnan(error).any(axis=1)
        scaled = self._jacobian / UNIT[:, None]
        damping = (self._damping * _DAMPING)[:, None, None] * np.eye(2)
        hessian = scaled.transpose(0, 2, 1) @ scaled + damping
        gradient = np.einsum("nij,ni->nj", scaled, np.where(missed[:, None], 0.0, error))
        step = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
        noise = self._rng.normal(size=step.shape) * _NOISE
        step += np.where(self._damping[:, None] > _STUCK, noise, 0.0)
        step = np.clip(step, -_MAX_STEP, _MAX_STEP)
        step[missed] = self._iteration * _LOWER
        step[self._good] = 0.0
        self._trial = np.clip(self.best + step, -_RANGE, _RANGE)
        return self._trial
