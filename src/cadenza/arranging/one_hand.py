"""What one hand can do: the keys that it can hold at once, and the time that it takes to move."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from cadenza.fingering.players import Players, ways_to_hold
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
        self._spans = players.spans()
        eased = replace(players.reach, most=_EASY * players.reach.most)
        self._spans_of_chord = replace(players, reach=eased).spans()
        self._outwards = 1 if hand == RIGHT else -1
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
        if not all(map(self.reaches, pitches)):
            return False
        return any(True for _ in ways_to_hold(keys[:: self._outwards], self._reaches, spans))

    def _middle(self, pitches: tuple[int, ...]) -> float:
        """The middle of keys along the keyboard [m]."""
        return float(self._y[pitches[0] - self._lowest] + self._y[pitches[-1] - self._lowest]) / 2

    def _jump_time(self, left: tuple[int, ...], struck: tuple[int, ...], holding: bool) -> float:
        """The time from leaving keys to striking others [s]."""
        distance = abs(self.middle(left) - self.middle(struck))
        return float(self._times.seconds(distance, len(left), len(struck), holding))
