"""Loss and cost of every control step of a hand: F1, note onsets, strikes, what is nearly lost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Mask
from cadenza.agents.planner.plan.hand_goals import HandGoals, first_steps, last_in_time, may_begin
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.fingertip_correction import MAX_ERROR
from cadenza.agents.planner.search.horizon_cost import HARMLESS_DEPTH
from cadenza.agents.planner.search.strikes import TOLERANCE, as_heard, strike_costs
from cadenza.tasks import reward

ONSET_WEIGHT = 0.5
"""The weight of the F1 of note onsets beside that of F1, which is 1."""
_EXTRA_ONSET = 0.5  # loss of a superfluous onset, relative to a missed one, which costs recall too
_LONG_AGO = 1_000_000  # steps
# All are small beside the loss of one key in one step, so that they only decide between rollouts
# that lose the same.
_DEPTH_WEIGHT = 0.06  # of the squared share of a key's travel that is missing or too much
_FINGERTIP_WEIGHT = 0.02  # of the cost that the search gives fingertips off their targets
_STRIKE_WEIGHT = 0.01  # of the cost that the search gives strikes


class KeyHistory(NamedTuple):
    """The state of K keys after a step, each (K,)."""

    sounding: Mask
    since: NDArray[np.intp]
    """The steps since the last onset of each key."""

    @classmethod
    def of_steps(cls, sounding: Mask) -> KeyHistory:
        """The history after steps (S, K), before which no key sounded."""
        history = cls(np.zeros(sounding.shape[1], bool), np.full(sounding.shape[1], _LONG_AGO))
        for keys in sounding:
            history = history.then(keys)
        return history

    def then(self, sounding: Mask) -> KeyHistory:
        """The history after one more step, with the keys (K,) that sound then."""
        begins = sounding & ~self.sounding
        return KeyHistory(sounding, np.where(begins, 0, self.since + 1))

    def of(self, keys: slice) -> KeyHistory:
        """The history of some of the keys."""
        return KeyHistory(self.sounding[keys], self.since[keys])


class KeyEvents(NamedTuple):
    """How K keys began to sound in a step, each (K,); NaN for those that did not."""

    onset: Array
    """When, from the beginning of the step on [s]."""
    speed: Array
    """How fast they moved then [rad/s]."""


class StepLoss(NamedTuple):
    """The evaluation of a step."""

    loss: float
    """The loss of F1 and of note onsets."""
    strike_loss: float
    """The loss by strikes that are out of time, or too loud or too soft."""
    cost: float
    """Both, and a little for what is nearly lost."""
    history: KeyHistory
    """The keys after the step."""


class Losses:
    """Evaluates one hand after each step of a song.

    The loss of a step is 1 - F1, as if the other hand played all its keys. A note loses more if its
    key does not begin to sound on its first step or soon enough after it, as
    `cadenza.music.metrics` counts onsets. An onset at any other time loses half as much. Strikes
    lose little, and nothing within `TOLERANCE`.
    """

    def __init__(self, plan: SongPlan, goals: HandGoals) -> None:
        """Takes the plan of the whole song, and the goals of the hand in it."""
        keys, dt = plan.goals.keys, plan.track.config.control_timestep
        self._goals, self._keyboard = goals, plan.scene.keyboard
        self._keys, self._num_wanted = keys, keys.sum(axis=1)
        self._in_time, self._may_begin = last_in_time(goals.keys, dt), may_begin(keys, dt)
        self._onset = ONSET_WEIGHT * len(keys) / max(int(first_steps(keys).sum()), 1)

    def after(
        self,
        step: int,
        key_qpos: Array,
        events: KeyEvents,
        fingertips: Array,
        history: KeyHistory,
        keys: slice = slice(None),
        near: Mask | bool = True,
    ) -> StepLoss:
        """Evaluates the state after a step.

        Args:
            step: the control step of the song.
            key_qpos: (K,) angles of the keys [rad].
            events: how they began to sound in the step.
            fingertips: (F, 3) positions of the hand's fingertips [m].
            history: the keys before the step.
            keys: the numbers of these keys; all by default.
            near: (K,) keys that the hand is charged with if they sound and should not.
        """
        goals, keyboard, wanted = self._goals, self._keyboard, self._keys[step, keys]
        mine, travel = goals.keys[step, keys], keyboard.travel[keys]
        unwanted = ~wanted & near
        sounding = reward.key_activation(key_qpos, keyboard.sounds_from[keys])
        now, in_time = history.then(sounding), self._in_time[step, keys]
        begins = now.since == 0
        missing = np.count_nonzero(mine & ~sounding)
        wrong = np.count_nonzero(sounding & unwanted)
        loss = (missing + wrong) / max(2 * self._num_wanted[step] - missing + wrong, 1)
        late = (in_time >= 0) & (now.since > in_time)
        extra = begins & ~self._may_begin[step, keys] & near
        onsets = np.count_nonzero(late) + _EXTRA_ONSET * np.count_nonzero(extra)
        loss += self._onset * onsets
        depth = reward.key_state(key_qpos, travel)
        too_high = mine * (1.0 - depth)
        too_deep = unwanted * np.maximum(depth - HARMLESS_DEPTH, 0.0)
        offset = fingertips - goals.fingertips[step + 1]
        squared = np.minimum((offset * offset).sum(axis=1), MAX_ERROR**2)
        astray = squared @ goals.weight[step + 1]
        nearly = _DEPTH_WEIGHT * (too_high @ too_high + too_deep @ too_deep)
        nearly += _FINGERTIP_WEIGHT * astray
        strike_loss, more = self._strikes(step, events, keys)
        return StepLoss(float(loss), strike_loss, float(loss + nearly) + more, now)

    def _strikes(self, step: int, events: KeyEvents, keys: slice) -> tuple[float, float]:
        """The loss and the cost of the strikes of a step, of these keys."""
        strikes = self._goals.strikes
        first, last, _ = keys.indices(self._keyboard.num_keys)
        rows = np.arange(*np.searchsorted(strikes.step, [step, step + 1]))
        rows = rows[(strikes.key[rows] >= first) & (strikes.key[rows] < last)]
        if not len(rows):
            return 0.0, 0.0
        key = strikes.key[rows] - first
        outcome = np.column_stack([events.onset[key], as_heard(events.speed[key])])
        wanted = np.column_stack([strikes.time[rows], as_heard(strikes.speed[rows])])
        costs = _STRIKE_WEIGHT * strike_costs(outcome, wanted)
        good = (np.abs(outcome - wanted) < TOLERANCE).all(axis=1)
        return float(costs[~good].sum()), float(costs.sum())
