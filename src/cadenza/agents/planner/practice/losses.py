"""What each step of a hand's playing loses: of F1, of note onsets, and what is not yet lost."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.hand_goals import HandGoals, first_steps, last_in_time, may_begin
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.fingertip_correction import FURTHEST
from cadenza.agents.planner.search.horizon_cost import NO_HARM
from cadenza.tasks import reward

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ONSETS = 0.5  # what all note onsets together are worth, where F1 is worth 1
_LONG_AGO = 1_000_000  # steps
_DEPTH = 0.06  # of a key's travel that lacks to the stop, or is too much, squared
_ASTRAY = 0.02  # of what fingertips astray cost in the search


class KeyHistory(NamedTuple):
    """Keys after a step, (K,)."""

    sounding: Mask
    since: NDArray[np.intp]
    """Steps since each began to sound, the last time."""

    @classmethod
    def of_steps(cls, sounding: Mask) -> KeyHistory:
        """After the last of some steps (S, K), if no key sounded before them."""
        heard = cls(np.zeros(sounding.shape[1], bool), np.full(sounding.shape[1], _LONG_AGO))
        for keys in sounding:
            heard = heard.then(keys)
        return heard

    def then(self, sounding: Mask) -> KeyHistory:
        """After one more step, with the keys that sound then (K,)."""
        begins = sounding & ~self.sounding
        return KeyHistory(sounding, np.where(begins, 0, self.since + 1))

    def of(self, keys: slice) -> KeyHistory:
        """Some of them."""
        return KeyHistory(self.sounding[keys], self.since[keys])


class Losses:
    """Judges what a hand does after each step of a song.

    A step loses 1 - F1 as if the other hand played all its keys. A note loses more if its key does
    not begin to sound on its first step or soon enough after it, as `cadenza.music.metrics` counts
    onsets, and half as much is lost if one begins to sound at any other time.
    """

    def __init__(self, plan: SongPlan, part: HandGoals) -> None:
        """Args:
        plan: of the whole song.
        part: of the hand.
        """
        keys, dt = plan.goals.keys, plan.track.config.control_timestep
        self._part, self._keyboard = part, plan.scene.keyboard
        self._keys, self._wanted = keys, keys.sum(axis=1)
        self._in_time, self._welcome = last_in_time(part.mine, dt), may_begin(keys, dt)
        self._onset = ONSETS * len(keys) / max(int(first_steps(keys).sum()), 1)

    def after(
        self,
        row: int,
        key_qpos: Array,
        fingertips: Array,
        heard: KeyHistory,
        keys: slice = slice(None),
        near: Mask | bool = True,
    ) -> tuple[float, float, KeyHistory]:
        """What is lost by the state after step `row`.

        Args:
            row: of the song.
            key_qpos: (K,) [rad].
            fingertips: (F, 3) of the hand [m].
            heard: after the step before.
            keys: which they are; all by default.
            near: (K,) those of which it is to blame for what sounds and should not.

        Returns:
            The loss; the cost, which is the loss and a little for what is nearly lost; what is
            heard now.
        """
        part, keyboard, wanted = self._part, self._keyboard, self._keys[row, keys]
        mine, travel = part.mine[row, keys], keyboard.travel[keys]
        unwanted = ~wanted & near
        sounding = reward.key_activation(key_qpos, keyboard.sounds_from[keys])
        now, in_time = heard.then(sounding), self._in_time[row, keys]
        begins = now.since == 0
        missing = np.count_nonzero(mine & ~sounding)
        wrong = np.count_nonzero(sounding & unwanted)
        loss = (missing + wrong) / max(2 * self._wanted[row] - missing + wrong, 1)
        late = (in_time >= 0) & (now.since > in_time)
        extra = begins & ~self._welcome[row, keys] & near
        loss += self._onset * (np.count_nonzero(late) + 0.5 * np.count_nonzero(extra))
        depth = reward.key_state(key_qpos, travel)
        lacking = mine * (1.0 - depth)
        too_far = unwanted * np.maximum(depth - NO_HARM, 0.0)
        offset = fingertips - part.fingertips[row + 1]
        astray = np.minimum((offset * offset).sum(axis=1), FURTHEST**2) @ part.weight[row + 1]
        nearly = _DEPTH * (lacking @ lacking + too_far @ too_far) + _ASTRAY * astray
        return float(loss), float(loss + nearly), now
