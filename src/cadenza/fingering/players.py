"""Players: hands and keyboard as the search for fingers sees them.

All places are along the keyboard, to the player's right from its middle [m]. Both hands are
described as right hands: for the left one, the keyboard is mirrored.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cadenza.fingers import SIDES, Finger, Side
from cadenza.hands.forearm import mount_y
from cadenza.hands.reach import Array, Reach

if TYPE_CHECKING:
    from cadenza.keyboards.keyboard import Keyboard

_NUM_IDLE_PLACES = 32  # where a hand without notes may be; more cost time and change little


@dataclass(frozen=True)
class Forearm:
    """A forearm that is mounted at `home` and slides from `low` to `high` [m]."""

    home: float
    low: float
    high: float

    @property
    def mirrored(self) -> Forearm:
        """The forearm of the other hand."""
        return Forearm(-self.home, -self.high, -self.low)

    @property
    def idle_places(self) -> tuple[float, ...]:
        """The places where it can be without notes [m]."""
        if self.low == self.high:
            return (self.home,)
        return tuple(np.linspace(self.low, self.high, _NUM_IDLE_PLACES).tolist())


@dataclass(frozen=True)
class Players:
    """Hands of one kind at a keyboard. Equal players play alike.

    Attributes:
        reach: the reach of the F fingers of either hand.
        keyboard: the keyboard, of K keys.
        forearms: the right hand's and the left hand's; None for a missing hand.
    """

    reach: Reach
    keyboard: Keyboard
    forearms: tuple[Forearm | None, Forearm | None]

    @property
    def description(self) -> str:
        """The hands in words, such as "both hands"."""
        sides = [side for side, arm in zip(SIDES, self.forearms, strict=True) if arm]
        if not sides:
            return "no hands"
        return "both hands" if len(sides) == 2 else f"the {sides[0]} hand"

    @property
    def max_notes(self) -> int:
        """The maximum number of notes at once."""
        return self.reach.num_fingers * sum(forearm is not None for forearm in self.forearms)

    @property
    def fingers(self) -> tuple[Finger, ...]:
        """(2 F,) fingers of two such hands, from left to right."""
        indices = range(self.reach.num_fingers)
        left, right = ([Finger(hand, index) for index in indices] for hand in (1, 0))
        return (*reversed(left), *right)

    def forearm(self, hand: int) -> Forearm | None:
        """The forearm of the right hand, 0, or of the left, 1; None for a missing hand."""
        forearm = self.forearms[hand]
        return forearm.mirrored if forearm and hand else forearm

    def key_y(self, hand: int) -> Array:
        """Places (K,) of the keys [m]."""
        return (1.0, -1.0)[hand] * self.keyboard.grid_y

    def outermost(self, hand: int) -> Array:
        """Rightmost places (K, F) of the forearm while a finger presses a key [m]."""
        forearm = self.forearm(hand)
        assert forearm
        return np.minimum(self.key_y(hand)[:, None] + self.reach.outward, forearm.high)

    def reaches(self, hand: int) -> NDArray[np.bool_]:
        """Whether a finger reaches a key (K, F), beside the other forearm if there is one."""
        forearm, other = self.forearm(hand), self.forearm(1 - hand)
        y = self.key_y(hand)[:, None]
        if forearm is None:
            return np.zeros((len(y), self.reach.num_fingers), bool)
        within = (y - self.reach.inward <= forearm.high) & (y + self.reach.outward >= forearm.low)
        if other is not None:
            within &= ~self.forearms_touch(self.outermost(hand), other.high)
        return np.asarray(within)

    def spans(self) -> NDArray[np.bool_]:
        """Whether two fingers of a hand reach two keys at once (K, K, F, F).

        The first key is nearer the thumb, and so is the first finger.
        """
        y = self.key_y(0)
        distance = (y - y[:, None])[..., None, None]
        return is_within(distance, self.reach.least, self.reach.most)

    def forearms_touch(self, right: Array | float, left: Array | float) -> NDArray[np.bool_]:
        """Whether forearms at most at the places `right` and `left`, mirrored, touch [m].

        Forearms that are mounted closer than their width may be as close as their mounts.
        """
        room = sum(arm.high for arm in map(self.forearm, range(2)) if arm)
        return np.asarray(np.add(right, left) < min(self.reach.forearm_width, room))


def ways_to_hold(
    keys: Sequence[int], reaches: NDArray[np.bool_], spans: NDArray[np.bool_]
) -> Iterator[tuple[int, ...]]:
    """Yield the sets of fingers of a hand that reach keys together, from the thumb's side on.

    `reaches` (K, F) and `spans` (K, K, F, F) are those of `Players`.
    """
    for fingers in combinations(range(reaches.shape[1]), len(keys)):
        placed = list(zip(keys, fingers, strict=True))
        if all(reaches[pair] for pair in placed) and all(
            spans[min(key, other), max(key, other), finger, another]
            for (key, finger), (other, another) in combinations(placed, 2)
        ):
            yield fingers


def is_within(distance: Array, least: Array, most: Array) -> NDArray[np.bool_]:
    """Whether two fingers can press keys at a `distance` from each other [m]."""
    return (distance >= least) & (distance <= most)


def players_at(
    reach: Reach,
    keyboard: Keyboard,
    sides: Collection[Side],
    hand_spacing: float,
    slides: bool,
    arm: Forearm | None = None,
) -> Players:
    """Hands with this reach at a keyboard, on these sides.

    Their forearms are mounted `hand_spacing` [m] apart, and slide along the whole keyboard if
    `slides`; `arm` is the range of a right hand on an arm instead.
    """
    end = keyboard.half_length  # as in the scene, see `cadenza.hands.forearm.joint_range`

    def forearm(side: Side) -> Forearm | None:
        if side not in sides:
            return None
        if arm is not None:
            return arm if side == "right" else arm.mirrored
        home = mount_y(side, hand_spacing)
        return Forearm(home, -end, end) if slides else Forearm(home, home, home)

    right, left = map(forearm, SIDES)
    return Players(reach, keyboard, (right, left))
