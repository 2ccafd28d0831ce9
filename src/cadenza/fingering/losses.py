"""What is lost of notes because a hand lets go of them early, to be elsewhere in time.

The planner cuts presses by the same rules, see `let_go_in_time`. Here they tell what a hand takes
from the notes that it leaves on its way from one moment to the next: in control steps of 0.05 s, as
F1 counts them. A key that is missing beside m - 1 others takes 1 / (2 m - 1) from the F1 of a step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.chords import States
from cadenza.fingering.playable import Moment
from cadenza.fingering.players import Players
from cadenza.hands.reach import Array

_STEP = 0.05  # [s]
_RISE = 0.05  # [s] in which a finger gets off a key
_LEAST = 0.05  # [s] that a press lasts
_ROUNDING = 0.025  # [s] that it takes longer on the average, in whole control steps
_AHEAD = 0.4  # [s] no hand has to let go earlier than this
_LATE = 10.0  # [1 / s] for a hand that comes too late from where it stood


class Losses:
    """What one hand of these players, 0 the right, 1 the left, loses between moments."""

    def __init__(self, players: Players, hand: int) -> None:
        self._order = slice(None, None, -1 if hand else 1)  # from the thumb's side
        self._times = players.jump_times
        self._spans = _spans(players, hand)
        self._none = players.reach.num_fingers

    def between(self, then: Moment, now: Moment, was: States, will: States) -> Array:
        """(S', S) what is lost on the way from one of S states at a moment to one of S' later.

        Args:
            then: the moment.
            now: the next.
            was: the states at the one.
            will: the states at the other.
        """
        together = self._jump(was, will, was.mean, np.maximum(was.struck, 1))
        lost = np.zeros_like(together)
        late = together[:, was.playing :] - (now.time - then.time)
        lost[:, was.playing :] = _LATE * np.maximum(late, 0.0)
        held = {press.key for press in now.presses if press.start < now.time}
        keys = np.array([press.key for press in now.presses], np.intp)[self._order]
        strikes = np.eye(self._none + 1, dtype=bool)[will.strikes]
        strikes[..., self._none] = False
        for n, press in enumerate(then.presses[self._order]):
            gap = now.time - press.end
            if press.key in held or gap >= _AHEAD:
                continue
            finger = was.fingers[:, n]
            spans = self._spans[press.key, keys][np.arange(len(keys)), will.strikes]
            out_of_reach = ~spans.all(axis=1)[:, finger]
            elsewhere = (strikes & (keys != press.key)[:, None]).any(axis=1)[:, finger]
            at_once = press.start >= then.time
            jump = together if at_once else self._jump(was, will, was.place[:, n], 1)
            early = np.maximum(jump * out_of_reach, _RISE * elsewhere)
            most = max(press.end - press.start - _LEAST, 0.0)
            cut = np.clip(early + _ROUNDING - gap, 0.0, most) * (early > 0)
            lost += cut / _STEP / (2 * len(then.presses) - 1)
        return lost

    def _jump(
        self, was: States, will: States, places: Array, left: NDArray[np.intp] | int
    ) -> Array:
        """(S', S) how long before the next moment a hand leaves its `places` (S,) for a jump [s].

        Of the keys there it leaves so many, `left` (S,).
        """
        way = will.way_from(was, places, will.mean)
        way[:, was.playing :] += self._times.within_reach  # it is not there yet
        seconds = self._times.seconds(way, left, will.struck[:, None])
        return seconds * (will.struck > 0)[:, None]


def _spans(players: Players, hand: int) -> NDArray[np.bool_]:
    """(K, K, F + 1, F + 1) whether a key can be held while another is struck, by which fingers.

    The second finger holds; the last of each is none.
    """
    y, finger = players.key_y(hand), np.arange(players.reach.num_fingers)
    distance = (y[:, None] - y)[..., None, None]
    spans = players.reach.spans(finger[:, None], finger, distance)
    return np.pad(spans, ((0, 0), (0, 0), (0, 1), (0, 1)), constant_values=True)
