"""Collisions of fingers: where and how far their links, which are capsules, overlap."""

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Ids
from cadenza.hands.hand import Hand
from cadenza.scene.servos import clip

_CLEARANCE = 0.0015  # [m] between links
_MIN_LENGTH_SQUARED = 1e-12  # [m^2] of a link, so that nothing is divided by 0
_MIN_DISTANCE = 1e-9  # [m], likewise


class Overlaps(NamedTuple):
    """M overlaps of two links, a first and a second, which are nearer than allowed."""

    row: Ids  # (M,) the posture, of N
    pair: Ids  # (M,) the pair of links
    depth: Array  # (M,) their distances less those allowed, which are negative [m]
    finger: Ids  # (2, M) the fingers of the links
    link: Ids  # (2, M) the number of each link on its finger
    at: Array  # (2, M, 3) the points of both that are nearest to each other [m]
    away: Array  # (2, M, 3) the directions away from each other

    @property
    def columns(self) -> tuple[int, Ids]:
        """Number of different pairs, and for each overlap its pair among these (M,)."""
        met = np.bincount(self.pair) > 0
        return int(np.count_nonzero(met)), (met.cumsum() - 1)[self.pair]


class LinkPairs:
    """C pairs of links, each of a finger and its number on it.

    Attributes:
        min_distance: (C,) the distances that the axes of the pairs keep from each other [m].
    """

    def __init__(self, pairs: list[tuple[tuple[int, int], tuple[int, int]]], radii: Array) -> None:
        """Take pairs of (finger, link), and the radii (F, links) of all links [m]."""
        table = np.array(pairs, np.intp).reshape(-1, 2, 2)  # (C, 2, 2)
        self._finger, self._link = table[:, :, 0].T, table[:, :, 1].T  # (2, C)
        begin = self._finger * (radii.shape[1] + 1) + self._link  # as points of all in a row
        self._ends = np.stack([begin, begin + 1])  # (2, 2, C)
        distance = radii[self._finger, self._link].sum(axis=0) + _CLEARANCE
        self.min_distance = distance.astype(np.float32)  # of any precision

    def overlaps(self, points: Array) -> Overlaps:
        """Overlaps in N postures of fingers with points (N, F, P, 3) [m], see `Kinematics`."""
        count, fingers, num_points, _ = points.shape
        all_points = points.reshape(count, fingers * num_points, 3)
        begin, end = np.moveaxis(all_points.take(self._ends, axis=1), 0, 2)  # (2, N, C, 3)
        along = end - begin
        share = _closest(begin[0] - begin[1], *along)
        at = begin + share[..., None] * along
        gap = at[0] - at[1]
        distance = np.sqrt(np.vecdot(gap, gap)) + _MIN_DISTANCE
        depth = distance - self.min_distance
        row, pair = np.nonzero(depth < 0.0)
        away = gap[row, pair] / distance[row, pair, None]
        links = self._finger[:, pair], self._link[:, pair]
        where = at[:, row, pair], np.stack([away, -away])
        return Overlaps(row, pair, depth[row, pair], *links, *where)


class LinkCollisions:
    """Pairs of links that could meet, within one hand or between two alike.

    They are those of neighbouring fingers, of the thumb and the fingers that it meets, and of
    thumbs and forefingers of both hands. First links of neighbours are mounted far enough apart.

    Attributes:
        within_hand: the pairs of one hand; fingers are counted from its thumb.
        between_hands: the pairs of the right hand and the left, whose fingers are counted on.
    """

    def __init__(self, hand: Hand) -> None:
        count, links = len(hand.fingers), range(len(hand.fingers[0].links))
        finger_pairs = [
            *pairwise(range(1, count)),
            *((0, other) for other in range(1, min(count, 1 + hand.thumb_meets))),
        ]
        within = [
            ((a, i), (b, j))
            for a, b in finger_pairs
            for i in links
            for j in links
            if (i or j if a else i)
        ]
        inner = range(min(count, 2))
        between = [
            ((a, i), (count + b, j))
            for a in inner
            for b in inner
            for i in links[1:]
            for j in links[1:]
        ]
        radii = np.array([finger.radii for finger in hand.fingers])  # (F, links)
        self.within_hand = LinkPairs(within, radii)
        self.between_hands = LinkPairs(between, np.tile(radii, (2, 1)))
        self._inner, self._max_distance = len(inner), 2 * radii[inner].max() + _CLEARANCE

    def hands_near(self, points: Array) -> NDArray[np.bool_]:
        """Postures (N,) in which links of both hands could overlap, by points (N, H, F, P, 3)."""
        if points.shape[1] == 1:
            return np.zeros(len(points), bool)
        along = points[:, :, : self._inner, :, 1]
        low, high = along.min(axis=(2, 3)), along.max(axis=(2, 3))
        near: NDArray[np.bool_] = (low - high[:, ::-1]).max(axis=1) < self._max_distance
        return near


link_collisions = lru_cache(maxsize=8)(LinkCollisions)  # for short plans


def _closest(between: Array, along_a: Array, along_b: Array) -> Array:
    """Nearest points (2, ...) of two segments, as shares of their lengths.

    `along_a` and `along_b` (..., 3) lead from begin to end of each segment, and `between` (..., 3)
    from the begin of b to that of a. Parallel segments may give any of their nearest points.
    Source: Ericson, Real-Time Collision Detection (2005), 5.1.9.
    """
    aa, bb = np.vecdot(along_a, along_a), np.vecdot(along_b, along_b)
    ab = np.vecdot(along_a, along_b)
    da, db = np.vecdot(along_a, between), np.vecdot(along_b, between)
    aa, bb = np.maximum(aa, _MIN_LENGTH_SQUARED), np.maximum(bb, _MIN_LENGTH_SQUARED)
    s = clip((ab * db - da * bb) / np.maximum(aa * bb - ab * ab, _MIN_LENGTH_SQUARED), 0.0, 1.0)
    t = clip((ab * s + db) / bb, 0.0, 1.0)
    return np.stack([clip((ab * t - da) / aa, 0.0, 1.0), t])
