"""Keeps fingers out of each other: how far their links overlap, and how that changes."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cadenza.hands.hand import Hand
from cadenza.scene.servos import within

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

_CLEARANCE = 0.0015  # [m]


class _Pairs:
    """C pairs of links, each of a finger and its number on it."""

    def __init__(self, pairs: list[tuple[tuple[int, int], tuple[int, int]]], radii: Array) -> None:
        """`radii` are (F, links) [m]."""
        table = np.array(pairs, np.intp).reshape(-1, 2, 2)  # (C, 2, 2)
        self._a, self._b = (table[:, 0, 0], table[:, 0, 1]), (table[:, 1, 0], table[:, 1, 1])
        # (4, C) the ends of the first and the second link, as points of all fingers in a row.
        points = table[..., 0] * (radii.shape[1] + 1) + table[..., 1]
        self._ends = np.stack([points[:, 0], points[:, 0] + 1, points[:, 1], points[:, 1] + 1])
        self._least = np.float32(radii[self._a] + radii[self._b] + _CLEARANCE)  # of any precision

    def overlaps(self, points: Array, jacobian: Array) -> tuple[Array, tuple[Ids, Ids], Array]:
        """How much nearer than allowed links are, as negative lengths, and zero where they are not.

        Args:
            points: (N, F, P, 3) of the fingers [m], see `Kinematics`.
            jacobian: (N, F, P, 3, A).

        Returns:
            (N, C) [m]; the M places in it where that is not zero, (M,) and (M,); and how it changes
            there as the first link of the pair moves, and the second, (M, 2, A).
        """
        in_a_row = points.reshape(len(points), -1, 3)
        a0, a1, b0, b1 = np.moveaxis(in_a_row.take(self._ends, axis=1), 1, 0)
        s, t = _closest(a0, a1, b0, b1)
        gap = a0 + s[..., None] * (a1 - a0) - b0 - t[..., None] * (b1 - b0)
        distance = np.sqrt((gap**2).sum(axis=-1)) + 1e-9
        overlap = np.minimum(distance - self._least, 0.0)
        row, pair = np.nonzero(overlap)
        normal = gap[row, pair] / distance[row, pair, None]

        def moves(finger: Ids, link: Ids, along: Array) -> Array:
            """(M, 3, A) the Jacobian of points part of the way along their links."""
            part = along[row, pair, None, None]
            here, there = (jacobian[row, finger[pair], link[pair] + k] for k in (0, 1))
            return (1 - part) * here + part * there

        approach = np.stack([moves(*self._a, s), -moves(*self._b, t)], axis=1)
        return overlap, (row, pair), np.einsum("mk,mika->mia", normal, approach)


class LinkCollisions:
    """Pairs of links that could meet, of one hand or two alike.

    Neighbouring fingers, the thumb and the fingers that it can meet, and thumbs and forefingers of
    both hands; not the first links of neighbours, which are mounted far enough apart.

    Attributes:
        of_hand: pairs of one hand; fingers are counted from its thumb.
        of_both: pairs of the right hand and the left, whose fingers are counted on.
    """

    def __init__(self, hand: Hand) -> None:
        count, links = len(hand.fingers), range(len(hand.fingers[0].links))
        beside = [
            *pairwise(range(1, count)),
            *((0, other) for other in range(1, 1 + hand.thumb_meets)),
        ]
        of_one = [
            ((a, i), (b, j))
            for a, b in beside
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
        self.of_hand, self.of_both = _Pairs(of_one, radii), _Pairs(between, np.tile(radii, (2, 1)))
        self._inner, self._most = len(inner), 2 * radii[inner].max() + _CLEARANCE

    def hands_near(self, points: Array) -> Ids:
        """In which of N postures pairs of both hands could overlap; points are (N, 2, F, P, 3)."""
        along = points[:, :, : self._inner, :, 1]
        low, high = along.min(axis=(2, 3)), along.max(axis=(2, 3))
        return np.flatnonzero((low - high[:, ::-1]).max(axis=1) < self._most)


link_collisions = lru_cache(maxsize=8)(LinkCollisions)  # plans that are short ask again and again


def _closest(a0: Array, a1: Array, b0: Array, b1: Array) -> tuple[Array, Array]:
    """Where segments are nearest to each other, as fractions (...) of their lengths.

    Ericson, Real-Time Collision Detection (2005), 5.1.9; parallel ones anywhere.
    """
    along_a, along_b, between = a1 - a0, b1 - b0, a0 - b0
    aa, bb = np.vecdot(along_a, along_a), np.vecdot(along_b, along_b)
    ab = np.vecdot(along_a, along_b)
    da, db = np.vecdot(along_a, between), np.vecdot(along_b, between)
    s = within((ab * db - da * bb) / np.maximum(aa * bb - ab * ab, 1e-12), 0.0, 1.0)
    t = within((ab * s + db) / bb, 0.0, 1.0)
    return within((ab * t - da) / aa, 0.0, 1.0), t
