"""Timed strikes within the horizon of a hand: when, and how fast, its keys begin to sound."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.keyboards.keyboard import Keyboard
from cadenza.music.performance import BOUNCE
from cadenza.sim.key_crossings import Crossings, key_crossings

UNIT = np.array([0.008, 0.4])
"""The errors that count as 1: of the time of an onset [s], and of the speed of its key [octaves].

Speed counts by its logarithm, as in hearing."""
WEIGHT = np.array([1.0, 1.5])  # the cost of these errors, squared
TOLERANCE = np.array([0.003, 0.15])  # the errors that are good enough, hardly audible [s, octaves]
_LARGE = 2.0  # error beyond which the cost grows linearly: a wrong onset has another cost, too
_NOT_STRUCK = np.array([8.0, 0.0])  # costs, as of an onset that is a control step of 50 ms late
_AFTER = 3  # steps after a strike in which it may still cause a fault, as its finger may bounce
_MIN_SILENCE = BOUNCE + 0.002  # [s] before an audible repetition, with 2 ms for rounding
_MIN_SPEED = 0.05  # [rad/s] of keys that hardly move, for the logarithm


def strike_costs(outcome: Array, target: Array) -> Array:
    """Costs (N,) of strikes with outcomes (N, 2), by their targets (N, 2).

    Both are times [s] and log2 of angular speeds [rad/s]. NaN is a key that did not begin to sound.
    """
    error = np.abs(outcome - target) / UNIT
    costs = np.where(error < _LARGE, error * error, _LARGE**2 + error - _LARGE)
    return np.where(np.isnan(costs), _NOT_STRUCK, costs) @ WEIGHT


def log_speed(speed: Array) -> Array:
    """log2 of angular speeds of keys [rad/s]."""
    return np.log2(np.maximum(speed, _MIN_SPEED))


class HorizonStrikes:
    """The N strikes of a hand in H steps whose keys the plan holds.

    Attributes:
        step: (N,) the steps of the horizon in which they begin.
        finger: (N,) the fingers of the hand that strike.
        target: (N, 2) the times in their steps [s], and log2 of the angular speeds [rad/s].
        lever: (N,) from the hinges of the keys to where the fingers strike them [m].
        sounds_at: (N,) how deep the keys sound there [m].
    """

    def __init__(
        self,
        goals: HandGoals,
        steps: NDArray[np.intp],
        keyboard: Keyboard,
        keys: slice,
        num_steps: int | None = None,
        silent: Array | None = None,
    ) -> None:
        """Take the strikes of `goals` in consecutive steps (H,), of the K simulated keys.

        If only the first steps count, `num_steps` is their number. `silent` (K,) is the time for
        which keys have been silent before the first step [s], infinite if it does not matter.
        """
        self._silent = silent
        strikes, self._dt = goals.strikes, goals.dt
        rows = np.arange(*np.searchsorted(strikes.step, [steps[0], steps[:num_steps][-1] + 1]))
        rows = rows[goals.planned[strikes.step[rows], strikes.key[rows]]]
        rows = rows[(strikes.key[rows] >= keys.start) & (strikes.key[rows] < keys.stop)]
        self._all_sound_from = keyboard.sounds_from[keys]
        self._held = goals.keys[steps, keys] & goals.planned[steps, keys]
        self._wrong, self._onset_wrong = goals.wrong[steps, keys], goals.onset_wrong[steps, keys]
        step, key = strikes.step[rows], strikes.key[rows]
        self.step, self._key = step - steps[0], key - keys.start
        self.finger = goals.finger[step, key].astype(np.intp)
        self.target = np.column_stack([strikes.time[rows], np.log2(strikes.speed[rows])])
        self._sounds_from = keyboard.sounds_from[key]
        hinge = keyboard.centre[key, 0] - keyboard.half_size[key, 0]
        self.lever = goals.fingertips[step + 1, self.finger, 0] - hinge
        self.sounds_at = np.tan(self._sounds_from) * self.lever
        self._in_step = {int(k): np.flatnonzero(self.step == k) for k in np.unique(self.step)}

    def __len__(self) -> int:
        return len(self.step)

    def cost(self, k: int, key_path: Array) -> float:
        """Cost of the strikes of the k-th step, in which keys move along (S + 1, K) [rad]."""
        if k not in self._in_step:
            return 0.0
        rows, substep = self._in_step[k], self._dt / (len(key_path) - 1)
        outcome = np.full((len(rows), 2), np.nan)
        for i, row in enumerate(rows):
            onsets = _onsets(
                _crossings(key_path[:, self._key[row]], self._sounds_from[row], substep)
            )
            outcome[i] = onsets[0] if len(onsets) else np.nan
        return float(strike_costs(outcome, self.target[rows]).sum())

    def outcome(self, key_paths: Sequence[Array]) -> Array:
        """Times and log2 of the speeds (N, 2) of all strikes, as in `target`.

        Of the onsets from the step before to the step after, the nearest in time counts; without
        any, the values are NaN. If the key was silent for too short a time to be heard again, its
        onset counts as so much too early.
        """
        outcome = np.full((len(self), 2), np.nan)
        for i, (step, key) in enumerate(zip(self.step, self._key, strict=True)):
            begin, end = max(step - 1, 0), min(step + 2, len(key_paths))
            if begin >= end:
                continue
            substep, origin = self._dt / (len(key_paths[begin]) - 1), (step - begin) * self._dt
            parts = [key_paths[begin][:1, key], *(path[1:, key] for path in key_paths[begin:end])]
            crossings = _crossings(np.concatenate(parts), self._sounds_from[i], substep)
            onsets = _onsets(crossings)
            if len(onsets):
                late = onsets[:, 0] - origin - self.target[i, 0]
                time, speed = onsets[np.abs(late).argmin()]
                offsets = crossings.offsets.time
                earlier = offsets[offsets < time].max(initial=self._silent_since(key, begin))
                early = time - earlier - _MIN_SILENCE
                outcome[i] = min(time - origin, self.target[i, 0] + early), speed
        return outcome

    def _silent_since(self, key: int, step: int) -> float:
        """Time of the last offset of a key before the horizon, from the beginning of `step` [s]."""
        silent = np.inf if self._silent is None else self._silent[key]
        return -float(silent) - step * self._dt

    def faults(self, key_paths: Sequence[Array]) -> Array:
        """Numbers (N,) of wrong keys and onsets that each strike may have caused.

        They are those from the step before it to some steps after it. A key is wrong if at the end
        of a step it is silent against the plan, or sounds and should not.
        """
        steps = min(len(key_paths), len(self._held))
        sounding = np.array(key_paths[:steps]) >= self._all_sound_from  # (L, S + 1, K)
        onsets = np.count_nonzero(sounding[:, 1:] > sounding[:, :-1], axis=1)
        wrong = np.where(sounding[:, -1], self._wrong[:steps], self._held[:steps])
        wrong_onsets = np.maximum(onsets - ~self._onset_wrong[:steps], 0)
        total = np.pad(np.cumsum((wrong + wrong_onsets).sum(axis=1)), (1, 0))
        last = np.minimum(self.step + _AFTER + 1, steps)
        return total[last] - total[np.minimum(np.maximum(self.step - 1, 0), last)]


def _crossings(key_path: Array, sounds_from: float, substep: float) -> Crossings:
    """Crossings of a key that moves along (S + 1,) [rad], sampled every `substep` [s]."""
    return key_crossings(key_path[:, None], np.array([sounds_from]), substep)


def _onsets(crossings: Crossings) -> Array:
    """Times [s] and log2 of the speeds [rad/s] (C, 2) with which a key begins to sound."""
    onsets = crossings.onsets
    return np.column_stack([onsets.time, log_speed(onsets.speed)])
