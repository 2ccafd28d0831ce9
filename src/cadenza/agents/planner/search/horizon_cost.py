"""Cost of a rollout over the look-ahead horizon of one hand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Mask
from cadenza.agents.planner.plan.hand_goals import TIP_WEIGHT, HandGoals
from cadenza.agents.planner.search.fingertip_correction import MAX_ERROR, clipped
from cadenza.agents.planner.search.strikes import HorizonStrikes
from cadenza.keyboards.keyboard import Keyboard

_WRONG_KEY = 3.0  # cost of a key that sounds and should not, or the other way round
_WRONG_ONSET = 3.0  # of a note that has not begun in time, and of an onset where no note begins
_DEPTH = 3.0  # of a key's squared distance from its harmless range, in units of its travel
HARMLESS_DEPTH = 0.3
"""Share of its travel that a key may be down without any cost."""
_AXES = np.array([0.55, 1.0, 1.0])  # fingertip errors along the key count less
_ONES = np.ones(3)
_TERMINAL = 1.5  # fingertip errors count this much more at the end of the horizon

_DEEPER = 0.006  # [m] that a fingertip should be whose key should sound and does not
_OVER_ITS_KEY = 0.006  # [m] of horizontal error up to which its height is what is wrong
_HIGHER = 0.01  # [m] that a fingertip should be whose key should not sound and does
_OVER_A_KEY = 0.015  # [m] from the middle of such a key up to which a fingertip presses it


class HorizonCost:
    """Cost of H steps of one hand, for the keys and the fingertips.

    Attributes:
        num_steps: H, the number of steps.
        start: (K,) the keys that sound before the first step.
        strikes: how its keys should begin to sound.
    """

    def __init__(
        self,
        goals: HandGoals,
        steps: NDArray[np.intp],
        keyboard: Keyboard,
        keys: slice,
        key_qpos: Array,
    ) -> None:
        """Takes the goals of steps (H,) of the song for the K keys that are simulated.

        `key_qpos` (K,) are the angles of these before the first step [rad].
        """
        wanted, wrong = goals.keys[steps, keys], goals.wrong[steps, keys]
        self._wanted, self._wrong, self._counts = wanted, wrong, wanted | wrong
        self._finger = goals.finger[steps, keys]
        self._held = wanted & goals.planned[steps, keys]
        self._mistakes = self._held | wrong
        self._onset_due = goals.onset_due[steps, keys]
        self._onset_wrong = goals.onset_wrong[steps, keys]
        self._centre, self._half_size = keyboard.centre[keys], keyboard.half_size[keys]
        self._sounds_from = keyboard.sounds_from[keys]
        self.num_steps, self.start = len(steps), key_qpos >= self._sounds_from
        # A key's distance from its harmless range, in units of its travel: factor * angle + offset.
        sign = wrong.astype(np.float64) - wanted
        self._factor = sign / keyboard.travel[keys]
        self._offset = np.where(wanted, 1.0, np.where(wrong, -HARMLESS_DEPTH, 0.0))
        self._fingertips, self._weight = goals.fingertips[steps + 1], goals.weight[steps + 1]
        self._cost_weight = self._weight.copy()
        self._cost_weight[-1] *= _TERMINAL
        self.strikes = HorizonStrikes(goals, steps, keyboard, keys)

    def step_cost(
        self, k: int, key_path: Array, fingertips: Array, before: Mask
    ) -> tuple[float, int, Mask]:
        """The cost and the mistakes of the state after the k-th step, and the (K,) keys that sound.

        A key that the plan lets go early is no mistake to search for, though it costs.

        Args:
            k: the number of the step, from 0.
            key_path: (S + 1, K) before the step and after each of its physics steps [rad].
            fingertips: (F, 3) after the step [m].
            before: (K,) keys that sounded before the step.
        """
        key_qpos = key_path[-1]
        on_the_way = key_path >= self._sounds_from
        sounding = on_the_way[-1]
        wrong = (sounding ^ self._wanted[k]) & self._counts[k]
        num_wrong = int(np.count_nonzero(wrong))
        wrong_onsets = np.where(sounding, self._onset_wrong[k] & ~before, self._onset_due[k])
        # An own key may be struck again within the step. That other keys sound for a moment must
        # not cost, or caught fingers would not come free.
        onsets = np.count_nonzero((on_the_way[1:] > on_the_way[:-1]) & self._wanted[k], axis=0)
        again = np.maximum(onsets - (sounding & ~before), 0)
        num_onsets = int(np.count_nonzero(wrong_onsets) + again.sum())
        depth = np.maximum(self._factor[k] * key_qpos + self._offset[k], 0.0)
        error = (fingertips - self._fingertips[k]) * _AXES
        tips = np.minimum((error * error) @ _ONES, MAX_ERROR**2) @ self._cost_weight[k]
        mistakes = int(np.count_nonzero(wrong & self._mistakes[k])) if num_wrong else 0
        cost = _WRONG_KEY * num_wrong + _WRONG_ONSET * num_onsets + _DEPTH * (depth @ depth) + tips
        return float(cost) + self.strikes.cost(k, key_path), mistakes, sounding

    def by_finger(self, key_qpos: Array, fingertips: Array) -> Array:
        """(L, F) the cost of each of the first L steps, by finger.

        The cost of a key goes to the finger that should press it, or to the nearest one. After each
        step keys are at `key_qpos` (L, K) [rad] and `fingertips` at (L, F, 3) [m].
        """
        steps = len(key_qpos)
        sounding = key_qpos >= self._sounds_from
        before = np.concatenate([self.start[None], sounding[:-1]])
        wanted, onset_wrong = self._wanted[:steps], self._onset_wrong[:steps] & ~before
        wrong = (sounding ^ wanted) & self._counts[:steps]
        onsets = np.where(sounding, onset_wrong, self._onset_due[:steps])
        depth = np.maximum(self._factor[:steps] * key_qpos + self._offset[:steps], 0.0)
        cost = _WRONG_KEY * wrong + _WRONG_ONSET * onsets + _DEPTH * depth**2
        error = (fingertips - self._fingertips[:steps]) * _AXES
        costs = np.minimum((error * error) @ _ONES, MAX_ERROR**2) * self._cost_weight[:steps]
        step, key = np.nonzero(cost)
        offset = fingertips[step] - self._centre[key, None]
        nearest = np.hypot(offset[..., 1], offset[..., 2]).argmin(axis=1)
        finger = np.where(wanted[step, key], self._finger[step, key], nearest)
        np.add.at(costs, (step, finger), cost[step, key])
        return costs

    def fingertip_errors(self, fingertips: Array) -> tuple[Array, Array]:
        """(H, F, 3) targets less `fingertips` (H, F, 3) [m], and (H, F) weights of these errors.

        The weight of a finger that plays is 1, and more at the end of the horizon.
        """
        return self._fingertips - fingertips, self._cost_weight / TIP_WEIGHT

    def errors_by_sound(self, fingertips: Array, key_qpos: Array) -> tuple[Array, Array]:
        """Fingertip errors, clipped, with targets that are moved where a key sounded wrong.

        A target is deeper where a key should have sounded and did not, and higher where a fingertip
        came down on a key that should not have sounded. After each step `fingertips` are at
        (H, F, 3) [m] and keys at `key_qpos` (H, K) [rad].

        Returns:
            (H, F, 3) errors [m] and (H, F) weights, 1 for fingers that play.
        """
        sounding = key_qpos >= self._sounds_from
        error, weight = clipped(self._fingertips - fingertips), self._weight / TIP_WEIGHT
        step, key = np.nonzero(self._held & ~sounding)
        finger = self._finger[step, key]
        over = np.hypot(*error[step, finger, :2].T) < _OVER_ITS_KEY
        error[step[over], finger[over], 2] -= _DEEPER
        step, key = np.nonzero(self._wrong & sounding)
        beside = np.abs(fingertips[step, :, :2] - self._centre[key, None, :2])
        beside[..., 0] = np.maximum(beside[..., 0] - self._half_size[key, None, 0], 0.0)
        distance = beside.sum(axis=2)
        finger, over = distance.argmin(axis=1), distance.min(axis=1) < _OVER_A_KEY
        high = np.zeros(weight.shape, bool)
        for earlier in (0, 1):  # the finger has come too low the step before
            high[np.maximum(step - earlier, 0)[over], finger[over]] = True
        error[high, 2] += _HIGHER
        weight[high] = 1.0
        return clipped(error), weight
