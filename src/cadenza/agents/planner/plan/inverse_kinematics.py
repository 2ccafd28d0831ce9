"""Postures of the hands for a stretch of music, as one sparse least-squares problem.

The unknowns are all postures at once. Every residual belongs to one posture (fingertips in their
boxes, fingers out of each other, forearms apart, joints near rest) or to three in a row (smooth
motion, controls within their ranges), so that the normal equations are banded, and a Gauss-Newton
step costs a time linear in the music's length. Where hands never come close to each other, the
equations of each are solved by themselves, in a quarter of the time. Levenberg-Marquardt damping is
kept for each posture by itself: one that is hard to find does not hold up the others. And only
postures that have moved far enough are linearised anew (fluid relinearisation: Kaess et al., iSAM2,
International Journal of Robotics Research 31, 2012).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, lapack

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planner.plan.fingertip_targets import Targets, by_hand, pressing
from cadenza.agents.planner.plan.link_collisions import link_collisions
from cadenza.hands.forearm import WIDTH
from cadenza.scene.kinematics import TIP, Kinematics, Links
from cadenza.scene.scene import Scene
from cadenza.scene.servos import Servos, within

Array = NDArray[Any]
Ids = NDArray[np.intp]

_OVERLAP = 0.002  # [m] of links that counts as one
_WALL = 0.001  # [m] into black keys
_LACKING = 0.02  # of a servo's stride that it does not go, as its control would leave its range
_FOREARMS_APART = WIDTH + 0.011  # [m]
_FOREARMS_SIGMA = 0.002  # [m]; with 0.005, close hands are planned 2 cm into each other

_LEAST = 6  # iterations: one of the first may gain little because it is damped a lot
_MOVED = 0.05  # of a servo's stride by which a posture moves until it is linearised anew
_REAL = np.float32  # less time than double precision, and the same costs within a hundredth
_BLOCKED = 68  # diagonals from which on LAPACK works in blocks: with zeros it takes half the time
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
    derivatives_kept: bool = False
    """Whether all steps that are taken unseen have the derivatives of the first."""


THOROUGH = Effort(iterations=25, trials=8, converged=1e-3, damping=1.0)


def rest_posture(servos: Servos) -> Array:
    """(A,) all fingers over neighbouring white keys, the forearms where they are mounted."""
    rest = np.array([use.rest for use in servos.uses])
    return servos.clip(rest)


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
    problem = _Problem(scene, kinematics, servos, targets, guess, before, dt)
    postures = (guess if begin is None else begin).copy()
    if not effort.trials:
        return _improved(problem, postures, effort)
    return _searched(problem, postures, effort, progress)


def _improved(problem: _Problem, postures: Array, effort: Effort) -> Array:
    """By steps of Gauss-Newton that are taken unseen."""
    damping = np.full(len(postures) - 1, effort.damping, _REAL)
    known: _Postures | None = None
    for _ in range(effort.iterations):
        if known is None or not effort.derivatives_kept:
            known = problem.derivatives(postures)
        now = problem.linearised(postures, known)
        bands, gradient = problem.normal_equations(postures, now)
        earlier, postures = postures, problem.step(postures, bands, gradient, damping)
        gained = 0.5 * np.vdot(gradient, (earlier - postures)[1:])
        if gained < effort.converged * now.cost.sum():
            break
    return postures


def _searched(problem: _Problem, postures: Array, effort: Effort, progress: Progress) -> Array:
    """By steps of Levenberg-Marquardt, as long as they cost less."""
    damping = np.full(len(postures) - 1, effort.damping, _REAL)
    now = problem.linearised(postures, problem.derivatives(postures))
    for iteration in range(effort.iterations):
        progress("postures", iteration, effort.iterations)
        bands, gradient = problem.normal_equations(postures, now)
        failed = np.zeros(len(damping), bool)
        for _ in range(effort.trials):
            trial = problem.step(postures, bands, gradient, damping)
            there = problem.linearised(trial, problem.derivatives(trial, now.postures))
            worse = there.cost > 1.02 * now.cost + 0.02
            # The ends are taken for neighbours, too: at sight, that plays a little better.
            near = worse | np.roll(worse, 1) | np.roll(worse, -1)
            better = there.cost.sum() < now.cost.sum()
            if better:
                eased = np.where(failed, damping, np.maximum(damping / 2, 1e-3))
                damping = np.where(near, np.minimum(damping * 4, 1e3), eased)
            more = np.where(near, np.minimum(damping * 8, 1e3), damping)
            if better or (more == damping).all():  # more trials would be the same
                break
            damping = more
            failed |= near
        if not better:
            break
        gained = now.cost.sum() - there.cost.sum()
        postures, now = trial, there
        if iteration + 1 >= _LEAST and gained < effort.converged * now.cost.sum():
            break
    return postures


class _Postures(NamedTuple):
    """N postures of H hands with A servos each, and the residuals of each by itself near them."""

    at: Array
    """(N, H, A) near which that is."""
    squares: Array
    """(N,) the sums of their squares."""
    pull: Array
    """(N, H, A) half the gradient of these."""
    blocks: Array
    """(N, H, A, A) the products of their derivatives by the same hand."""
    pressed: Array
    """(N, H, A) how much further controls are to press keys."""
    close: Ids
    """(M,) those of them in which hands are close to each other."""
    between: Array
    """(M, A, A) the products of derivatives of these, by the right hand and the left."""

    def with_new(self, rows: Ids, new: _Postures) -> _Postures:
        """With new ones in some rows, (R,)."""
        kept = ~np.isin(self.close, rows)
        values = {
            "close": np.concatenate([self.close[kept], new.close]),
            "between": np.concatenate([self.between[kept], new.between]),
        }
        for name in ("at", "squares", "pull", "blocks", "pressed"):
            values[name] = getattr(self, name).copy()
            values[name][rows] = getattr(new, name)
        return _Postures(**values)

    def pull_of(self, off: Array) -> Array:
        """(N, H, A) by how much their pull is another where they are off by (N, H, A)."""
        more = (self.blocks @ off[..., None])[..., 0]
        if len(self.close):
            right, left = np.moveaxis(off[self.close], 1, 0)
            more[self.close, 0] += np.einsum("mrl,ml->mr", self.between, left)
            more[self.close, 1] += np.einsum("mrl,mr->ml", self.between, right)
        return more


class _Linearised(NamedTuple):
    """Of N postures of H hands with A servos each."""

    cost: Array
    """(N,) half the squares of all residuals, those in time at their last posture."""
    pull: Array
    """(N, H, A) the gradient of the residuals that belong to one posture."""
    beyond: Array
    """(N, H, A) how far the controls that lead to them are out of their ranges."""
    postures: _Postures
    """What that was found by: these or, where they have hardly moved, earlier ones."""


class _InARow(NamedTuple):
    """A sum over three postures in a row: what they count in it, (H, A) or the same for all."""

    first: Array | float
    second: Array | float
    third: Array | float

    def of(self, postures: Array) -> Array:
        """(N, H, A) of postures (N + 2, H, A)."""
        before, now, after = postures[:-2], postures[1:-1], postures[2:]
        return self.first * before + self.second * now + self.third * after

    def squares(self, weight: Array) -> Array:
        """(3, N, H, A) the normal equations of its squares, for each servo by itself.

        Of each of N postures with itself, with the one before, and with the one before that; two
        before them are known. `weight` (N, H, A) is that of each square.
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

    def add_gradient(self, gradient: Array, pull: Array) -> None:
        """Adds to the gradient (N, H, A) that of its squares; `pull` is weight times sum."""
        gradient += pull * self.third
        gradient[:-1] += pull[1:] * self.second
        gradient[:-2] += pull[2:] * self.first


_SECOND_DIFFERENCE = _InARow(1.0, -2.0, 1.0)


class _Weights(NamedTuple):
    """What the motion of H hands with A servos costs, (H, A) each."""

    stiffness: Array
    """Of squares of how far a servo is from its rest."""
    inertia: Array
    """Of squares of second differences."""
    stride: Array
    """How far it goes in a step at most."""
    lead: _InARow
    """What makes controls of postures, see `Servos.lead`."""
    limit: Array
    """Of squares of how far controls are out of their ranges."""
    least: Array
    """The ends of these."""
    most: Array
    per_force: Array
    """How much further a control is for a force that stands against the servo."""


@lru_cache(maxsize=8)  # short plans ask again and again
def _weights(servos: Servos, hands: int, dt: float) -> _Weights:
    figures = [(use.ease, use.acceleration, use.stride) for use in servos.uses]
    ease, acceleration, stride = (_of_hands(some, hands) for some in np.array(figures).T)
    lead = _InARow(*(_of_hands(some, hands) for some in servos.lead(dt)))
    inertia = (acceleration / (1 / dt) ** 2) ** -2.0
    limit = (_LACKING * stride * lead.third) ** -2.0
    ends = (_of_hands(some, hands) for some in (servos.low, servos.high, 1 / servos.stiffness))
    return _Weights(ease**-2.0, inertia, stride, lead, limit, *ends)


def _of_hands(servos: Array, hands: int) -> Array:
    """(H, A) of values (H A,)."""
    return servos.reshape(hands, -1).astype(_REAL)


class _Problem:
    """The residuals of postures 1 to S - 1 of H hands with A servos each."""

    def __init__(
        self,
        scene: Scene,
        kinematics: Kinematics,
        servos: Servos,
        targets: Targets,
        guess: Array,
        before: Array,
        dt: float,
    ) -> None:
        self._kinematics, there = kinematics, scene.fingers_there
        self._hands = len(scene.sides)
        self._low, self._high, self._sigma, self._wall, self._force = (
            self._by_hand(values[1:, there])
            for values in (targets.low, targets.high, targets.sigma, targets.wall, targets.force)
        )
        self._collisions = link_collisions(scene.hand)
        self._rest, self._before = map(self._by_hand, (guess[1:], before[None]))
        weights = _weights(servos, self._hands, dt)
        self._stiffness, self._inertia, self._stride, self._lead, self._limit, *ends = weights
        self._least, self._most, self._per_force = ends
        self._mounted_apart = scene.config.hand_spacing
        self._slides = servos.along_keyboard[: self._hands - 1]  # of the first of two hands
        # The first of the second differences is with the posture before the problem begins.
        self._constant = _SECOND_DIFFERENCE.squares(self._inertia + np.zeros_like(self._rest))
        self._constant[0] += self._stiffness

    def _by_hand(self, rows: Array) -> Array:
        """(N, H, X, ...) of rows (N, H X, ...)."""
        return by_hand(rows, self._hands).astype(_REAL)

    def derivatives(self, postures: Array, known: _Postures | None = None) -> _Postures:
        """At postures (S, A); those that are `known` where these have not moved far from them."""
        if known is None:
            return self._by_themselves(postures[1:], np.arange(len(postures) - 1))
        far = np.abs(self._by_hand(postures[1:]) - known.at) > _MOVED * self._stride
        moved = np.flatnonzero(far.any(axis=(1, 2)))
        if not len(moved):
            return known
        return known.with_new(moved, self._by_themselves(postures[1:][moved], moved))

    def linearised(self, postures: Array, known: _Postures) -> _Linearised:
        """What postures (S, A) cost by the derivatives of those that are known near them."""
        now = self._by_hand(postures)
        here = now[1:]
        off = here - known.at
        more = known.pull_of(off)
        squares = known.squares + ((2 * known.pull + more) * off).sum(axis=(1, 2))
        rows = np.concatenate([self._before, now])
        control = self._lead.of(rows) + known.pressed
        beyond = control - within(control, self._least, self._most)
        smooth = self._inertia * _SECOND_DIFFERENCE.of(rows) ** 2
        at_ease = self._stiffness * (here - self._rest) ** 2
        cost = 0.5 * (squares + (smooth + at_ease + self._limit * beyond**2).sum(axis=(1, 2)))
        return _Linearised(cost, known.pull + more, beyond, known)

    def _by_themselves(self, postures: Array, rows: Ids) -> _Postures:
        """Some postures (N, A), which are those after the first in some rows, (N,)."""
        count, (hands, size) = len(postures), self._stride.shape
        at = postures.reshape(count, hands, size).astype(_REAL)
        squares, pull = np.zeros(count, _REAL), np.zeros(at.shape, _REAL)
        blocks = np.zeros((*at.shape, size), _REAL)
        pressed = np.zeros(at.shape, _REAL)
        close, between = [], []
        for first in range(0, count, _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            links = self._kinematics.links(postures[some])
            points: Array = links.points.astype(_REAL)
            tips: Array = links.tips.astype(_REAL)
            residual, slope = self._of_one_hand(links, points, tips, rows[some])
            squares[some] = (residual**2).sum(axis=(1, 2))
            pull[some] = (residual[:, :, None] @ slope)[:, :, 0]
            blocks[some] = slope.swapaxes(2, 3) @ slope
            near, residual, slope = self._between_hands(links, points, at[some])
            squares[some][near] += (residual**2).sum(axis=1)
            pull[some][near] += (residual[:, None, None] @ slope)[:, :, 0]
            blocks[some][near] += slope.swapaxes(2, 3) @ slope
            close.append(rows[some][near])
            between.append(slope[:, 0].swapaxes(1, 2) @ slope[:, -1])
            force = self._force[rows[some]]
            pressed[some] = pressing(tips[:, :, :, 2], force) * self._per_force
        both = np.concatenate(close), np.concatenate(between)
        return _Postures(at, squares, pull, blocks, pressed, *both)

    def _of_one_hand(
        self, links: Links, points: Array, tips: Array, rows: Ids
    ) -> tuple[Array, Array]:
        """(N, H, R) residuals of each hand by itself in N postures, and derivatives (N, H, R, A).

        Args:
            links: of the postures.
            points: (N, H, F, P, 3), see `Links`.
            tips: (N, H, F, 3, A) likewise.
            rows: (N,) which of all postures they are.
        """
        low, high, sigma = self._low[rows], self._high[rows], self._sigma[rows]
        at, (count, hands, fingers, _, size) = points[:, :, :, TIP], tips.shape
        outside = (at - within(at, low, high)) / sigma
        into_wall = np.minimum(at[..., 0] - self._wall[rows], 0.0) / _WALL
        overlaps = self._collisions.of_hand.overlaps(
            points.reshape(count * hands, *points.shape[2:])
        )
        posture, hand = np.divmod(overlaps.row, hands)
        met, column = overlaps.columns
        walls, others = 3 * fingers, 4 * fingers
        residual = np.zeros((count, hands, others + met), _REAL)
        residual[:, :, :walls] = outside.reshape(count, hands, walls)
        residual[:, :, walls:others] = into_wall
        residual[posture, hand, others + column] = overlaps.depth / _OVERLAP
        slope = np.zeros((*residual.shape, size), _REAL)
        pulled = slope[:, :, :walls].reshape(tips.shape)
        np.multiply(tips, ((outside != 0) / sigma)[..., None], out=pulled)
        walled = slope[:, :, walls:others]
        np.multiply(tips[..., 0, :], ((into_wall < 0) / _WALL)[..., None], out=walled)
        finger = hand * fingers + overlaps.finger
        apart = links.along(posture, finger, overlaps.link, overlaps.at, overlaps.away)
        slope[posture, hand, others + column] = apart.sum(axis=0) / _OVERLAP
        return residual, slope

    def _between_hands(
        self, links: Links, points: Array, postures: Array
    ) -> tuple[Ids, Array, Array]:
        """Which M of N postures have hands close to each other; residuals (M, R) of both hands.

        And their derivatives (M, 2, R, A).

        Args:
            links: of the postures.
            points: (N, H, F, P, 3), see `Links`.
            postures: (N, H, A).
        """
        count, hands, size = postures.shape
        forearms = np.zeros((count, len(self._slides)), _REAL)
        for slide in self._slides:
            apart = self._mounted_apart + postures[:, 0, slide] - postures[:, 1, slide]
            forearms[:, 0] = np.minimum(apart - _FOREARMS_APART, 0.0) / _FOREARMS_SIGMA
        could = self._collisions.hands_near(points) | forearms.any(axis=1)
        near = np.flatnonzero(could)
        if not len(near):
            return near, np.zeros((0, 0), _REAL), np.zeros((0, hands, 0, size), _REAL)
        some = points[near]
        overlaps = self._collisions.of_both.overlaps(some.reshape(len(near), -1, *some.shape[3:]))
        met, column = overlaps.columns
        residual = np.zeros((len(near), met), _REAL)
        residual[overlaps.row, column] = overlaps.depth / _OVERLAP
        residual = np.concatenate([residual, forearms[near]], axis=1)
        slope = np.zeros((len(near), hands, residual.shape[1], size), _REAL)
        posture, finger = near[overlaps.row], overlaps.finger
        away = links.along(posture, finger, overlaps.link, overlaps.at, overlaps.away)
        slope[overlaps.row, [[0], [1]], column] = away / _OVERLAP
        for slide in self._slides:
            sign = np.array([1.0, -1.0]) / _FOREARMS_SIGMA
            slope[:, :, met, slide] = sign * (residual[:, met:] < 0)
        close = residual.any(axis=1)
        return near[close], residual[close], slope[close]

    def normal_equations(self, postures: Array, at: _Linearised) -> tuple[Array, Array]:
        """The banded matrices, see `_banded`, and the gradient (S - 1, H, A).

        There is a matrix for each hand, or one for both where they come close to each other. Joints
        at the ends of their ranges that would go further are taken out.
        """
        rows = self._by_hand(postures)
        now = rows[1:]
        gradient = at.pull + self._stiffness * (now - self._rest)
        change = _SECOND_DIFFERENCE.of(np.concatenate([self._before, rows]))
        _SECOND_DIFFERENCE.add_gradient(gradient, self._inertia * change)
        self._lead.add_gradient(gradient, self._limit * at.beyond)
        outwards = np.where(gradient > 0, now <= self._least, now >= self._most)
        diagonals = self._constant + self._lead.squares(self._limit * (at.beyond != 0))
        diagonals[0] += 1e9 * outwards
        return _banded(diagonals, at.postures), np.where(outwards, 0.0, gradient)

    def step(self, postures: Array, bands: Array, gradient: Array, damping: Array) -> Array:
        change = self._solved(bands, gradient, damping).reshape(gradient.shape)
        change = within(change, -self._stride, self._stride)
        moved = within(self._by_hand(postures[1:]) + change, self._least, self._most)
        return np.concatenate([postures[:1], moved.reshape(len(moved), -1)])

    def _solved(self, bands: Array, gradient: Array, damping: Array) -> Array:
        """(S - 1, 1 or H, A or H A) what the equations ask for, damped (S - 1,)."""
        damped, shape = bands.copy(), (len(gradient), len(bands), -1)
        more = (damping[:, None, None] / self._stride**2).reshape(shape)
        damped[..., -1] += more.swapaxes(0, 1)
        pull = -gradient.reshape(shape).swapaxes(0, 1)
        # Not `scipy.linalg.solveh_banded`, which takes as long to call it as short plans to solve.
        solve = lapack.spbsv if bands.dtype == np.float32 else lapack.dpbsv
        found = np.empty_like(pull)
        for band, own, there in zip(damped, pull, found, strict=True):
            _, x, failed = solve(band.reshape(-1, band.shape[-1]).T, own.ravel(), overwrite_ab=True)
            if failed:
                if bands.dtype == np.float64:
                    raise LinAlgError("the equations of postures are not positive definite")
                return self._solved(bands.astype(np.float64), gradient, damping)
            there[...] = x.reshape(there.shape)
        return found.swapaxes(0, 1)


def _banded(diagonals: Array, at: _Postures) -> Array:
    """(1 or H, N, A, D) normal equations: D diagonals as in the upper form of `solveh_banded`.

    `diagonals` (3, N, H, A) are those of sums of postures in a row.
    """
    blocks = _of_both(at) if len(at.close) else at.blocks
    count, parts, size = blocks.shape[:3]
    bands = np.zeros((parts, count, size, max(2 * size, _BLOCKED) + 1), blocks.dtype)
    row, column = _upper(size)
    bands[:, :, column, row - column - 1] = blocks.swapaxes(0, 1)[:, :, row, column]
    in_a_row = diagonals.reshape(3, count, parts, size).swapaxes(1, 2)
    for apart, diagonal in enumerate(in_a_row):
        bands[..., -1 - apart * size] += diagonal
    return bands


_upper = lru_cache(np.triu_indices)  # which takes as long as all else here if plans are short


def _of_both(at: _Postures) -> Array:
    """(N, 1, 2 A, 2 A) the upper half of the blocks of both hands together."""
    count, hands, size = at.blocks.shape[:3]
    blocks = np.zeros((count, hands, size, hands, size), at.blocks.dtype)
    for hand in range(hands):
        blocks[:, hand, :, hand] = at.blocks[:, hand]
    blocks[at.close, 0, :, 1] = at.between
    return blocks.reshape(count, 1, hands * size, hands * size)
