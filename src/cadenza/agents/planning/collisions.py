"""Keeps fingers out of each other: how far their links overlap, and how that changes."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cadenza.fingers import SIDES
from cadenza.hands.hand import Hand

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

_CLEARANCE = 0.0015  # [m]


class LinkCollisions:
    """C pairs of links, of the F fingers of one hand or two alike, that could meet.

    Neighbouring fingers, the thumb and the fingers that it can meet, and thumbs and forefingers of
    both hands; not the first links of neighbours, which are mounted far enough apart.
    """

    def __init__(self, hand: Hand, num_hands: int) -> None:
        count, links = len(hand.fingers), range(len(hand.fingers[0].links))
        beside = [
            *pairwise(range(1, count)),
            *((0, other) for other in range(1, 1 + hand.thumb_meets)),
        ]
        pairs = [
            ((base + a, i), (base + b, j))
            for base in range(0, num_hands * count, count)
            for a, b in beside
            for i in links
            for j in links
            if (i or j if a else i)
        ]
        if num_hands == len(SIDES):
            inner = range(min(count, 2))
            pairs += [
                ((a, i), (count + b, j))
                for a in inner
                for b in inner
                for i in links[1:]
                for j in links[1:]
            ]
        table = np.array(pairs, np.intp).reshape(-1, 2, 2)  # (C, 2, 2)
        self._a, self._b = (table[:, 0, 0], table[:, 0, 1]), (table[:, 1, 0], table[:, 1, 1])
        radii = np.tile([finger.radii for finger in hand.fingers], (num_hands, 1))  # (F, links)
        self._least = radii[self._a] + radii[self._b] + _CLEARANCE

    def overlaps(self, points: Array, jacobian: Array) -> tuple[Array, tuple[Ids, Ids], Array]:
        """How much nearer than allowed links are, as negative lengths, and zero where they are not.

        Args:
            points: (S, F, P, 3) of the fingers [m], see `Kinematics`.
            jacobian: (S, F, P, 3, A).

        Returns:
            (S, C) [m]; where that is not zero, (N,) and (N,); and the Jacobian there, (N, A).
        """
        a0, a1 = _ends(points, self._a)
        b0, b1 = _ends(points, self._b)
        s, t = _closest(a0, a1, b0, b1)
        gap = a0 + s[..., None] * (a1 - a0) - b0 - t[..., None] * (b1 - b0)
        distance = np.sqrt((gap**2).sum(axis=-1)) + 1e-9
        overlap = np.minimum(distance - self._least, 0.0)
        row, pair = np.nonzero(overlap)
        s, t = s[row, pair, None, None], t[row, pair, None, None]
        ends = [
            jacobian[row, finger[pair], link[pair] + k]
            for finger, link in (self._a, self._b)
            for k in (0, 1)
        ]
        approach = (1 - s) * ends[0] + s * ends[1] - (1 - t) * ends[2] - t * ends[3]
        normal = gap[row, pair] / distance[row, pair, None]
        return overlap, (row, pair), np.einsum("nk,nka->na", normal, approach)


link_collisions = lru_cache(maxsize=8)(LinkCollisions)  # plans that are short ask again and again


def _ends(points: Array, links: tuple[Ids, Ids]) -> tuple[Array, Array]:
    finger, link = links
    return points[:, finger, link], points[:, finger, link + 1]


def _closest(a0: Array, a1: Array, b0: Array, b1: Array) -> tuple[Array, Array]:
    """Where segments are nearest to each other, as fractions (...) of their lengths.

    Ericson, Real-Time Collision Detection (2005), 5.1.9; parallel ones anywhere.
    """
    along_a, along_b, between = a1 - a0, b1 - b0, a0 - b0
    aa, bb = np.vecdot(along_a, along_a), np.vecdot(along_b, along_b)
    ab = np.vecdot(along_a, along_b)
    da, db = np.vecdot(along_a, between), np.vecdot(along_b, between)
    s = np.clip((ab * db - da * bb) / np.maximum(aa * bb - ab * ab, 1e-12), 0.0, 1.0)
    t = np.clip((ab * s + db) / bb, 0.0, 1.0)
    return np.clip((ab * t - da) / aa, 0.0, 1.0), t
