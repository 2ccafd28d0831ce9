"""Costs of the transitions of a hand from one moment at which notes begin to the next."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from cadenza.fingering.states import INFEASIBLE, HandStates, finger_sets
from cadenza.fingering.strokes import Stroke
from cadenza.hands.reach import Array, Reach

_TIME_TO_MOVE = 0.15  # [s] in which a finger lifts, moves and presses
_TIME_TO_CROSS = 0.3  # [s] in which a finger passes over another


@dataclass(frozen=True)
class Costs:
    """Weights of transitions between moments, 1 for something worth avoiding once."""

    distance: float = 8.0  # weight of the distance along the keyboard [1 / m]
    speed: float = 3.0  # weight of its square over time [s / m^2]
    same_finger: float = 2.0  # cost of a finger without time to get from one key to another
    crossing: float = 0.5  # cost of a finger without time to pass over or under another
    other_finger: float = 1.0  # cost of another finger on a repeated key


def transition_costs(
    before: HandStates,
    after: HandStates,
    finger_changes: Array | None,
    seconds: float,
    costs: Costs,
) -> Array:
    """Costs (S', S) of a hand to go from one of S states to one of S' in `seconds`.

    `finger_changes` are those of `finger_change_costs`.
    """
    distance = np.abs(after.centre[:, None] - before.centre)
    # Places of idle hands are a grid: the true place may be nearer.
    distance[after.playing :] -= after.idle_slack
    distance[: after.playing, before.playing :] -= after.idle_slack
    np.maximum(distance, 0.0, out=distance)
    cost = distance**2
    cost *= costs.speed / seconds
    distance *= costs.distance
    cost += distance
    if finger_changes is not None:
        cost += finger_changes[after.finger_set[:, None], before.finger_set]
    return cost


# The relation of a note to one of the moment before: higher or lower if it begins as that ends.
_UNRELATED, _HELD, _STRUCK_AGAIN, _HIGHER, _LOWER = range(5)


def finger_change_costs(
    before: Sequence[Stroke], now: Sequence[Stroke], time: float, reach: Reach, costs: Costs
) -> tuple[Array, Array] | tuple[None, None]:
    """Costs (S', S) between `finger_sets` of each hand, right first; None if there are none."""
    keys = {stroke.key for stroke in now}
    begins = [stroke.start >= time for stroke in now]
    gaps = tuple([min(max(time - stroke.end, 0.0), _TIME_TO_CROSS) for stroke in before])
    relations = []
    for old, gap in zip(before, gaps, strict=True):
        if old.key in keys:
            relations += [
                _UNRELATED if new.key != old.key else _STRUCK_AGAIN if is_onset else _HELD
                for new, is_onset in zip(now, begins, strict=True)
            ]
        elif gap < _TIME_TO_CROSS:
            relations += [
                (_HIGHER if new.key > old.key else _LOWER) if is_onset else _UNRELATED
                for new, is_onset in zip(now, begins, strict=True)
            ]
        else:
            relations += [_UNRELATED] * len(now)
    if not any(relations):
        return None, None
    return _costs_of_relations(tuple(relations), gaps, reach, costs)


@cache
def _penalised_changes(num_fingers: int) -> Array:
    """(5, 2, F + 1, F + 1) 1 for costly changes from a finger, or none, to another.

    They are by relation and by hand: the keys of the left hand rise towards the thumb.
    """
    to_thumb = np.pad(np.tril(np.ones((num_fingers, num_fingers)), -1), (0, 1))
    to_little = to_thumb.T
    same = np.pad(np.eye(num_fingers), (0, 1))
    other = 1.0 - np.eye(num_fingers + 1)
    return np.stack(
        [[other, other], [other, other], [same, same], [to_thumb, to_little], [to_little, to_thumb]]
    )


@lru_cache(maxsize=1024)  # patterns recur
def _costs_of_relations(
    relations: tuple[int, ...], gaps: tuple[float, ...], reach: Reach, costs: Costs
) -> tuple[Array, Array]:
    """The costs of `finger_change_costs`, by relations (m' m,) of m notes to each of m' before.

    `gaps` (m',) are the times from the ends of the notes before to now [s].
    """
    relation = np.array(relations).reshape(len(gaps), -1)
    gap = np.array(gaps)[:, None]
    cross = costs.crossing * (1 - np.minimum(gap / _TIME_TO_CROSS, 1.0))
    hurry = costs.same_finger * (1 - np.minimum(gap / _TIME_TO_MOVE, 1.0))
    weights = np.stack(
        [
            INFEASIBLE * (relation == _HELD),
            costs.other_finger * (relation == _STRUCK_AGAIN),
            hurry * (relation >= _HIGHER),
            cross * (relation == _HIGHER),
            cross * (relation == _LOWER),
        ],
        axis=-1,
    )
    tables = _penalised_changes(reach.num_fingers)
    cost = (weights @ tables.reshape(len(tables), -1)).reshape(*relation.shape, *tables.shape[1:])
    cost = cost.transpose(2, 0, 3, 1, 4)
    fingers_before, fingers = (finger_sets(m, reach).one_hot for m in relation.shape)
    shape = fingers_before.shape[1], fingers.shape[1]
    right, left = cost[0].reshape(shape), cost[1, ::-1, :, ::-1].reshape(shape)
    return (
        np.ascontiguousarray((fingers_before @ right @ fingers.T).T),
        np.ascontiguousarray((fingers_before @ left @ fingers.T).T),
    )
