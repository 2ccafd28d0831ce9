"""The terms of inverse kinematics, in the least squares of a trajectory of postures.

Terms of one posture are called with `PosedHands` and return their residuals and Jacobian, in
standard deviations. Terms of the motion are linear in three postures in a row, each servo by
itself: a `Stencil`.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Ids
from cadenza.agents.planner.plan.link_collisions import LinkCollisions, LinkPairs
from cadenza.hands.forearm import WIDTH
from cadenza.scene.kinematics import TIP, Links
from cadenza.scene.servos import Servos, clip

Array = NDArray[Any]

# The weight of a term is the inverse square of its standard deviation. `Targets` have that of
# fingertips outside their boxes.
_WALL_SIGMA = 0.001  # [m] into black keys: strict, as a finger that touches them is caught
_OVERLAP_SIGMA = 0.002  # [m] of links: a little does no harm, as fingers give way
_FOREARMS_SIGMA = 0.002  # [m] of forearms; with 0.005, close hands are planned 2 cm into each other
# Of a servo's shortfall as its control would leave its range, in strides: strict, as it is
# impossible.
_RANGE_SIGMA = 0.02
# The distance of a servo from rest and its acceleration have `Servo.ease` and `Servo.acceleration`
# of the hand. They are large, so that these terms only decide what the others leave open.

_FOREARMS_APART = WIDTH + 0.011  # [m] from middle to middle: room for what is not modelled


class PosedHands(NamedTuple):
    """H hands with A servos each in N postures of a trajectory."""

    rows: Ids  # (N,) the numbers of these postures in the trajectory
    postures: Array  # (N, H, A)
    links: Links

    def part(self, which: Ids) -> PosedHands:
        """The hands in some of the postures."""
        links = self.links._replace(
            points=self.links.points[which],
            tips=self.links.tips[which],
            screws=self.links.screws[which],
        )
        return PosedHands(self.rows[which], self.postures[which], links)


Term = tuple[Array, Array]
"""Residuals (N, H, R) of each hand, or (N, R) between hands, and their Jacobian (N, H, R, A)."""


def stacked(terms: Iterable[Term]) -> Term:
    """Concatenate the residuals of terms, and their Jacobians."""
    residuals, jacobians = zip(*terms, strict=True)
    return np.concatenate(residuals, axis=-1), np.concatenate(jacobians, axis=-2)


# Of each hand by itself


class TipsInBoxes:
    """Distances of fingertips from their boxes, three for each."""

    def __init__(self, low: Array, high: Array, sigma: Array) -> None:
        """Take the boxes (S, H, F, 3) of `Targets`."""
        self._boxes = low, high, sigma

    def __call__(self, hands: PosedHands) -> Term:
        low, high, sigma = (values[hands.rows] for values in self._boxes)
        tips, jacobian = hands.links.points[:, :, :, TIP], hands.links.tips
        outside = (tips - clip(tips, low, high)) / sigma
        slope = jacobian * ((outside != 0) / sigma)[..., None]
        count, num_hands = outside.shape[:2]
        return outside.reshape(count, num_hands, -1), slope.reshape(
            count, num_hands, -1, slope.shape[-1]
        )


class TipsBehindBlackKeys:
    """Depths of fingertips that press white keys in the wall of black keys behind these."""

    def __init__(self, wall: Array) -> None:
        """Take `wall` (S, H, F) of `Targets`."""
        self._wall = wall

    def __call__(self, hands: PosedHands) -> Term:
        tips, jacobian = hands.links.points[:, :, :, TIP, 0], hands.links.tips[..., 0, :]
        depth = np.minimum(tips - self._wall[hands.rows], 0.0) / _WALL_SIGMA
        weight = ((depth < 0) / _WALL_SIGMA).astype(depth.dtype)
        return depth, jacobian * weight[..., None]


class LinksApart:
    """Overlaps of links of one hand."""

    def __init__(self, pairs: LinkPairs) -> None:
        self._pairs = pairs

    def __call__(self, hands: PosedHands) -> Term:
        links, points = hands.links, hands.links.points
        count, num_hands, fingers, _, size = links.tips.shape
        overlaps = self._pairs.overlaps(points.reshape(count * num_hands, *points.shape[2:]))
        posture, hand = np.divmod(overlaps.row, num_hands)
        num_pairs, column = overlaps.columns
        residual = np.zeros((count, num_hands, num_pairs), points.dtype)
        residual[posture, hand, column] = overlaps.depth / _OVERLAP_SIGMA
        finger = hand * fingers + overlaps.finger
        apart = links.along(posture, finger, overlaps.link, overlaps.at, overlaps.away)
        jacobian = np.zeros((*residual.shape, size), points.dtype)
        jacobian[posture, hand, column] = apart.sum(axis=0) / _OVERLAP_SIGMA
        return residual, jacobian


# Between hands


class HandLinksApart:
    """Overlaps of links of the right hand and the left."""

    def __init__(self, collisions: LinkCollisions) -> None:
        self._collisions = collisions

    def near(self, hands: PosedHands) -> NDArray[np.bool_]:
        """(N,) whether hands could overlap."""
        return self._collisions.hands_near(hands.links.points)

    def __call__(self, hands: PosedHands) -> Term:
        links, points = hands.links, hands.links.points
        overlaps = self._collisions.between_hands.overlaps(
            points.reshape(len(points), -1, *points.shape[3:])
        )
        num_pairs, column = overlaps.columns
        residual = np.zeros((len(points), num_pairs), points.dtype)
        residual[overlaps.row, column] = overlaps.depth / _OVERLAP_SIGMA
        away = links.along(overlaps.row, overlaps.finger, overlaps.link, overlaps.at, overlaps.away)
        jacobian = np.zeros((len(points), 2, num_pairs, links.tips.shape[-1]), points.dtype)
        jacobian[overlaps.row, [[0], [1]], column] = away / _OVERLAP_SIGMA
        return residual, jacobian


class ForearmsApart:
    """The overlap of the forearms, which slide along the keyboard."""

    def __init__(self, slide: int, mounted_apart: float) -> None:
        """Take the servo of a hand that moves its forearm, and the distance of the mounts [m]."""
        self._slide, self._mounted_apart = slide, mounted_apart

    def near(self, hands: PosedHands) -> NDArray[np.bool_]:
        """(N,) whether forearms overlap."""
        return self._overlap(hands.postures) < 0

    def __call__(self, hands: PosedHands) -> Term:
        residual = self._overlap(hands.postures)[:, None]
        jacobian = np.zeros((len(residual), 2, 1, hands.postures.shape[-1]), residual.dtype)
        sign = np.array([1.0, -1.0]) / _FOREARMS_SIGMA
        jacobian[:, :, 0, self._slide] = sign * (residual < 0)
        return residual, jacobian

    def _overlap(self, postures: Array) -> Array:
        right, left = postures[:, :, self._slide].T
        apart: Array = self._mounted_apart + right - left
        return np.minimum(apart - _FOREARMS_APART, 0.0) / _FOREARMS_SIGMA


# Of the motion


class Stencil(NamedTuple):
    """A linear combination of three postures in a row, with coefficients (H, A) or one for all."""

    first: Array | float
    second: Array | float
    third: Array | float

    def __call__(self, postures: Array) -> Array:
        """The combinations (N, H, A) in postures (N + 2, H, A)."""
        before, now, after = postures[:-2], postures[1:-1], postures[2:]
        return self.first * before + self.second * now + self.third * after

    def normal_equations(self, weight: Array) -> Array:
        """(3, N, H, A) diagonals of the normal equations of its squares, weighted by (N, H, A).

        There is a block of each of N postures with itself, with the previous one, and with the one
        before that. The two postures before the first are fixed.
        """
        diagonals = np.zeros((3, *weight.shape), weight.dtype)
        itself, one_before, two_before = diagonals
        itself += weight * self.third**2
        itself[:-1] += weight[1:] * self.second**2
        itself[:-2] += weight[2:] * self.first**2
        one_before[1:] += weight[1:] * (self.second * self.third)
        one_before[1:-1] += weight[2:] * (self.first * self.second)
        two_before[2:] += weight[2:] * (self.first * self.third)
        return diagonals

    def add_gradient(self, gradient: Array, weighted: Array) -> None:
        """Add the gradient of its squares to `gradient`; residuals (N, H, A) are weighted."""
        gradient += weighted * self.third
        gradient[:-1] += weighted[1:] * self.second
        gradient[:-2] += weighted[2:] * self.first


class MotionTerm(NamedTuple):
    """Weighted squares of residuals whose derivatives are the coefficients of a stencil."""

    stencil: Stencil
    weight: Array  # (H, A)


class MotionTerms(NamedTuple):
    """The terms of the motion of H hands with A servos each, and figures of these servos."""

    rest: MotionTerm  # the distances of servos from their rest
    smoothness: MotionTerm  # the second differences of postures
    # The violations of their ranges by the controls that lead along the motion (`Servos.lead`)
    control_range: MotionTerm
    stride: Array  # (H, A) the maximum change of a servo in an iteration
    low: Array  # (H, A) the range of the servos, and of their controls
    high: Array  # (H, A)
    per_force: Array  # (H, A) the change of a control for a unit force against the servo

    @property
    def terms(self) -> tuple[MotionTerm, MotionTerm, MotionTerm]:
        """The three terms."""
        return self.rest, self.smoothness, self.control_range


@lru_cache(maxsize=8)  # for short plans
def motion_terms(servos: Servos, hands: int, dt: float, dtype: np.dtype[Any]) -> MotionTerms:
    """The terms of a motion in steps of `dt` [s]."""
    figures = np.array([(use.ease, use.acceleration, use.stride) for use in servos.uses]).T
    ends = servos.low, servos.high, 1 / servos.stiffness
    ease, acceleration, stride, *lead, low, high, per_force = (
        values.reshape(hands, -1).astype(dtype) for values in (*figures, *servos.lead(dt), *ends)
    )
    return MotionTerms(
        MotionTerm(Stencil(0.0, 0.0, 1.0), ease**-2.0),
        MotionTerm(Stencil(1.0, -2.0, 1.0), (acceleration / (1 / dt) ** 2) ** -2.0),
        MotionTerm(Stencil(*lead), (_RANGE_SIGMA * stride * lead[2]) ** -2.0),
        stride,
        low,
        high,
        per_force,
    )
