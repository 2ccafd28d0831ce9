"""What it costs a hand not to do what the steps ahead ask of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.hand_goals import ASTRAY, HandGoals
from cadenza.agents.planner.search.fingertip_correction import FURTHEST, mending
from cadenza.keyboards.keyboard import Keyboard
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WRONG = 3.0  # cost of a key that sounds and should not, or the other way round
_ONSET = 3.0  # of a note that has not begun in time, and of a key that begins where no note does
_ALMOST = (
    3.0  # of a key's travel that lacks to the stop, or passes what does not yet sound, squared
)
NO_HARM = 0.3  # of its travel that a key may be down
_COUNTS = np.array([0.55, 1.0, 1.0])  # distances along the key count less
_ONES = np.ones(3)
_AT_THE_END = 1.5  # of the horizon they count more


class Rollout(NamedTuple):
    """What came of trying a plan."""

    cost: float
    mistakes: int
    """How often a key was wrong."""
    steps: list[float]
    """What each of the steps that were simulated cost."""
    fingertips: list[Array]
    """(F, 3) after each of them [m]."""
    hand_qpos: list[Array]
    """(J,) likewise [m, rad]."""
    key_qpos: list[Array]
    """(K,) likewise, of the keys that count [rad]."""


class HorizonCost:
    """What the steps ahead ask of a hand, and what it costs not to do it.

    Attributes:
        num_steps: H.
        sounding: (K,) the keys that sound before them.
    """

    def __init__(
        self,
        part: HandGoals,
        rows: NDArray[np.intp],
        keyboard: Keyboard,
        keys: slice,
        key_qpos: Array,
    ) -> None:
        """Args:
        part: of the hand.
        rows: (H,) the steps.
        keyboard: all of it.
        keys: those that count, K of them.
        key_qpos: (K,) before the steps [rad].
        """
        self._part, self._rows, self._keyboard, self._keys = part, rows, keyboard, keys
        mine, wrong = part.mine[rows, keys], part.wrong[rows, keys]
        self._mine, self._counts = mine, mine | wrong
        self._asked = part.asked[rows, keys]
        self._mistaken = (mine & part.planned[rows, keys]) | wrong
        self._due, self._unwelcome = part.due[rows, keys], part.unwelcome[rows, keys]
        self._sounds_from = keyboard.sounds_from[keys]
        self.num_steps, self.sounding = len(rows), key_qpos >= self._sounds_from
        # How far a key is from where it would do no harm, of its travel, is slope * angle + offset.
        sign = wrong.astype(np.float64) - mine
        self._slope = sign / keyboard.travel[keys]
        self._offset = np.where(mine, 1.0, np.where(wrong, -NO_HARM, 0.0))
        self._fingertips = part.fingertips[rows + 1]
        self._weight = part.weight[rows + 1]
        self._weight[-1] *= _AT_THE_END

    def cost(
        self, k: int, key_qpos: Array, fingertips: Array, before: Mask
    ) -> tuple[float, int, Mask]:
        """Cost and mistakes of a state after the k-th of the steps, and the keys that sound.

        A key that the plan lets go early is no mistake to search for, though it costs.

        Args:
            k: which step.
            key_qpos: (K,) of the keys that count [rad].
            fingertips: (F, 3) [m].
            before: (K,) those that sounded before the step.
        """
        sounding = key_qpos >= self._sounds_from
        amiss = (sounding ^ self._mine[k]) & self._counts[k]
        wrong = int(np.count_nonzero(amiss))
        amiss_onsets = np.where(sounding, self._unwelcome[k] & ~before, self._due[k])
        onsets = int(np.count_nonzero(amiss_onsets))
        lacking = np.maximum(self._slope[k] * key_qpos + self._offset[k], 0.0)
        offset = (fingertips - self._fingertips[k]) * _COUNTS
        astray = np.minimum((offset * offset) @ _ONES, FURTHEST**2) @ self._weight[k]
        mistakes = int(np.count_nonzero(amiss & self._mistaken[k])) if wrong else 0
        cost = _WRONG * wrong + _ONSET * onsets + _ALMOST * (lacking @ lacking) + astray
        return float(cost), mistakes, sounding

    def by_finger(self, trial: Rollout) -> Array:
        """(L, F) what each of the L steps of a trial cost, by the finger whose fault it is.

        A key of the hand's own is that of the finger that is asked for it, another that of the
        finger that is nearest.
        """
        steps = len(trial.steps)
        key_qpos, tips = np.array(trial.key_qpos), np.array(trial.fingertips)
        sounding = key_qpos >= self._sounds_from
        before = np.concatenate([self.sounding[None], sounding[:-1]])
        mine, unwelcome = self._mine[:steps], self._unwelcome[:steps] & ~before
        wrong = (sounding ^ mine) & self._counts[:steps]
        onsets = np.where(sounding, unwelcome, self._due[:steps])
        lacking = np.maximum(self._slope[:steps] * key_qpos + self._offset[:steps], 0.0)
        cost = _WRONG * wrong + _ONSET * onsets + _ALMOST * lacking**2
        offset = (tips - self._fingertips[:steps]) * _COUNTS
        costs = np.minimum((offset * offset) @ _ONES, FURTHEST**2) * self._weight[:steps]
        step, key = np.nonzero(cost)
        away = tips[step] - self._keyboard.centre[self._keys][key, None]
        nearest = np.hypot(away[..., 1], away[..., 2]).argmin(axis=1)
        finger = np.where(mine[step, key], self._asked[step, key], nearest)
        np.add.at(costs, (step, finger), cost[step, key])
        return costs

    def astray(self, fingertips: Array) -> tuple[Array, Array]:
        """(H, F, 3) the ways from fingertips (H, F, 3) to where they should be [m].

        And (H, F) how much they count: 1 for those that play, more at the end of what is ahead.
        """
        return self._fingertips - fingertips, self._weight / ASTRAY

    def mending(self, fingertips: Array, sounding: Mask) -> tuple[Array, Array]:
        """As `astray`, but deeper or higher where keys (H, K) sounded wrong, see `mending`."""
        return mending(self._part, self._rows, self._keyboard, self._keys, fingertips, sounding)


def look_ahead(
    part: HandGoals,
    rows: NDArray[np.intp],
    keyboard: Keyboard,
    trials: HandRollouts,
    here: PlanningSimulation,
) -> HorizonCost:
    """What steps (H,) ask of a hand from where it is; trials begin there, over all keys on its way.

    Args:
        part: of the hand.
        rows: (H,) the steps.
        keyboard: all of it.
        trials: of the hand.
        here: where it is.
    """
    tips = here.state.fingertip_xpos[0, part.fingers, 1]
    y = np.append(part.fingertips[rows + 1, :, 1], tips)
    trials.begin_from(here, float(y.min()), float(y.max()))
    return HorizonCost(part, rows, keyboard, trials.keys, here.state.key_qpos[0, trials.keys])
