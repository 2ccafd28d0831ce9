"""What one hand can do: the keys that it can hold at once, and the time that it takes to move."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.players import Players
from cadenza.fingers import RIGHT
from cadenza.hands.reach import JumpTimes

_EASY = 0.85  # of the reach that is counted on in chords: at its end, inner fingers press badly
_OCTAVE = 2  # notes, for which all of it is


class OneHand:
    """One hand of the players."""

    def __init__(self, hand: int, players: Players, times: JumpTimes) -> None:
        """Takes which hand it is, the players, and the times that their hands take to jump."""
        keyboard = players.keyboard
        self.is_there = players.forearm(hand) is not None
        self._lowest, self._num_keys = keyboard.lowest_pitch, len(keyboard.grid_y)
        self._y, self._times = keyboard.grid_y, times
        self._reaches = players.reaches(hand)
        # [low][high][finger on the low key][finger on the high key]
        self._spans = _spans(players, hand)
        eased = replace(players.reach, most=_EASY * players.reach.most)
        self._spans_of_chord = _spans(replace(players, reach=eased), hand)
        self._outwards = 1 if hand == RIGHT else -1
        self._num_fingers = players.reach.num_fingers
        self.fits = cache(self._fits)
        self.middle = cache(self._middle)
        self.jump_time = cache(self._jump_time)

    def reaches(self, pitch: int) -> bool:
        """Whether any finger reaches a key."""
        key = pitch - self._lowest
        return 0 <= key < self._num_keys and bool(self._reaches[key].any())

    def _fits(self, pitches: tuple[int, ...]) -> bool:
        """Whether the hand can hold keys at once, by their pitches from the lowest on."""
        keys = [pitch - self._lowest for pitch in pitches]
        spans = self._spans if len(keys) <= _OCTAVE else self._spans_of_chord
        if len(keys) > self._num_fingers or not all(map(self.reaches, pitches)):
            return False
        for fingers in combinations(range(self._num_fingers), len(keys)):
            placed = list(zip(keys, fingers[:: self._outwards], strict=True))
            if all(self._reaches[key, finger] for key, finger in placed) and all(
                spans[low, high, a, b] for (low, a), (high, b) in combinations(placed, 2)
            ):
                return True
        return False

    def _middle(self, pitches: tuple[int, ...]) -> float:
        """The middle of keys along the keyboard [m]."""
        return float(self._y[pitches[0] - self._lowest] + self._y[pitches[-1] - self._lowest]) / 2

    def _jump_time(self, left: tuple[int, ...], struck: tuple[int, ...], holding: bool) -> float:
        """The time from leaving keys to striking others [s]."""
        distance = abs(self.middle(left) - self.middle(struck))
        return float(self._times.seconds(distance, len(left), len(struck), holding))


def _spans(players: Players, hand: int) -> NDArray[np.bool_]:
    """(K, K, F, F) whether two fingers of a hand reach a key and a higher one."""
    spans = players.spans()
    return spans if hand == RIGHT else spans.swapaxes(2, 3)
