"""Estimates of the true places of a robot's hands, from the keys that they sound and hold."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array
from cadenza.keyboards.keyboard import Keyboard

_PLACES = np.arange(-0.015, 0.0155, 0.001)  # [m] to the right of the place that joints show
_AROUND = 4  # keys to either side of its own that a finger may sound
_WIDTH = 0.004  # [m] from a key at which a finger sounds it with probability 1/2
_SOFT = 0.0015  # [m] scale of the logistic function of this distance
_CHANCE = 0.05  # probability of an onset, or of none, wherever the finger is
_SHARE = 0.3  # weight of the strikes of a play, whose errors are not independent
_PRIOR_HOLDS = 2  # at the nominal height, averaged with the measured heights


class HandPlaces:
    """Offsets of H hands to the right of, and above, the places that their joints show.

    A hand has the same offset in all plays. The likelihood of each is multiplied strike by strike
    (Bayes). As the same strikes have the same errors in each play, all plays count as one.
    """

    def __init__(self, keyboard: Keyboard, hands: int, usual: float) -> None:
        """Begin with a normal distribution whose standard deviation is `usual` [m]."""
        self._keyboard, self._plays = keyboard, 0
        self._prior = -np.square(_PLACES / usual) / 2
        self._log_likely = np.zeros((hands, len(_PLACES)))
        self._heights: list[list[float]] = [[] for _ in range(hands)]

    @property
    def right(self) -> Array:
        """(H,) the means [m]."""
        log_likely = self._prior + _SHARE / max(self._plays, 1) * self._log_likely
        likely = np.exp(log_likely - log_likely.max(axis=1, keepdims=True))
        return np.asarray(likely @ _PLACES / likely.sum(axis=1))

    @property
    def up(self) -> Array:
        """(H,) medians of the heights of holds, shrunk to 0 if they are few [m]."""
        shares = [len(heights) / (len(heights) + _PRIOR_HOLDS) for heights in self._heights]
        medians = [np.median(heights) if heights else 0.0 for heights in self._heights]
        return np.array(shares) * medians

    def begin(self) -> None:
        """Begin the next play."""
        self._plays += 1

    def hold(self, hand: int, lower: float) -> None:
        """Learn from a key that is down while its finger seems `lower` than the plan has it [m]."""
        self._heights[hand].append(lower)

    def strike(self, hand: int, key: int, tip: Array, others: Array, sounding: Array) -> None:
        """Learn from a strike.

        Args:
            hand: the number of the hand.
            key: its key.
            tip: (3,) the place of the fingertip that joints show [m].
            others: keys of other strikes at that time, which are ignored.
            sounding: keys that began to sound at that time.
        """
        centre, half = self._keyboard.centre, self._keyboard.half_size
        first, last = max(key - _AROUND, 0), min(key + _AROUND + 1, self._keyboard.num_keys)
        keys = np.setdiff1d(np.arange(first, last), others)
        across = abs(tip[1] + _PLACES[:, None] - centre[keys, 1]) - half[keys, 1]
        away = np.maximum(across, tip[0] - centre[keys, 0] - half[keys, 0])
        sounds = _CHANCE + (1 - 2 * _CHANCE) / (1 + np.exp((away - _WIDTH) / _SOFT))
        agrees = np.where(np.isin(keys, sounding), sounds, 1 - sounds)
        self._log_likely[hand] += np.log(agrees).sum(axis=1)
