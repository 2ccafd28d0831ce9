"""Cost of a rollout over the look-ahead horizon of one hand."""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Mask, steps_in
from cadenza.agents.planner.plan.hand_goals import TIP_WEIGHT, HandGoals
from cadenza.agents.planner.search.fingertip_correction import MAX_ERROR, clipped
from cadenza.agents.planner.search.strikes import HorizonStrikes
from cadenza.keyboards.keyboard import Keyboard
from cadenza.music.performance import BOUNCE

_WRONG_KEY = 3.0  # cost of a key that sounds and should not, or is silent and should sound
_WRONG_ONSET = 3.0  # of a note that has not begun in time, and of an onset without a note
_BRUSHED = 1.5  # of a wrong key that only sounds within a step, which is audible
_DEPTH = 3.0  # of a key's squared distance from its harmless range, in units of its travel
HARMLESS_DEPTH = 0.3  # share of its travel that a key may be down without any cost
_AXES = np.array([0.55, 1.0, 1.0])  # weights of the axes of fingertip errors: less along the key
_ONES = np.ones(3)
_TERMINAL = 1.5  # factor of fingertip errors at the end of the horizon

# Corrections of the targets of fingertips by what sounded.
_DEEPER = 0.006  # [m] for a key that should sound and does not
_OVER_ITS_KEY = 0.006  # [m] horizontal error of a fingertip over its key
_HIGHER = 0.01  # [m] for a key that should not sound and does
_OVER_A_KEY = 0.015  # [m] distance from the middle of such a key of a fingertip that presses it
_ASIDE = 0.002  # [m] for a fingertip that brushes such a key beside its own
_WORTH_STRIKING = 0.75  # [s] that must be left of a note to strike it late
_LIFTED = 0.008  # [m] above its own key, for a finger whose note is lost


class KeyStates(NamedTuple):
    """The state of K keys after a step, (K,) each.

    A note is lost if it has not begun in time, or was released too early, unless much of it is
    left: to strike it again would be an extra note, and late.
    """

    sounding: Mask
    lost: Mask
    """Own keys whose notes were lost within the rollout: wrong until their notes should end."""
    given_up: Mask
    """Own keys whose notes were lost before the rollout, which cannot mend them."""
    silent: Array
    """Minimum time for which keys have been silent [s], a multiple of the physics step."""
    costs: Array
    """Costs of the keys in the step."""
    wrong_notes: int
    """The number of missed and extra notes in the step, as a listener would count them."""


class HorizonCost:
    """Cost of H steps of one hand, for the keys and the fingertips.

    Attributes:
        num_steps: H, the number of steps.
        start: the keys before the first step.
        strikes: the targets of timed strikes.
    """

    def __init__(
        self,
        goals: HandGoals,
        steps: NDArray[np.intp],
        keyboard: Keyboard,
        keys: slice,
        key_qpos: Array,
        silent: Array | float = np.inf,
    ) -> None:
        """Take the goals of steps (H,) of the song for the K simulated keys.

        `key_qpos` (K,) are the angles of the keys before the first step [rad], and `silent` (K,)
        the time for which they have been silent [s], infinite if it does not matter.
        """
        target, wrong = goals.keys[steps, keys], goals.wrong[steps, keys]
        self._target, self._wrong, self._counts = target, wrong, target | wrong
        self._finger = goals.finger[steps, keys]
        self._held = target & goals.planned[steps, keys]
        self._mistakes = self._held | wrong
        self._onset_due = goals.onset_due[steps, keys]
        self._onset_wrong = goals.onset_wrong[steps, keys]
        self._centre, self._half_size = keyboard.centre[keys], keyboard.half_size[keys]
        self._sounds_from = keyboard.sounds_from[keys]
        self.num_steps, sounding = len(steps), key_qpos >= self._sounds_from
        self._late = target & self._onset_wrong & ~_goes_on(goals, steps, keys)
        given_up = self._late[0] & ~sounding
        silent = np.where(sounding, 0.0, silent)
        free = np.zeros(len(sounding))
        self.start = KeyStates(sounding, np.zeros_like(given_up), given_up, silent, free, 0)
        self._dt = goals.dt
        # A key's distance from its harmless range, in units of its travel: factor * angle + offset.
        sign = wrong.astype(np.float64) - target
        self._factor = sign / keyboard.travel[keys]
        self._offset = np.where(target, 1.0, np.where(wrong, -HARMLESS_DEPTH, 0.0))
        self._fingertips, self._weight = goals.fingertips[steps + 1], goals.weight[steps + 1]
        if given_up.any():
            self._fingertips = self._fingertips.copy()
            step, key = np.nonzero(np.logical_and.accumulate(self._late) & given_up)
            self._fingertips[step, self._finger[step, key], 2] += _LIFTED
        self._cost_weight = self._weight.copy()
        self._cost_weight[-1] *= _TERMINAL
        self.strikes = HorizonStrikes(goals, steps, keyboard, keys, silent=silent)

    def costs(
        self, first: int, key_paths: Array, fingertips: Array, before: KeyStates
    ) -> list[tuple[float, int, KeyStates]]:
        """Cost and mistakes of L steps from `first` on, each with the keys after it.

        A key that the plan releases early costs, but is no mistake to search for.

        Args:
            first: the number of the first of these steps, from 0.
            key_paths: (L, S + 1, K) before each step and after each of its physics steps [rad].
            fingertips: (L, F, 3) after each step [m].
            before: the keys before the first of these steps.
        """
        rows = slice(first, first + len(key_paths))
        of_keys, mistakes, keys = self._key_costs(rows, key_paths, before)
        error = (fingertips - self._fingertips[rows]) * _AXES
        squared = np.minimum((error * error) @ _ONES, MAX_ERROR**2)
        costs = of_keys.sum(axis=1) + (squared * self._cost_weight[rows]).sum(axis=1)
        strikes = [self.strikes.cost(k, path) for k, path in enumerate(key_paths, first)]
        return list(zip((costs + strikes).tolist(), mistakes.tolist(), keys, strict=True))

    def _key_costs(
        self, rows: slice, key_paths: Array, before: KeyStates
    ) -> tuple[Array, NDArray[np.intp], list[KeyStates]]:
        """Costs (L, K) of the keys, numbers (L,) of mistakes, and the keys after each step."""
        target, late, onset_wrong = self._target[rows], self._late[rows], self._onset_wrong[rows]
        is_sounding = key_paths >= self._sounds_from
        sounding, in_step = is_sounding[:, -1], is_sounding[:, 1:]
        sounding_before = np.concatenate([before.sounding[None], sounding[:-1]])
        begins = sounding & ~sounding_before
        lost, given_up = _lost_notes(late, sounding, before)
        is_lost, is_given_up = lost[:-1] & late, given_up[:-1] & late
        wrong = ((sounding ^ target) & self._counts[rows] | is_lost) & ~is_given_up
        wrong_onsets = np.where(sounding, onset_wrong & begins, self._onset_due[rows])
        # An own key may be struck again within the step.
        onsets = ((in_step > is_sounding[:, :-1]) & target[:, None]).sum(axis=1)
        repeats = np.maximum(onsets - begins, 0)
        any_sound = np.logical_or.reduce(in_step, axis=1)
        silent, silent_before = self._silence(in_step, any_sound, before)
        unheard = any_sound & ~sounding_before & (silent_before < BOUNCE) & target & ~onset_wrong
        brushed = any_sound & self._wrong[rows] & ~sounding & ~sounding_before
        depth = np.maximum(self._factor[rows] * key_paths[:, -1] + self._offset[rows], 0.0)
        depth[is_lost | is_given_up] = 0.0
        struck_wrong = wrong_onsets + repeats + unheard
        costs = _WRONG_KEY * wrong + _WRONG_ONSET * struck_wrong + _BRUSHED * brushed
        costs += _DEPTH * (depth * depth)
        mistakes = (wrong & self._mistakes[rows]) + brushed + repeats + unheard
        mistakes += wrong_onsets & begins & target
        wrong_notes = brushed + repeats + unheard
        wrong_notes += wrong_onsets & (begins | self._held[rows]) & ~is_given_up
        counts = wrong_notes.sum(axis=1).tolist()
        after = map(KeyStates, sounding, lost[1:], given_up[1:], silent, costs, counts)
        return costs, mistakes.sum(axis=1), list(after)

    def _silence(self, in_step: Mask, any_sound: Mask, before: KeyStates) -> tuple[Array, Array]:
        """Silence (L, K) of keys after each step, and before their onset in it [s].

        `in_step` (L, S, K) is whether keys sound after each physics step, and
        `any_sound` (L, K) whether they do in a step.
        """
        substep = self._dt / in_step.shape[1]
        silent = substep * in_step[:, ::-1].argmax(axis=1)
        start, earlier = np.empty_like(silent), before.silent
        for k, sounds in enumerate(any_sound):
            start[k] = earlier
            earlier = silent[k] = np.where(sounds, silent[k], earlier + self._dt)
        return silent, start + substep * in_step.argmax(axis=1)

    def by_finger(self, of_keys: Array, fingertips: Array) -> Array:
        """Cost (L, F) of each of the first L steps, by finger.

        The finger that should press a key pays for it, or else the nearest one.

        Args:
            of_keys: (L, K) the costs of the keys.
            fingertips: (L, F, 3) after each step [m].
        """
        error = (fingertips - self._fingertips[: len(fingertips)]) * _AXES
        costs = np.minimum((error * error) @ _ONES, MAX_ERROR**2)
        costs *= self._cost_weight[: len(fingertips)]
        step, key = np.nonzero(of_keys)
        offset = fingertips[step] - self._centre[key, None]
        nearest = np.hypot(offset[..., 1], offset[..., 2]).argmin(axis=1)
        finger = np.where(self._target[step, key], self._finger[step, key], nearest)
        np.add.at(costs, (step, finger), of_keys[step, key])
        return costs

    def fingertip_errors(self, fingertips: Array) -> tuple[Array, Array]:
        """Targets less `fingertips` (H, F, 3) [m], and (H, F) weights of these errors.

        The weight of a playing finger is 1, and more at the end of the horizon.
        """
        return self._fingertips - fingertips, self._cost_weight / TIP_WEIGHT

    def errors_by_sound(self, fingertips: Array, key_paths: Array) -> tuple[Array, Array]:
        """Fingertip errors, clipped, after corrections of the targets by what sounded.

        The target for a key that should have sounded and did not is deeper, unless its note was
        lost before. If a key sounded that should not have, the target of a fingertip that came down
        on it is higher, and that of a fingertip on the key beside it farther away. Returns errors
        (H, F, 3) [m] and weights (H, F), 1 for playing fingers.

        Args:
            fingertips: (H, F, 3) after each step [m].
            key_paths: (H, S + 1, K) before each step and after each of its physics steps [rad].
        """
        is_sounding = key_paths >= self._sounds_from
        error, weight = clipped(self._fingertips - fingertips), self._weight / TIP_WEIGHT
        self._move_down(error, is_sounding[:, -1])
        step, key = np.nonzero(self._wrong & is_sounding[:, 1:].any(axis=1))
        finger, is_over = self._nearest(fingertips[step], key)
        step, key, finger = step[is_over], key[is_over], finger[is_over]
        presses = np.zeros(weight.shape, bool)  # in this step or the next
        held_step, held_key = np.nonzero(self._held)
        presses[held_step, self._finger[held_step, held_key]] = True
        presses[:-1] |= presses[1:]
        aside = presses[step, finger]
        side = np.sign(self._fingertips[step, finger, 1] - self._centre[key, 1])
        high = np.zeros(weight.shape, bool)
        for earlier in (0, 1):  # the finger has come too low, or too near, the step before
            row = np.maximum(step - earlier, 0)
            error[row[aside], finger[aside], 1] += _ASIDE * side[aside]
            weight[row[aside], finger[aside]] = 1.0
            high[row[~aside], finger[~aside]] = True
        error[high, 2] += _HIGHER
        weight[high] = 1.0
        return clipped(error), weight

    def _move_down(self, error: Array, sounding: Mask) -> None:
        """Move targets in `error` (H, F, 3) down for keys (H, K) that should be sounding.

        Of a lost note, only the first step counts.
        """
        silent, lost = self._held & ~sounding, np.zeros(sounding.shape[1], bool)
        for k, late in enumerate(self._late):
            lost &= late
            silent[k] &= ~lost
            lost |= late & ~sounding[k]
        step, key = np.nonzero(silent)
        finger = self._finger[step, key]
        is_over = np.hypot(*error[step, finger, :2].T) < _OVER_ITS_KEY
        error[step[is_over], finger[is_over], 2] -= _DEEPER

    def _nearest(self, fingertips: Array, key: NDArray[np.intp]) -> tuple[NDArray[np.intp], Mask]:
        """Fingers (N,) nearest to keys (N,), and whether they are over them.

        The hand of each has its `fingertips` at (N, F, 3) [m].
        """
        beside = np.abs(fingertips[..., :2] - self._centre[key, None, :2])
        beside[..., 0] = np.maximum(beside[..., 0] - self._half_size[key, None, 0], 0.0)
        distance = beside.sum(axis=2)
        return distance.argmin(axis=1), distance.min(axis=1) < _OVER_A_KEY


def _lost_notes(late: Mask, sounding: Mask, before: KeyStates) -> tuple[Mask, Mask]:
    """Own keys (L + 1, K) with lost notes, and with notes given up, before and after each step.

    `late` (L, K) are keys whose notes would now be struck too late, and `sounding` (L, K) keys
    sound after a step.
    """
    given_up = np.concatenate([before.given_up[None], late & ~sounding])
    given_up = np.logical_and.accumulate(given_up)
    lost, may_be = np.empty_like(given_up), late & ~given_up[1:]
    lost[0] = before.lost
    for k, silent in enumerate(~sounding):
        lost[k + 1] = may_be[k] & (silent | lost[k])
    return lost, given_up


def _goes_on(goals: HandGoals, steps: NDArray[np.intp], keys: slice) -> Mask:
    """Whether own keys (H, K) go on for long enough to be struck late, in consecutive steps."""
    count = steps_in(_WORTH_STRIKING, goals.dt)
    ahead = goals.keys[steps[0] : steps[-1] + 1 + count, keys]
    ahead = np.pad(ahead, ((0, len(steps) + count - len(ahead)), (0, 0)))  # the end of the song
    return np.asarray(sliding_window_view(ahead, count + 1, axis=0).all(axis=-1))
