"""Where the hands of a robot strike, by which keys they sound, and where they hold them."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array
from cadenza.keyboards.keyboard import Keyboard

_PLACES = np.arange(-0.015, 0.0155, 0.001)  # [m] to the right of where joints say that a hand is
_AROUND = 4  # keys to either side of its own that a finger may sound
_WIDTH = 0.004  # [m] from a key at which a finger sounds it in half of all cases
_SOFT = 0.0015  # [m] within which that is uncertain
_CHANCE = 0.05  # of a key to sound, or not, wherever the finger is
_SHARE = 0.3  # of what strikes of a play say, as all fingers of a hand are off alike
_UNSURE = 2  # presses at the nominal height that the measured heights are averaged with


class HandPlaces:
    """How far to the right of, and above, where they seem to be H hands are, by all that was heard.

    A hand has one place in all plays. How likely each is, is multiplied strike by strike (Bayes).
    The same strikes err in the same way in each play, so plays count as one.
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
        """(H,) the medians of what holds have told, nearer to 0 if they are few [m]."""
        few = [len(each) / (len(each) + _UNSURE) for each in self._heights]
        return np.array(few) * [np.median(each) if each else 0.0 for each in self._heights]

    def begin(self) -> None:
        """Begin with the next play."""
        self._plays += 1

    def hold(self, hand: int, lower: float) -> None:
        """Learn from a key that sounds, so is down, while its finger seems so much `lower` [m]."""
        self._heights[hand].append(lower)

    def strike(self, hand: int, key: int, tip: Array, others: Array, heard: Array) -> None:
        """Learn from a strike.

        Args:
            hand: the number of the hand.
            key: which it was to sound.
            tip: (3,) where the fingertip seems to have been [m].
            others: keys that others were to sound then, and of which it says nothing.
            heard: keys that have begun to sound then.
        """
        centre, half = self._keyboard.centre, self._keyboard.half_size
        first, last = max(key - _AROUND, 0), min(key + _AROUND + 1, self._keyboard.num_keys)
        keys = np.setdiff1d(np.arange(first, last), others)
        across = abs(tip[1] + _PLACES[:, None] - centre[keys, 1]) - half[keys, 1]
        away = np.maximum(across, tip[0] - centre[keys, 0] - half[keys, 0])
        sounds = _CHANCE + (1 - 2 * _CHANCE) / (1 + np.exp((away - _WIDTH) / _SOFT))
        agrees = np.where(np.isin(keys, heard), sounds, 1 - sounds)
        self._log_likely[hand] += np.log(agrees).sum(axis=1)
