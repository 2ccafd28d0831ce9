"""Who plays on what: hands and keys as the choice of fingers sees them.

All places are along the keyboard, 0 in its middle [m]. What is said of one hand is said as if it
were the right one, to the player's right: of the left one the keyboard is seen mirrored.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cadenza.fingers import SIDES, Finger, Side
from cadenza.hands.reach import Array, Reach

if TYPE_CHECKING:
    from cadenza.keyboards.keyboard import Keyboard

_NUM_STANDS = 32  # places where a hand without notes may be


@dataclass(frozen=True)
class Forearm:
    """Where a forearm is mounted, and from where to where it can slide."""

    home: float
    low: float
    high: float

    @property
    def mirrored(self) -> Forearm:
        return Forearm(-self.home, -self.high, -self.low)

    @property
    def stands(self) -> tuple[float, ...]:
        """Where it can be without notes."""
        if self.low == self.high:
            return (self.home,)
        return tuple(np.linspace(self.low, self.high, _NUM_STANDS).tolist())


@dataclass(frozen=True)
class Players:
    """Hands of one kind at a keyboard. Those that are equal play alike.

    Attributes:
        reach: of the F fingers of either hand.
        keyboard: of K keys.
        forearms: the right hand's and the left hand's; None where there is no hand.
    """

    reach: Reach
    keyboard: Keyboard
    forearms: tuple[Forearm | None, Forearm | None]

    @property
    def whose(self) -> str:
        """Such as "both hands"."""
        sides = [side for side, arm in zip(SIDES, self.forearms, strict=True) if arm]
        return "both hands" if len(sides) == 2 else f"the {sides[0]} hand"

    @property
    def most(self) -> int:
        """Notes at once."""
        return self.reach.num_fingers * sum(forearm is not None for forearm in self.forearms)

    @property
    def fingers(self) -> tuple[Finger, ...]:
        """(2 F,) those of two such hands, from left to right."""
        indices = range(self.reach.num_fingers)
        left, right = ([Finger(hand, index) for index in indices] for hand in (1, 0))
        return (*reversed(left), *right)

    def forearm(self, hand: int) -> Forearm | None:
        """Of the right hand, 0, or of the left, 1."""
        forearm = self.forearms[hand]
        return forearm.mirrored if forearm and hand else forearm

    def key_y(self, hand: int) -> Array:
        """(K,) where the keys are."""
        return (1.0, -1.0)[hand] * self.keyboard.grid_y

    def outmost(self, hand: int) -> Array:
        """(K, F) how far to the right the forearm can be while a finger presses a key."""
        forearm = self.forearm(hand)
        assert forearm
        return np.minimum(self.key_y(hand)[:, None] + self.reach.outward, forearm.high)

    def reaches(self, hand: int) -> NDArray[np.bool_]:
        """(K, F) which finger reaches which key, beside the other forearm if there is one."""
        forearm, other = self.forearm(hand), self.forearm(1 - hand)
        y = self.key_y(hand)[:, None]
        if forearm is None:
            return np.zeros((len(y), self.reach.num_fingers), bool)
        within = (y - self.reach.inward <= forearm.high) & (y + self.reach.outward >= forearm.low)
        if other is not None:
            within &= ~self.forearms_touch(self.outmost(hand), other.high)
        return np.asarray(within)

    def spans(self) -> NDArray[np.bool_]:
        """(K, K, F, F) which two fingers of a hand reach which two keys at once.

        The first key is nearer the thumb, and so is the first finger.
        """
        y = self.key_y(0)
        distance = (y - y[:, None])[..., None, None]
        return is_within(distance, self.reach.least, self.reach.most)

    def forearms_touch(self, right: Array | float, left: Array | float) -> NDArray[np.bool_]:
        """Whether the forearms touch if they are as far apart as they can be.

        If they are mounted too close to each other, that is how it has to be.

        Args:
            right: where the right one is then.
            left: the left one, as if it were the right one.
        """
        room = sum(arm.high for arm in map(self.forearm, range(2)) if arm)
        return np.asarray(np.add(right, left) < min(self.reach.forearm_width, room))


def is_within(distance: Array, least: Array, most: Array) -> NDArray[np.bool_]:
    """Whether two fingers of a hand can press keys at this `distance` [m] of each other."""
    return (distance >= least) & (distance <= most)


def seated(
    reach: Reach,
    keyboard: Keyboard,
    sides: Collection[Side],
    hand_spacing: float,
    slides: bool,
    arm: Forearm | None = None,
) -> Players:
    """Hands on these `sides` of a keyboard.

    Args:
        reach: of either hand.
        keyboard: that is played.
        sides: of the hands that are there.
        hand_spacing: between the mounts of their forearms [m].
        slides: whether the forearms slide along the whole keyboard.
        arm: where the right hand is brought by an arm, instead of a forearm that slides.
    """
    end = keyboard.half_length  # as in the scene, see `cadenza.hands.forearm.joint_range`

    def forearm(side: Side) -> Forearm | None:
        if side not in sides:
            return None
        if arm is not None:
            return arm if side == "right" else arm.mirrored
        home = (1 if side == "right" else -1) * hand_spacing / 2
        return Forearm(home, -end, end) if slides else Forearm(home, home, home)

    right, left = map(forearm, SIDES)
    return Players(reach, keyboard, (right, left))
