"""Postures of the hands for a stretch of music, as one sparse least-squares problem.

The unknowns are all postures at once. Every residual belongs to one posture (fingertips in their
boxes, fingers out of each other, forearms apart, joints near rest) or to three in a row (smooth
motion, controls within their ranges), so that the normal equations are banded, and a Gauss-Newton
step costs a time linear in the music's length. Levenberg-Marquardt damping is kept for each posture
by itself: one that is hard to find does not hold up the others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planning.collisions import link_collisions
from cadenza.agents.planning.targets import Targets, pressing
from cadenza.hands.forearm import WIDTH
from cadenza.hands.hand import Hand
from cadenza.scene.kinematics import TIP, Kinematics
from cadenza.scene.scene import Scene
from cadenza.scene.servos import Servos

Array = NDArray[np.float64]


_OVERLAP = 0.002  # [m] of links that counts as one
_WALL = 0.001  # [m] into black keys
_LACKING = 0.02  # of a servo's stride that it does not go, as its control would leave its range
_FOREARMS_APART = WIDTH + 0.011  # [m]
_FOREARMS_SIGMA = 0.002  # [m]; with 0.005, close hands are planned 2 cm into each other

_LEAST = 6  # iterations: one of the first may gain little because it is damped a lot
_AT_ONCE = 256  # postures that are linearised together, which takes much more than is kept


class Effort(NamedTuple):
    """How long better postures are looked for."""

    iterations: int
    """Of Gauss-Newton at most."""
    trials: int
    """With more and more damping, in each of them; with 0, the first is taken unseen."""
    converged: float
    """Relative decrease of the cost with which it ends."""
    damping: float
    """In the beginning."""


THOROUGH = Effort(iterations=25, trials=8, converged=1e-3, damping=1.0)


def rest_posture(hand: Hand, servos: Servos) -> Array:
    """(A,) all fingers over neighbouring white keys, the forearms where they are mounted."""
    rest = np.array([hand.servo(name).rest for name in servos.names])
    return np.clip(rest, servos.low, servos.high)


def solve_postures(
    scene: Scene,
    kinematics: Kinematics,
    servos: Servos,
    targets: Targets,
    guess: Array,
    before: Array,
    dt: float,
    progress: Progress = silent,
    begin: Array | None = None,
    effort: Effort = THOROUGH,
) -> Array:
    """Postures (S, A) that put the fingertips into their boxes, smoothly.

    Args:
        scene: with one hand or two.
        kinematics: of the scene.
        servos: of the scene.
        targets: of all fingers in S states.
        guess: (S, A) what the joints like best; its first row is where the hands are and stays.
        before: (A,) the posture before that.
        dt: time between postures [s].
        progress: is told of "postures", in iterations.
        begin: (S, A) where to begin, if not with the guess; with the same first row.
        effort: how long.
    """
    problem = _Problem(scene, kinematics, servos, targets, guess, before, dt, not effort.trials)
    postures = (guess if begin is None else begin).copy()
    damping = np.full(len(guess) - 1, effort.damping)
    now = problem.linearise(postures)
    for iteration in range(effort.iterations):
        progress("postures", iteration, effort.iterations)
        band, gradient = problem.normal_equations(postures, now)
        if not effort.trials:
            postures = problem.step(postures, band, gradient, damping)
            if iteration + 1 < effort.iterations:
                now = problem.linearise(postures)
            continue
        for _ in range(effort.trials):
            trial = problem.step(postures, band, gradient, damping)
            there = problem.linearise(trial)
            worse = there.cost > 1.02 * now.cost + 0.02
            near = worse | np.roll(worse, 1) | np.roll(worse, -1)
            better = there.cost.sum() < now.cost.sum()
            if better:
                eased = np.maximum(damping / 4, 1e-3)
                damping = np.where(near, np.minimum(damping * 4, 1e3), eased)
            if better or not near.any():  # more trials would be the same
                break
            damping = np.where(near, np.minimum(damping * 8, 1e3), damping)
        if not better:
            break
        gained = now.cost.sum() - there.cost.sum()
        postures, now = trial, there
        if iteration + 1 >= _LEAST and gained < effort.converged * now.cost.sum():
            break
    return postures


class _Linearised(NamedTuple):
    cost: Array  # (S - 1,) half the squares of all residuals, those in time at their first posture
    pull: Array  # (S - 1, A) the gradient of the residuals that belong to one posture
    blocks: Array  # (S - 1, A, A) the products of their derivatives
    beyond: Array  # (S - 1, A) how far the controls that lead to them are out of their ranges


class _InARow(NamedTuple):
    """A sum over three postures in a row: what they count in it, (A,) or the same for all."""

    first: Array | float
    second: Array | float
    third: Array | float

    def of(self, postures: Array) -> Array:
        """(N, A) of postures (N + 2, A)."""
        before, now, after = postures[:-2], postures[1:-1], postures[2:]
        return self.first * before + self.second * now + self.third * after

    def add_squares(self, band: Array, weight: Array) -> None:
        """Adds to normal equations, in the upper form of `solveh_banded`, those of its squares.

        Args:
            band: of N postures; two before them are known.
            weight: (N, A) of each square.
        """
        size = weight.shape[1]
        diagonal, next_one, next_but_one = (
            band[row].reshape(weight.shape) for row in (2 * size, size, 0)
        )
        diagonal += weight * self.third**2
        diagonal[:-1] += weight[1:] * self.second**2
        diagonal[:-2] += weight[2:] * self.first**2
        next_one[1:] += weight[1:] * (self.second * self.third)
        next_one[1:-1] += weight[2:] * (self.first * self.second)
        next_but_one[2:] += weight[2:] * (self.first * self.third)

    def add_gradient(self, gradient: Array, pull: Array) -> None:
        """Adds to the gradient (N, A) that of its squares; `pull` is weight times sum."""
        gradient += pull * self.third
        gradient[:-1] += pull[1:] * self.second
        gradient[:-2] += pull[2:] * self.first


_SECOND_DIFFERENCE = _InARow(1.0, -2.0, 1.0)


class _Problem:
    """The residuals of postures 1 to S - 1."""

    def __init__(
        self,
        scene: Scene,
        kinematics: Kinematics,
        servos: Servos,
        targets: Targets,
        guess: Array,
        before: Array,
        dt: float,
        in_a_hurry: bool = False,
    ) -> None:
        self._in_a_hurry = in_a_hurry  # then the last digits may be others
        self._kinematics, self._servos, there = kinematics, servos, scene.fingers_there
        self._low, self._high = targets.low[1:, there], targets.high[1:, there]
        self._sigma = targets.sigma[1:, there]
        self._wall = targets.wall[1:, there]
        self._links = link_collisions(scene.hand, len(scene.sides))
        self._rest, self._before = guess[1:], before
        uses = [scene.hand.servo(name) for name in servos.names]
        self._stiffness = np.array([use.ease for use in uses]) ** -2.0
        acceleration = np.array([use.acceleration for use in uses])
        self._inertia = (acceleration / (1 / dt) ** 2) ** -2.0  # of second differences
        self._stride = np.array([use.stride for use in uses])
        self._force = targets.force[1:, there]
        self._lead = _InARow(*servos.lead(dt))
        self._limit = (_LACKING * self._stride * self._lead.third) ** -2.0
        self._mounted_apart = scene.config.hand_spacing
        slides = servos.along_keyboard
        self._slides = slides if len(slides) == 2 else []
        self._base = self._constant_band(len(guess) - 1)

    def _constant_band(self, count: int) -> Array:
        """The constant part of the normal equations, in the upper form of `solveh_banded`.

        The first of the second differences is with the posture before the problem begins.
        """
        size = len(self._stiffness)
        band = np.zeros((2 * size + 1, count * size))
        band[-1] = np.tile(self._stiffness, count)
        _SECOND_DIFFERENCE.add_squares(band, np.tile(self._inertia, (count, 1)))
        return band

    def linearise(self, postures: Array) -> _Linearised:
        count, size = len(postures) - 1, postures.shape[1]
        squares, pull, blocks = (
            np.zeros(count),
            np.zeros((count, size)),
            np.zeros((count, size, size)),
        )
        servos = self._servos
        rows = np.concatenate([self._before[None], postures])
        control = self._lead.of(rows)
        for first in range(0, count, _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            residual, slope, pressed = self._residuals(postures[1:][some], some)
            control[some] += pressed / servos.stiffness
            squares[some] = (residual**2).sum(axis=1)
            pull[some] = np.einsum("sra,sr->sa", slope, residual)
            blocks[some] = slope.transpose(0, 2, 1) @ slope
        beyond = control - np.clip(control, servos.low, servos.high)
        smooth = self._inertia * _SECOND_DIFFERENCE.of(rows) ** 2
        at_ease = self._stiffness * (postures[1:] - self._rest) ** 2
        cost = 0.5 * (squares + (smooth + at_ease + self._limit * beyond**2).sum(axis=1))
        return _Linearised(cost, pull, blocks, beyond)

    def _residuals(self, moving: Array, some: slice) -> tuple[Array, Array, Array]:
        """(N, R) those of N postures by themselves, and their derivatives (N, R, A).

        And (N, A) the force along each servo's coordinate that presses keys.
        """
        low, high, sigma = self._low[some], self._high[some], self._sigma[some]
        points, jacobian = self._kinematics.fingers(moving)
        tips = points[:, :, TIP]
        outside = (tips - np.clip(tips, low, high)) / sigma
        overlap, (state, pair), overlap_slope = self._links.overlaps(points, jacobian)
        if self._in_a_hurry:
            there, pair = np.unique(pair, return_inverse=True)
            overlap = overlap[:, there]
        (count, size), tip = moving.shape, jacobian[:, :, TIP]
        into_wall = np.minimum(tips[:, :, 0] - self._wall[some], 0.0) / _WALL
        residuals = [outside.reshape(count, -1), into_wall, overlap / _OVERLAP]
        if self._slides:
            right, left = self._slides
            distance = self._mounted_apart + moving[:, right] - moving[:, left]
            near = np.minimum(distance - _FOREARMS_APART, 0.0) / _FOREARMS_SIGMA
            residuals.append(near[:, None])
        residual = np.concatenate(residuals, axis=1)
        slope = np.zeros((*residual.shape, size))
        walls = outside[0].size
        links = walls + into_wall.shape[1]
        pulled = slope[:, :walls].reshape(tip.shape)
        np.multiply(tip, ((outside != 0) / sigma)[..., None], out=pulled)
        np.multiply(tip[:, :, 0], ((into_wall < 0) / _WALL)[..., None], out=slope[:, walls:links])
        slope[state, links + pair] = overlap_slope / _OVERLAP
        if self._slides:
            slope[:, -1, right] = (near < 0) / _FOREARMS_SIGMA
            slope[:, -1, left] = -slope[:, -1, right]
        return residual, slope, pressing(tip[:, :, 2], self._force[some])

    def normal_equations(self, postures: Array, at: _Linearised) -> tuple[Array, Array]:
        """The banded matrix and the gradient (S - 1, A); clamped joints are taken out."""
        servos = self._servos
        count, size = len(postures) - 1, len(servos.low)
        gradient = at.pull + self._stiffness * (postures[1:] - self._rest)
        change = _SECOND_DIFFERENCE.of(np.concatenate([self._before[None], postures]))
        _SECOND_DIFFERENCE.add_gradient(gradient, self._inertia * change)
        self._lead.add_gradient(gradient, self._limit * at.beyond)
        band = self._base.copy()
        self._lead.add_squares(band, self._limit * (at.beyond != 0))
        for above in range(size):  # diagonals of the blocks
            row = band[-1 - above].reshape(count, size)
            row[:, above:] += np.diagonal(at.blocks, above, axis1=1, axis2=2)
        outwards = np.where(gradient > 0, postures[1:] <= servos.low, postures[1:] >= servos.high)
        band[-1] += 1e9 * outwards.ravel()
        return band, np.where(outwards, 0.0, gradient)

    def step(self, postures: Array, band: Array, gradient: Array, damping: Array) -> Array:
        damped = band.copy()
        damped[-1] += (damping[:, None] / self._stride**2).ravel()
        change = solveh_banded(damped, -gradient.ravel(), overwrite_ab=True, check_finite=False)
        change = np.clip(change.reshape(gradient.shape), -self._stride, self._stride)
        moved = np.clip(postures[1:] + change, self._servos.low, self._servos.high)
        return np.concatenate([postures[:1], moved])
