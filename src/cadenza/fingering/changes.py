"""What it costs a hand to get from what it does at one moment to what it does at the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from cadenza.fingering.chords import NEVER, States, shapes
from cadenza.fingering.strokes import Stroke
from cadenza.hands.reach import Array, Reach

_TIME_TO_MOVE = 0.15  # [s] to lift, move and press
_TIME_TO_CROSS = 0.3  # [s]


@dataclass(frozen=True)
class Costs:
    """Of what a hand does between two moments, about 1 for something worth avoiding once."""

    way: float = 8.0
    """Of moving along the keyboard [1 / m]."""
    speed: float = 3.0
    """Of moving fast [s / m^2]."""
    same_finger: float = 2.0
    """Of a finger that has no time to get from its key to another."""
    crossing: float = 0.5
    """Of a finger that passes over or under another without time for it."""
    other_finger: float = 1.0
    """Of another finger on a key that is struck again."""


def transition(
    was: States, will: States, change: Array | None, seconds: float, costs: Costs
) -> Array:
    """(S', S) what it costs a hand to go from one of S states to one of S' in `seconds`.

    `change` is what `changes_of_fingers` says.
    """
    way = np.abs(will.centre[:, None] - was.centre)
    way[will.playing :] -= will.free
    way[: will.playing, was.playing :] -= will.free
    np.maximum(way, 0.0, out=way)
    cost = way**2
    cost *= costs.speed / seconds
    way *= costs.way
    cost += way
    if change is not None:
        cost += change[will.shape[:, None], was.shape]
    return cost


# What a note is to one of the moment before; higher or lower if it begins when that has ended.
_UNRELATED, _HELD, _STRUCK_AGAIN, _HIGHER, _LOWER = range(5)


def changes_of_fingers(
    earlier: Sequence[Stroke], now: Sequence[Stroke], time: float, reach: Reach, costs: Costs
) -> tuple[Array, Array] | tuple[None, None]:
    """(S', S) of `shapes`: what it costs the right and the left hand to come from other fingers.

    None where it costs nothing.
    """
    keys = {stroke.key for stroke in now}
    begins = [stroke.start >= time for stroke in now]
    gaps = tuple([min(max(time - stroke.end, 0.0), _TIME_TO_CROSS) for stroke in earlier])
    changes = []
    for was, gap in zip(earlier, gaps, strict=True):
        if was.key in keys:
            changes += [
                _UNRELATED if will.key != was.key else _STRUCK_AGAIN if new else _HELD
                for will, new in zip(now, begins, strict=True)
            ]
        elif gap < _TIME_TO_CROSS:
            changes += [
                (_HIGHER if will.key > was.key else _LOWER) if new else _UNRELATED
                for will, new in zip(now, begins, strict=True)
            ]
        else:
            changes += [_UNRELATED] * len(now)
    return _of_changes(tuple(changes), gaps, reach, costs) if any(changes) else (None, None)


@cache
def _tables(num_fingers: int) -> Array:
    """(5, 2, F + 1, F + 1) for each of the above, from one finger or none to another.

    Of the right hand and of the left, whose keys rise towards the thumb.
    """
    up = np.pad(np.tril(np.ones((num_fingers, num_fingers)), -1), (0, 1))  # to one nearer the thumb
    down = up.T
    same = np.pad(np.eye(num_fingers), (0, 1))
    other = 1.0 - np.eye(num_fingers + 1)
    return np.stack([[other, other], [other, other], [same, same], [up, down], [down, up]])


@lru_cache(maxsize=1024)  # figures come again
def _of_changes(
    changes: tuple[int, ...], gaps: tuple[float, ...], reach: Reach, costs: Costs
) -> tuple[Array, Array]:
    """As `changes_of_fingers`.

    Args:
        changes: what each of m notes is to each of m' before, (m' m,).
        gaps: between those before and now (m',) [s].
        reach: of the hands.
        costs: what counts how much.
    """
    change = np.array(changes).reshape(len(gaps), -1)
    gap = np.array(gaps)[:, None]
    cross = costs.crossing * (1 - np.minimum(gap / _TIME_TO_CROSS, 1.0))
    hurry = costs.same_finger * (1 - np.minimum(gap / _TIME_TO_MOVE, 1.0))
    weights = np.stack(
        [
            NEVER * (change == _HELD),
            costs.other_finger * (change == _STRUCK_AGAIN),
            hurry * (change >= _HIGHER),
            cross * (change == _HIGHER),
            cross * (change == _LOWER),
        ],
        axis=-1,
    )
    tables = _tables(reach.num_fingers)
    cost = (weights @ tables.reshape(len(tables), -1)).reshape(*change.shape, *tables.shape[1:])
    cost = cost.transpose(2, 0, 3, 1, 4)
    fingers_before, fingers = (shapes(m, reach).one_hot for m in change.shape)
    shape = fingers_before.shape[1], fingers.shape[1]
    right, left = cost[0].reshape(shape), cost[1, ::-1, :, ::-1].reshape(shape)
    return (
        np.ascontiguousarray((fingers_before @ right @ fingers.T).T),
        np.ascontiguousarray((fingers_before @ left @ fingers.T).T),
    )
