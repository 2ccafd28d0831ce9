"""Postures of the hands for a stretch of music, as one sparse least-squares problem.

The unknowns are all postures at once. The terms (`kinematic_terms`) concern one posture or three in
a row, so that the normal equations are banded, and a Gauss-Newton step costs a time linear in the
music's length. Where hands never come close to each other, the equations of each are solved by
themselves, in a quarter of the time. Only postures that have moved far enough are linearised anew
(fluid relinearisation: Kaess et al., iSAM2, International Journal of Robotics Research 31, 2012).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, lapack

from cadenza.agents.agent import Ids, Progress, silent
from cadenza.agents.planner.plan.fingertip_targets import Targets, by_hand, pressing_forces
from cadenza.agents.planner.plan.kinematic_terms import (
    ForearmsApart,
    HandLinksApart,
    LinksApart,
    PosedHands,
    TipsBehindBlackKeys,
    TipsInBoxes,
    motion_terms,
    stacked,
)
from cadenza.agents.planner.plan.link_collisions import link_collisions
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.servos import clip

Array = NDArray[Any]

# Less time than double precision, and the same costs within a hundredth.
_REAL: np.dtype[Any] = np.dtype(np.float32)
_MOVED = 0.05  # of a servo's stride by which a posture moves until it is linearised anew
_BLOCKED_DIAGONALS = 68  # from which on LAPACK works in blocks: with zeros it takes half the time
_AT_ONCE = 256  # postures that are linearised together, which takes much more than is kept
_FIXED = 1e9  # weight that keeps a joint at the end of its range

# Levenberg-Marquardt: a step fails at a posture whose cost becomes larger than `_WORSE` times the
# one before and `_WORSE_BY`; the damping there and beside it is multiplied by `_RETRIED` for the
# next trial or, if the step is taken all the same, by `_TIGHTENED`, and elsewhere by `_EASED`.
_WORSE, _WORSE_BY = 1.02, 0.02
_RETRIED, _TIGHTENED, _EASED = 8, 4, 1 / 2
_MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e3
_MIN_ITERATIONS = 6  # one of the first may gain little because it is damped a lot


class SolverOptions(NamedTuple):
    """Parameters of the solver."""

    max_iterations: int  # the maximum number of steps
    # The maximum number of dampings that are tried in a step until the cost falls (Levenberg-
    # Marquardt). With 0, each step is taken, whatever it costs (Gauss-Newton without a line
    # search).
    max_trials: int
    tolerance: float  # relative decrease of the cost with which the solver ends
    damping: float  # damping of the first step; without a line search, of all
    # Whether all steps without a line search have the derivatives of the first
    keep_derivatives: bool = False


THOROUGH = SolverOptions(max_iterations=25, max_trials=8, tolerance=1e-3, damping=1.0)


def solve_postures(
    kinematics: Kinematics,
    targets: Targets,
    guess: Array,
    before: Array,
    dt: float,
    progress: Progress = silent,
    begin: Array | None = None,
    options: SolverOptions = THOROUGH,
) -> Array:
    """Postures (S, A) that put the fingertips into their boxes, smoothly.

    Args:
        kinematics: the kinematics of a scene with one hand or two.
        targets: the targets of all fingers in S states.
        guess: (S, A) the postures to stay near; the first row is where the hands are and stays.
        before: (A,) the posture before that.
        dt: time between postures [s].
        progress: receives the stage "postures", in iterations.
        begin: (S, A) the warm start, if not the guess; with the same first row.
        options: parameters of the solver.
    """
    problem = PostureProblem(kinematics, targets, guess, before, dt)
    postures = (guess if begin is None else begin).copy()
    if not options.max_trials:
        return _gauss_newton(problem, postures, options)
    return _levenberg_marquardt(problem, postures, options, progress)


def _gauss_newton(problem: PostureProblem, postures: Array, options: SolverOptions) -> Array:
    """Gauss-Newton without a line search."""
    damping = np.full(len(postures) - 1, options.damping, _REAL)
    known: PostureLinearisation | None = None
    for _ in range(options.max_iterations):
        if known is None or not options.keep_derivatives:
            known = problem.linearisation(postures)
        now = problem.evaluation(postures, known)
        bands, gradient = problem.normal_equations(postures, now)
        earlier, postures = postures, problem.step(postures, bands, gradient, damping)
        gained = 0.5 * np.vdot(gradient, (earlier - postures)[1:])
        if gained < options.tolerance * now.cost.sum():
            break
    return postures


def _levenberg_marquardt(
    problem: PostureProblem, postures: Array, options: SolverOptions, progress: Progress
) -> Array:
    """Levenberg-Marquardt, in which each posture has a damping of its own, so that none waits."""
    damping = np.full(len(postures) - 1, options.damping, _REAL)
    now = problem.evaluation(postures, problem.linearisation(postures))
    for iteration in range(options.max_iterations):
        progress("postures", iteration, options.max_iterations)
        bands, gradient = problem.normal_equations(postures, now)
        failed = np.zeros(len(damping), bool)
        for _ in range(options.max_trials):
            trial = problem.step(postures, bands, gradient, damping)
            there = problem.evaluation(trial, problem.linearisation(trial, now.linearisation))
            worse = there.cost > _WORSE * now.cost + _WORSE_BY
            # The ends are taken for neighbours, too: at sight, that plays a little better.
            near = worse | np.roll(worse, 1) | np.roll(worse, -1)
            better = there.cost.sum() < now.cost.sum()
            if better:
                eased = np.where(failed, damping, np.maximum(damping * _EASED, _MIN_DAMPING))
                damping = np.where(near, np.minimum(damping * _TIGHTENED, _MAX_DAMPING), eased)
            more = np.where(near, np.minimum(damping * _RETRIED, _MAX_DAMPING), damping)
            if better or (more == damping).all():  # more trials would be the same
                break
            damping = more
            failed |= near
        if not better:
            break
        gained = now.cost.sum() - there.cost.sum()
        postures, now = trial, there
        if iteration + 1 >= _MIN_ITERATIONS and gained < options.tolerance * now.cost.sum():
            break
    return postures


class PostureLinearisation(NamedTuple):
    """The terms of single postures near N postures of H hands with A servos each."""

    at: Array  # (N, H, A) the postures
    squares: Array  # (N,) the sums of the squares of all residuals
    gradient: Array  # (N, H, A) half the gradient of these
    blocks: Array  # (N, H, A, A) the products of the Jacobian of each hand with itself
    pressing: Array  # (N, H, A) the changes of controls that press keys
    close: Ids  # (M,) the postures in which hands are close to each other
    # (M, A, A) the products of the Jacobians of the right hand and the left in these
    between: Array

    def with_new(self, rows: Ids, new: PostureLinearisation) -> PostureLinearisation:
        """This linearisation with those of `new` postures in the rows (R,)."""
        kept = ~np.isin(self.close, rows)
        values = {
            "close": np.concatenate([self.close[kept], new.close]),
            "between": np.concatenate([self.between[kept], new.between]),
        }
        for name in ("at", "squares", "gradient", "blocks", "pressing"):
            values[name] = getattr(self, name).copy()
            values[name][rows] = getattr(new, name)
        return PostureLinearisation(**values)

    def gradient_change(self, change: Array) -> Array:
        """Change (N, H, A) of half the gradient with a change (N, H, A) of the postures."""
        added = (self.blocks @ change[..., None])[..., 0]
        if len(self.close):
            right, left = np.moveaxis(change[self.close], 1, 0)
            added[self.close, 0] += np.einsum("mrl,ml->mr", self.between, left)
            added[self.close, 1] += np.einsum("mrl,mr->ml", self.between, right)
        return added


class PostureEvaluation(NamedTuple):
    """The cost of N postures of H hands with A servos each, and its gradient."""

    # (N,) half the squares of all residuals; those of motion count at their last posture
    cost: Array
    gradient: Array  # (N, H, A) the gradient of the terms of single postures
    motion_residuals: tuple[Array, ...]  # (N, H, A) each: the residuals of the terms of motion
    # The linearisation at these postures or, where they have hardly moved, at earlier ones
    linearisation: PostureLinearisation


class PostureProblem:
    """The terms of postures 1 to S - 1 of H hands with A servos each."""

    def __init__(
        self, kinematics: Kinematics, targets: Targets, guess: Array, before: Array, dt: float
    ) -> None:
        """Set up the problem of `solve_postures`."""
        self._kinematics, scene, servos = kinematics, kinematics.scene, kinematics.servos
        self._hands = len(scene.sides)
        low, high, sigma, wall, self._force = (
            self._by_hand(values[1:, scene.present_fingers]) for values in targets
        )
        collisions = link_collisions(scene.hand)
        self._hand_terms = (
            TipsInBoxes(low, high, sigma),
            TipsBehindBlackKeys(wall),
            LinksApart(collisions.within_hand),
        )
        slides = servos.along_keyboard[: self._hands - 1]  # of the first of two hands
        self._pair_terms: tuple[HandLinksApart | ForearmsApart, ...] = (
            HandLinksApart(collisions),
            *(ForearmsApart(slide, scene.config.hand_spacing) for slide in slides),
        )
        self._rest, self._before = map(self._by_hand, (guess[1:], before[None]))
        self._motion = motion = motion_terms(servos, self._hands, dt, _REAL)
        # The part of the normal equations that is the same in each iteration.
        smoothness = motion.smoothness.weight + np.zeros_like(self._rest)
        self._constant = motion.smoothness.stencil.normal_equations(smoothness)
        self._constant[0] += motion.rest.weight

    def _by_hand(self, rows: Array) -> Array:
        """(N, H, X, ...) of rows (N, H X, ...)."""
        return by_hand(rows, self._hands).astype(_REAL)

    def linearisation(
        self, postures: Array, known: PostureLinearisation | None = None
    ) -> PostureLinearisation:
        """Linearisation at postures (S, A), or the `known` one if these are still near it."""
        if known is None:
            return self._linearised(postures[1:], np.arange(len(postures) - 1))
        far = np.abs(self._by_hand(postures[1:]) - known.at) > _MOVED * self._motion.stride
        moved = np.flatnonzero(far.any(axis=(1, 2)))
        if not len(moved):
            return known
        return known.with_new(moved, self._linearised(postures[1:][moved], moved))

    def evaluation(self, postures: Array, known: PostureLinearisation) -> PostureEvaluation:
        """Cost of postures (S, A) by a linearisation near them."""
        rows = np.concatenate([self._before, self._by_hand(postures)])
        change = rows[2:] - known.at
        added = known.gradient_change(change)
        squares = known.squares + ((2 * known.gradient + added) * change).sum(axis=(1, 2))
        motion = self._motion
        control = motion.control_range.stencil(rows) + known.pressing
        violation = control - clip(control, motion.low, motion.high)
        residuals = rows[2:] - self._rest, motion.smoothness.stencil(rows), violation
        weighted: Array = sum(
            term.weight * residual**2
            for term, residual in zip(motion.terms, residuals, strict=True)
        )
        cost = 0.5 * (squares + weighted.sum(axis=(1, 2)))
        return PostureEvaluation(cost, known.gradient + added, residuals, known)

    def _linearised(self, postures: Array, rows: Ids) -> PostureLinearisation:
        """Linearisation at the postures (N, A) after the first one, in rows (N,)."""
        parts = (slice(first, first + _AT_ONCE) for first in range(0, len(rows), _AT_ONCE))
        linearised = [self._linearised_at_once(postures[some], rows[some]) for some in parts]
        return PostureLinearisation._make(map(np.concatenate, zip(*linearised, strict=True)))

    def _linearised_at_once(self, postures: Array, rows: Ids) -> PostureLinearisation:
        links = self._kinematics.links(postures)
        # In the order of indices, which is the order of sums.
        points, tips = (np.ascontiguousarray(v, _REAL) for v in (links.points, links.tips))
        hands = PosedHands(rows, self._by_hand(postures), links._replace(points=points, tips=tips))
        residual, jacobian = stacked(term(hands) for term in self._hand_terms)
        squares = (residual**2).sum(axis=(1, 2))
        gradient = (residual[:, :, None] @ jacobian)[:, :, 0]
        blocks = jacobian.swapaxes(2, 3) @ jacobian
        close, residual, jacobian = self._terms_between_hands(hands)
        squares[close] += (residual**2).sum(axis=1)
        gradient[close] += (residual[:, None, None] @ jacobian)[:, :, 0]
        blocks[close] += jacobian.swapaxes(2, 3) @ jacobian
        between = jacobian[:, 0].swapaxes(1, 2) @ jacobian[:, -1]
        pressing = pressing_forces(tips[:, :, :, 2], self._force[rows]) * self._motion.per_force
        at = hands.postures
        return PostureLinearisation(at, squares, gradient, blocks, pressing, rows[close], between)

    def _terms_between_hands(self, hands: PosedHands) -> tuple[Ids, Array, Array]:
        """M postures in which hands are close, residuals (M, R), and Jacobian (M, H, R, A)."""
        near = np.flatnonzero(sum(term.near(hands) for term in self._pair_terms))
        if not len(near):
            _, count, size = hands.postures.shape
            return near, np.zeros((0, 0), _REAL), np.zeros((0, count, 0, size), _REAL)
        hands = hands.part(near)
        residual, jacobian = stacked(term(hands) for term in self._pair_terms)
        close = residual.any(axis=1)
        return near[close], residual[close], jacobian[close]

    def normal_equations(self, postures: Array, now: PostureEvaluation) -> tuple[Array, Array]:
        """Banded matrices, see `_banded`, and the gradient (S - 1, H, A).

        There is a matrix for each hand, or one for both where they come close to each other. Joints
        at the ends of their ranges that would go further are taken out.
        """
        gradient = now.gradient.copy()
        for term, residual in zip(self._motion.terms, now.motion_residuals, strict=True):
            term.stencil.add_gradient(gradient, term.weight * residual)
        rows = self._by_hand(postures[1:])
        outwards = np.where(gradient > 0, rows <= self._motion.low, rows >= self._motion.high)
        control_range, violation = self._motion.control_range, now.motion_residuals[-1]
        violated = control_range.weight * (violation != 0)
        diagonals = self._constant + control_range.stencil.normal_equations(violated)
        diagonals[0] += _FIXED * outwards
        return _banded(diagonals, now.linearisation), np.where(outwards, 0.0, gradient)

    def step(self, postures: Array, bands: Array, gradient: Array, damping: Array) -> Array:
        """The postures (S, A) after a step that is damped (S - 1,)."""
        change = self._solved(bands, gradient, damping).reshape(gradient.shape)
        change = clip(change, -self._motion.stride, self._motion.stride)
        moved = clip(self._by_hand(postures[1:]) + change, self._motion.low, self._motion.high)
        return np.concatenate([postures[:1], moved.reshape(len(moved), -1)])

    def _solved(self, bands: Array, gradient: Array, damping: Array) -> Array:
        """(S - 1, 1 or H, A or H A) the solution of the equations, damped (S - 1,)."""
        damped, shape = bands.copy(), (len(gradient), len(bands), -1)
        more = (damping[:, None, None] / self._motion.stride**2).reshape(shape)
        damped[..., -1] += more.swapaxes(0, 1)
        right_hand_side = -gradient.reshape(shape).swapaxes(0, 1)
        # Not `scipy.linalg.solveh_banded`, which takes as long to call it as short plans to solve.
        solve = lapack.spbsv if bands.dtype == np.float32 else lapack.dpbsv
        solution = np.empty_like(right_hand_side)
        for band, own, there in zip(damped, right_hand_side, solution, strict=True):
            _, x, failed = solve(band.reshape(-1, band.shape[-1]).T, own.ravel(), overwrite_ab=True)
            if failed:
                if bands.dtype == np.float64:
                    raise LinAlgError("the equations of postures are not positive definite")
                return self._solved(bands.astype(np.float64), gradient, damping)
            there[...] = x.reshape(there.shape)
        return solution.swapaxes(0, 1)


def _banded(diagonals: Array, at: PostureLinearisation) -> Array:
    """(1 or H, N, A, D) normal equations: D diagonals as in the upper form of `solveh_banded`.

    `diagonals` (3, N, H, A) are those of the terms of motion, see `Stencil.normal_equations`.
    """
    blocks = _joint_blocks(at) if len(at.close) else at.blocks
    count, parts, size = blocks.shape[:3]
    bands = np.zeros((parts, count, size, max(2 * size, _BLOCKED_DIAGONALS) + 1), blocks.dtype)
    row, column = _upper(size)
    bands[:, :, column, row - column - 1] = blocks.swapaxes(0, 1)[:, :, row, column]
    in_a_row = diagonals.reshape(3, count, parts, size).swapaxes(1, 2)
    for apart, diagonal in enumerate(in_a_row):
        bands[..., -1 - apart * size] += diagonal
    return bands


_upper = lru_cache(np.triu_indices)  # which takes as long as all else here if plans are short


def _joint_blocks(at: PostureLinearisation) -> Array:
    """(N, 1, 2 A, 2 A) the upper half of the blocks of both hands together."""
    count, hands, size = at.blocks.shape[:3]
    blocks = np.zeros((count, hands, size, hands, size), at.blocks.dtype)
    for hand in range(hands):
        blocks[:, hand, :, hand] = at.blocks[:, hand]
    blocks[at.close, 0, :, 1] = at.between
    return blocks.reshape(count, 1, hands * size, hands * size)
