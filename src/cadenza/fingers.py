"""How fingers are numbered: 0..4 right hand, thumb to little finger, 5..9 left hand, -1 none.

Arrays over fingers have a place for each of these numbers, whichever hands there are; a hand with
fewer fingers leaves its last places empty.
"""

from __future__ import annotations

from typing import Any, Literal

Side = Literal["right", "left"]
SIDES: tuple[Side, ...] = ("right", "left")
"""In the order of fingers, joints and actions."""

PER_HAND = 5
NUM_FINGERS = len(SIDES) * PER_HAND
UNKNOWN_FINGER = -1
_NAMES = ("thumb", "index", "middle", "ring", "little")


def finger_number(hand: int, place: int) -> int:
    """Of the finger at a `place`, 0 for the thumb, of the right (0) or left (1) hand."""
    return PER_HAND * hand + place


def hand_of(finger: Any) -> Any:
    """0 right, 1 left; of a number or an array of numbers."""
    return finger // PER_HAND


def place_of(finger: Any) -> Any:
    """On its hand, 0 for the thumb; of a number or an array of numbers."""
    return finger % PER_HAND


def side_of(finger: int) -> Side:
    """Of the hand that has this finger."""
    return SIDES[hand_of(finger)]


def finger_name(finger: int) -> str:
    """Such as "right thumb"."""
    return f"{side_of(finger)} {_NAMES[place_of(finger)]}"
