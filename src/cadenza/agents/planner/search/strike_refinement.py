"""Refinement of strikes: controls that make keys sound in time, and as loud as they should.

Each strike has two parameters: how much lower its fingertip is before the control step in which the
key is to sound, and how much lower its control leads it in that step. Levenberg-Marquardt steps are
taken for all strikes at once, which each rollout evaluates together. The Jacobian begins as that of
the inverse model and is updated by Broyden's rule.
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

_MOST = 30.0  # squared error that counts, in units
_MISSED = 50.0  # cost of a key that does not sound
_FAULT = 3.0  # cost of a key or an onset that is wrong, as in `horizon_cost`
_LOWER = np.array([0.001, 0.003])  # [m] where a key did not sound, more with each iteration
_STEP = np.array([0.004, 0.008])  # [m] that a step changes the parameters at most
_RANGE = np.array([0.02, 0.04])  # [m] of the parameters
_DAMPING = 1e3  # [1/m^2] of Levenberg and Marquardt, to begin with
_MORE, _LESS, _LEAST = 3.0, 1 / 3, 0.3  # factors of the damping after a failure, a success; bound
_STUCK = 20.0  # factor of the damping from which on steps are random too: contacts are not smooth
_NOISE = np.array([0.0006, 0.002])  # [m] of them
_PATIENCE = 3  # rollouts in vain, one after the other, after which it ends
_THUMB = 0
_WRIST = 0.5  # weight of the wrist in what a thumb does, compared with its own servos
_BROYDEN = 0.5  # share of Broyden's update that is taken, as contacts are not smooth


class Refined(NamedTuple):
    """Controls whose strikes have been refined."""

    ctrl: Array  # (H, A)
    rollout: Rollout  # the rollout of these controls
    rollouts: int  # the number of rollouts that it took


class StrikeRefinement:
    """Refines the strikes of one hand."""

    def __init__(self, servos: Servos, model: StrikeModel) -> None:
        """Takes the servos of the hand, and the model by which strikes are planned."""
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
        """Finds the cheapest controls with no more mistakes than `ctrl` (H, A), and their rollout.

        `jacobian` gives derivatives (S, F, 3, A) of fingertips by servos at joints (S, J), and
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
            tried = self._applied(ctrl, strikes, directions, search.best if last else search.next())
            rollout, rollouts = roll_out(tried), rollouts + 1
            if rollout.cost < best[1].cost and rollout.mistakes <= best[1].mistakes:
                best, in_vain = (tried, rollout), 0
        return Refined(*best, rollouts)

    def _directions(self, strikes: HorizonStrikes, jacobian: Array) -> Array:
        """(N, A) changes of servos that lower a strike's fingertip by 1 m: small, and soon done.

        They are of the finger's own servos, and for a thumb of the wrist as well: a thumb has
        little room downwards, and one of its servos is slow.
        """
        weight = self._ease * (self._servos.finger == strikes.finger[:, None])
        weight += self._wrist * (strikes.finger[:, None] == _THUMB)
        down = -jacobian[np.arange(len(strikes)), strikes.finger, 2]
        return down * weight / (down * down * weight).sum(axis=1, keepdims=True)

    def _applied(
        self, ctrl: Array, strikes: HorizonStrikes, directions: Array, lower: Array
    ) -> Array:
        """Controls (H, A) with fingertips lower by (N, 2) [m], before strikes and in them."""
        changed, early = ctrl.copy(), strikes.step > 0
        before, during = (lower[:, i, None] * directions for i in range(2))
        np.add.at(changed, strikes.step[early] - 1, before[early])
        np.add.at(changed, strikes.step, during)
        return self._servos.clip(changed)


class _Search:
    """Levenberg-Marquardt for N strikes of two parameters each, side by side.

    Attributes:
        best: (N, 2) the best parameters so far [m].
    """

    def __init__(self, strikes: HorizonStrikes, model: StrikeModel) -> None:
        count = len(strikes)
        time, speed = strikes.wanted[:, 0], 2.0 ** strikes.wanted[:, 1]
        self._jacobian = model.response(time, speed * strikes.lever, strikes.sounds_at)
        self._wanted, self._rng = strikes.wanted, np.random.default_rng(count)
        self.best, self._tried = np.zeros((count, 2)), np.zeros((count, 2))
        self._outcome = np.full((count, 2), np.nan)
        self._cost, self._damping = np.full(count, np.inf), np.ones(count)
        self._iteration = 0

    def update(self, outcome: Array, faults: Array) -> None:
        """Takes the outcome (N, 2) of what was tried last, times and log2 of speeds.

        `faults` (N,) are the keys and onsets near the strikes that are wrong.
        """
        self._update_jacobian(outcome)
        error = (outcome - self._wanted) / UNIT
        cost = np.minimum(error * error, _MOST) @ WEIGHT
        cost[np.isnan(cost)] = _MISSED
        cost += _FAULT * faults
        better = cost < self._cost
        self.best[better], self._cost[better] = self._tried[better], cost[better]
        self._outcome[better] = outcome[better]
        self._damping = np.where(
            better, np.maximum(self._damping * _LESS, _LEAST), self._damping * _MORE
        )
        self._iteration += 1

    def _update_jacobian(self, outcome: Array) -> None:
        """Broyden's rule, by the difference from the best so far."""
        moved, changed = self._tried - self.best, outcome - self._outcome
        length = (moved * moved).sum(axis=1)
        known = (length > 0) & np.isfinite(changed).all(axis=1)
        missing = changed - np.einsum("nij,nj->ni", self._jacobian, moved)
        update = missing[known, :, None] * moved[known, None, :] / length[known, None, None]
        self._jacobian[known] += _BROYDEN * update

    @property
    def done(self) -> bool:
        """Whether what was tried last is good enough, and the best."""
        return bool(self._good.all() and (self._tried == self.best).all())

    @property
    def _good(self) -> NDArray[np.bool_]:
        return (np.abs(self._outcome - self._wanted) < TOLERANCE).all(axis=1)

    def next(self) -> Array:
        """(N, 2) the parameters to try next."""
        error = (self._outcome - self._wanted) / UNIT
        missed = np.isnan(error).any(axis=1)
        scaled = self._jacobian / UNIT[:, None]
        damping = (self._damping * _DAMPING)[:, None, None] * np.eye(2)
        hessian = scaled.transpose(0, 2, 1) @ scaled + damping
        gradient = np.einsum("nij,ni->nj", scaled, np.where(missed[:, None], 0.0, error))
        step = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
        noise = self._rng.normal(size=step.shape) * _NOISE
        step += np.where(self._damping[:, None] > _STUCK, noise, 0.0)
        step = np.clip(step, -_STEP, _STEP)
        step[missed] = self._iteration * _LOWER
        step[self._good] = 0.0
        self._tried = np.clip(self.best + step, -_RANGE, _RANGE)
        return self._tried
