"""Fingers of hands, their places in arrays, and their numbers in files.

Scores have `Finger`s. Arrays have a place for each finger of both hands of a scene's kind, the
right hand's first and from the thumb on, whichever hands there are; `Fingers` numbers the places.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

from cadenza.errors import CadenzaError, quoted

Side = Literal["right", "left"]
SIDES: tuple[Side, ...] = ("right", "left")  # sides in the order of fingers, joints and actions
RIGHT, LEFT = range(len(SIDES))  # the numbers of the hands, as `Finger.hand` has them

NO_FINGER = -1  # the number in arrays for no finger, or an unknown one
_NAMES = ("thumb", "index", "middle", "ring", "little")


@dataclass(frozen=True, slots=True)
class Finger:
    """The finger `index`, 0 for the thumb, of the right `hand`, 0, or the left, 1.

    Raises CadenzaError if there is no such hand, or `index` is negative.
    """

    hand: int
    index: int

    def __post_init__(self) -> None:
        if self.hand not in range(len(SIDES)) or not self.index >= 0:
            raise CadenzaError(
                f"finger {self.index} of hand {self.hand}: give hand 0 (right) or 1 (left), and an "
                "index from 0 (thumb) on"
            )

    @property
    def mirrored(self) -> Finger:
        """The corresponding finger of the other hand."""
        return Finger(1 - self.hand, self.index)

    @property
    def side(self) -> Side:
        """The side of its hand."""
        return SIDES[self.hand]

    @property
    def name(self) -> str:
        """The name of the finger, such as "right thumb"."""
        known = self.index < len(_NAMES)
        return f"{self.side} {_NAMES[self.index] if known else f'finger {self.index + 1}'}"


@dataclass(frozen=True, slots=True)
class Fingers:
    """The numbers of fingers in arrays, for hands of `per_hand` fingers."""

    per_hand: int

    @property
    def count(self) -> int:
        """The number of fingers of both hands."""
        return len(SIDES) * self.per_hand

    def number(self, finger: Finger | None) -> int:
        """The number of `finger`; `NO_FINGER` for none, and for one that such hands do not have."""
        if finger is None or finger.index >= self.per_hand:
            return NO_FINGER
        return finger.hand * self.per_hand + finger.index

    def finger(self, number: int) -> Finger | None:
        """The finger with this number; None for `NO_FINGER`."""
        return None if number < 0 else Finger(*divmod(number, self.per_hand))

    def of_hand(self, hand: int) -> slice:
        """The numbers of the fingers of the right hand, 0, or the left, 1."""
        return slice(hand * self.per_hand, (hand + 1) * self.per_hand)

    def hand_of(self, number: Any) -> Any:
        """The hand, 0 right or 1 left, of a number or an array of numbers without `NO_FINGER`."""
        return number // self.per_hand


_IN_FILES = Fingers(per_hand=5)
_LETTERS = "".join(side[0].upper() for side in SIDES)
_COUNTED = re.compile(rf"([{_LETTERS}])([1-9][0-9]?)")


def finger_number(finger: Finger | None) -> int | str:
    """The number of a finger in files.

    0..4 are the right hand's thumb to little finger, 5..9 the left hand's, and -1 none or an
    unknown one. Of hands with more fingers, R6 is the sixth of the right, L7 the seventh of the
    left.
    """
    if finger is not None and finger.index >= _IN_FILES.per_hand:
        return f"{_LETTERS[finger.hand]}{finger.index + 1}"
    return _IN_FILES.number(finger)


def finger_from(text: int | str) -> Finger | None:
    """The finger with this number in files, None for unknown; raises CadenzaError for no finger."""
    text = str(text)
    if re.fullmatch(f"{NO_FINGER}|[0-9]", text):
        return _IN_FILES.finger(int(text))
    if counted := _COUNTED.fullmatch(text):
        return Finger(_LETTERS.index(counted[1]), int(counted[2]) - 1)
    raise CadenzaError(
        f"there is no finger {quoted(text)}; right hand 0-4, left hand 5-9, -1 unknown; beyond the "
        "fifth finger of a hand R6, L6 and so on"
    )
