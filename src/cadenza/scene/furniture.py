"""The case of a piano around the keys: drawn shapes, without mass or contacts.

World frame: x towards the player, y to the player's right, z up.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cadenza.hands.shell import TRIM, Material
from cadenza.keyboards.keyboard import Keyboard

LACQUER = Material((0.045, 0.043, 0.048, 1.0), 0.24)  # polished black: the case, and the black keys
IVORY = Material((0.95, 0.935, 0.90, 1.0), 0.25)  # white keys, a little warm
FELT = Material((0.50, 0.05, 0.075, 1.0), 1.0)  # the red strip behind the keys
FLOOR = Material((0.74, 0.755, 0.78, 1.0), 1.0)

SLOPE = 0.5  # how far the fall board rises towards the back [rad]
BOARD_LENGTH = 0.21  # the fall board has this length from its lower edge to its upper one [m]
_BOARD_BEHIND, _BOARD_OVER = 0.012, 0.016  # [m] its lower edge lies, from the keys
_BOARD_BELOW = 0.005  # [m] its face lies below the notes that fall on it
_BOARD_HALF = 0.004  # [m] half of its thickness

# Of a piano [m]; a keyboard with shorter keys has a case that is smaller by as much.
_KEY_LENGTH = 0.15
_UNDER_BOARD = 0.014  # from the fall board down to its support
_CHEEK, _ARM = 0.013, 0.011  # half widths
_SLIT = 0.002  # between moving keys and the case
_BED = 0.011  # half of the key bed's height
_SLIP = 0.006  # half of the key slip's depth
_SLIP_BELOW = 0.0025  # its upper edge, under the tops of white keys that are down
_FELT_HALF = (0.003, 0.0024)  # its depth and height
_NAME_BOARD_OVER = 0.008  # its upper edge, over the black keys

Ends = tuple[float, float]
"""Something begins at the first and ends at the second position along an axis [m]."""


@dataclass(frozen=True)
class CasePiece:
    """A box of the case."""

    half_size: tuple[float, float, float]
    pos: tuple[float, float, float]
    material: Material = LACQUER
    slope: float = 0.0  # how far it rises towards the back [rad]

    @property
    def quat(self) -> tuple[float, float, float, float]:
        """Its orientation (w, x, y, z)."""
        return float(np.cos(self.slope / 2)), 0.0, float(np.sin(self.slope / 2)), 0.0


def board_origin(keyboard: Keyboard) -> tuple[float, float]:
    """Where notes that slide down the fall board leave it: x and z [m]."""
    low, high = keyboard.bounds
    return float(low[0]) - _BOARD_BEHIND, float(high[2]) + _BOARD_OVER


def board_half_width(keyboard: Keyboard) -> float:
    """Half of the width of the fall board [m]."""
    return keyboard.half_length + _SLIT + 2 * _CHEEK * _scale(keyboard)


def floor_height(keyboard: Keyboard) -> float:
    """The height of the floor [m]."""
    return float(keyboard.bounds[0][2]) - 2 * _BED - 2 * _SLIT


def furniture(keyboard: Keyboard) -> tuple[CasePiece, ...]:
    """The case around the keys of a keyboard."""
    scale, (low, high) = _scale(keyboard), keyboard.bounds
    rear, front, bottom = float(low[0]), float(high[0]), float(low[2])
    white, black = keyboard.white.top, keyboard.black.top
    cheek, arm = _CHEEK * scale, _ARM * scale
    back, top = _end_of_board(keyboard)
    inside = keyboard.half_length + _SLIT
    board = board_half_width(keyboard)
    under = floor_height(keyboard) + _SLIT
    behind = rear - 2 * _FELT_HALF[0]
    slip = front + _SLIT + 2 * _SLIP

    felt, name_board = white + 2 * _FELT_HALF[1], black + _NAME_BOARD_OVER
    middle = (back + behind) / 2
    width = (-board, board)
    return (
        # The key bed and the key slip
        _box((back, slip), width, (under, bottom - _SLIT / 2)),
        _box(
            (front + _SLIT, slip), width, (bottom - _SLIT, white - keyboard.white.dip - _SLIP_BELOW)
        ),
        _box((behind, rear + _SLIT), (-inside, inside), (white - _FELT_HALF[1], felt), FELT),
        # The board behind the keys, with a strip of bronze on its edge
        _box((back, behind), width, (bottom - _SLIT, name_board)),
        _box((back, middle), width, (name_board, (name_board + top) / 2 - _UNDER_BOARD)),
        _box((behind - 0.003, behind - 0.0012), width, (name_board, name_board + 8e-4), TRIM),
        *_both(cheek, inside + cheek, (rear, slip), (bottom - _SLIT, white + 0.004)),
        *_both(arm, board + arm, (back, slip + 0.004), (under, black + 0.006)),
        *_fall_board(keyboard),
    )


def case_bounds(keyboard: Keyboard) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The lowest and the highest corner (3,) of a box around the case [m]."""
    pieces = furniture(keyboard)
    half, middle = (np.array([getattr(p, name) for p in pieces]) for name in ("half_size", "pos"))
    cos, sin = (np.abs(turn([piece.slope for piece in pieces])) for turn in (np.cos, np.sin))
    half[:, 0], half[:, 2] = (
        cos * half[:, 0] + sin * half[:, 2], sin * half[:, 0] + cos * half[:, 2]
    )  # fmt: skip
    return (middle - half).min(0), (middle + half).max(0)


def _box(x: Ends, y: Ends, z: Ends, material: Material = LACQUER) -> CasePiece:
    ends = np.array([x, y, z])
    half, middle = (ends[:, 1] - ends[:, 0]) / 2, ends.mean(axis=1)
    return CasePiece(tuple(half.tolist()), tuple(middle.tolist()), material)


def _both(half: float, middle: float, x: Ends, z: Ends) -> Iterator[CasePiece]:
    """A box at either end of the keyboard, at y = -`middle` and `middle`."""
    return (_box(x, (end * middle - half, end * middle + half), z) for end in (-1, 1))


def _end_of_board(keyboard: Keyboard) -> tuple[float, float]:
    """Where the fall board ends at the back: x and z [m]."""
    x, z = board_origin(keyboard)
    return x - BOARD_LENGTH * float(np.cos(SLOPE)), z + BOARD_LENGTH * float(np.sin(SLOPE))


def _fall_board(keyboard: Keyboard) -> tuple[CasePiece, ...]:
    """The sloping board, and a rail at either end of it."""
    x, z = board_origin(keyboard)
    back, up = np.array([-np.cos(SLOPE), np.sin(SLOPE)]), np.array([np.sin(SLOPE), np.cos(SLOPE)])
    width, rail = board_half_width(keyboard), _ARM * _scale(keyboard)
    half = BOARD_LENGTH / 2
    middle = np.array([x, z]) + (half - 0.008) * back - (_BOARD_BELOW + _BOARD_HALF) * up
    mx, mz = middle.tolist()
    rails = (
        CasePiece((half, rail, 2 * _BOARD_HALF), (mx, side * (width + rail), mz), slope=SLOPE)
        for side in (-1, 1)
    )
    return (CasePiece((half, width, _BOARD_HALF), (mx, 0.0, mz), slope=SLOPE), *rails)


def _scale(keyboard: Keyboard) -> float:
    return 2 * keyboard.white.half_size[0] / _KEY_LENGTH
