"""Postures of the hands for a stretch of music, as one sparse least-squares problem.

The unknowns are all postures at once. Each term (`kinematic_terms`) concerns one posture or three
in a row, so that the normal equations are banded, and the time of a Gauss-Newton step is linear in
the length of the music. Where hands never come close to each other, the equations of each hand are
solved by themselves, in a quarter of the time. Only postures that have moved far enough are
linearised anew (fluid relinearisation: Kaess et al., iSAM2, International Journal of Robotics
Research 31, 2012).
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
_MOVED = 0.05  # of a servo's stride by which a posture moves before it is linearised anew
_BLOCKED_DIAGONALS = 68  # from which on LAPACK works in blocks: padding with zeros halves the time
_BATCH = 256  # postures that are linearised together, to save memory
_FIXED = 1e9  # weight that keeps a joint at the end of its range

# Levenberg-Marquardt: a step fails at a posture if its cost exceeds `_WORSE` times the last cost by
# more than `_WORSE_BY`. The damping there and beside it is multiplied by `_RETRIED` for the next
# trial or, if the step is taken all the same, by `_TIGHTENED`; elsewhere it is by `_EASED`.
_WORSE, _WORSE_BY = 1.02, 0.02
_RETRIED, _TIGHTENED, _EASED = 8, 4, 1 / 2
_MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e3
_MIN_ITERATIONS = 6  # the first ones may gain little because they are damped a lot


class SolverOptions(NamedTuple):
    """Parameters of the solver."""

    max_iterations: int  # the maximum number of steps
    # The maximum number of dampings to try in a step until the cost falls (Levenberg-Marquardt).
    # With 0, each step is taken, whatever its cost (Gauss-Newton without a line search).
    max_trials: int
    tolerance: float  # relative decrease of the cost with which the solver ends
    damping: float  # damping of the first step; without a line search, of all
    # Whether all steps without a line search use the derivatives of the first
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
        guess: (S, A) the postures to stay near; the first row is the current posture, and fixed.
        before: (A,) the posture before the current one.
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
    linearisation: PostureLinearisation | None = None
    for _ in range(options.max_iterations):
        if linearisation is None or not options.keep_derivatives:
            linearisation = problem.linearisation(postures)
        evaluation = problem.evaluation(postures, linearisation)
        bands, gradient = problem.normal_equations(postures, evaluation)
        previous, postures = postures, problem.step(postures, bands, gradient, damping)
        gain = 0.5 * np.vdot(gradient, (previous - postures)[1:])
        if gain < options.tolerance * evaluation.cost.sum():
            break
    return postures


def _levenberg_marquardt(
    problem: PostureProblem, postures: Array, options: SolverOptions, progress: Progress
) -> Array:
    """Levenberg-Marquardt with a damping of its own for each posture."""
    damping = np.full(len(postures) - 1, options.damping, _REAL)
    evaluation = problem.evaluation(postures, problem.linearisation(postures))
    for iteration in range(options.max_iterations):
        progress("postures", iteration, options.max_iterations)
        bands, gradient = problem.normal_equations(postures, evaluation)
        failed = np.zeros(len(damping), bool)
        for _ in range(options.max_trials):
            trial = problem.step(postures, bands, gradient, damping)
            trial_evaluation = problem.evaluation(
                trial, problem.linearisation(trial, evaluation.linearisation)
            )
            worse = trial_evaluation.cost > _WORSE * evaluation.cost + _WORSE_BY
            # Both ends count as neighbours: at sight, that plays a little better.
            near = worse | np.roll(worse, 1) | np.roll(worse, -1)
            better = trial_evaluation.cost.sum() < evaluation.cost.sum()
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
        gain = evaluation.cost.sum() - trial_evaluation.cost.sum()
        postures, evaluation = trial, trial_evaluation
        if iteration + 1 >= _MIN_ITERATIONS and gain < options.tolerance * evaluation.cost.sum():
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
        """This linearisation, with the `new` ones in rows (R,)."""
        unchanged = ~np.isin(self.close, rows)
        values = {
            "close": np.concatenate([self.close[unchanged], new.close]),
            "between": np.concatenate([self.between[unchanged], new.between]),
        }
        for name in ("at", "squares", "gradient", "blocks", "pressing"):
            values[name] = getattr(self, name).copy()
            values[name][rows] = getattr(new, name)
        return PostureLinearisation(**values)

    def gradient_change(self, change: Array) -> Array:
        """Change (N, H, A) of half the gradient with a change (N, H, A) of the postures."""
        result = (self.blocks @ change[..., None])[..., 0]
        if len(self.close):
            right, left = np.moveaxis(change[self.close], 1, 0)
            result[self.close, 0] += np.einsum("mrl,ml->mr", self.between, left)
            result[self.close, 1] += np.einsum("mrl,mr->ml", self.between, right)
        return result


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
        self, postures: Array, last: PostureLinearisation | None = None
    ) -> PostureLinearisation:
        """Linearisation at postures (S, A); the `last` one is reused where they are near it."""
        if last is None:
            return self._linearise(postures[1:], np.arange(len(postures) - 1))
        far = np.abs(self._by_hand(postures[1:]) - last.at) > _MOVED * self._motion.stride
        moved = np.flatnonzero(far.any(axis=(1, 2)))
        if not len(moved):
            return last
        return last.with_new(moved, self._linearise(postures[1:][moved], moved))

    def evaluation(self, postures: Array, near: PostureLinearisation) -> PostureEvaluation:
        """Cost of postures (S, A) by a linearisation near them."""
        rows = np.concatenate([self._before, self._by_hand(postures)])
        change = rows[2:] - near.at
        gradient_change = near.gradient_change(change)
        squares = near.squares + ((2 * near.gradient + gradient_change) * change).sum(axis=(1, 2))
        motion = self._motion
        control = motion.control_range.stencil(rows) + near.pressing
        violation = control - clip(control, motion.low, motion.high)
        residuals = rows[2:] - self._rest, motion.smoothness.stencil(rows), violation
        weighted: Array = sum(
            term.weight * residual**2
            for term, residual in zip(motion.terms, residuals, strict=True)
        )
        cost = 0.5 * (squares + weighted.sum(axis=(1, 2)))
        return PostureEvaluation(cost, near.gradient + gradient_change, residuals, near)

    def _linearise(self, postures: Array, rows: Ids) -> PostureLinearisation:
        """Linearisation at the postures (N, A) after the first one, in rows (N,)."""
        parts = (slice(first, first + _BATCH) for first in range(0, len(rows), _BATCH))
        batches = [self._linearise_batch(postures[part], rows[part]) for part in parts]
        return PostureLinearisation._make(map(np.concatenate, zip(*batches, strict=True)))

    def _linearise_batch(self, postures: Array, rows: Ids) -> PostureLinearisation:
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

    def normal_equations(
        self, postures: Array, evaluation: PostureEvaluation
    ) -> tuple[Array, Array]:
        """Banded matrices, see `_banded`, and the gradient (S - 1, H, A).

        There is a matrix for each hand, or one for both if they come close to each other. Joints
        that would leave their ranges are fixed.
        """
        gradient = evaluation.gradient.copy()
        for term, residual in zip(self._motion.terms, evaluation.motion_residuals, strict=True):
            term.stencil.add_gradient(gradient, term.weight * residual)
        rows = self._by_hand(postures[1:])
        outwards = np.where(gradient > 0, rows <= self._motion.low, rows >= self._motion.high)
        control_range, violation = self._motion.control_range, evaluation.motion_residuals[-1]
        violated = control_range.weight * (violation != 0)
        diagonals = self._constant + control_range.stencil.normal_equations(violated)
        diagonals[0] += _FIXED * outwards
        return _banded(diagonals, evaluation.linearisation), np.where(outwards, 0.0, gradient)

    def step(self, postures: Array, bands: Array, gradient: Array, damping: Array) -> Array:
        """The postures (S, A) after a step that is damped (S - 1,)."""
        change = self._solve(bands, gradient, damping).reshape(gradient.shape)
        change = clip(change, -self._motion.stride, self._motion.stride)
        moved = clip(self._by_hand(postures[1:]) + change, self._motion.low, self._motion.high)
        return np.concatenate([postures[:1], moved.reshape(len(moved), -1)])

    def _solve(self, bands: Array, gradient: Array, damping: Array) -> Array:
        """Solve the equations, damped by (S - 1,): (S - 1, 1 or H, A or H A)."""
        damped, shape = bands.copy(), (len(gradient), len(bands), -1)
        more = (damping[:, None, None] / self._motion.stride**2).reshape(shape)
        damped[..., -1] += more.swapaxes(0, 1)
        right_hand_side = -gradient.reshape(shape).swapaxes(0, 1)
        # Not `scipy.linalg.solveh_banded`, whose overhead is as long as short plans take to solve.
        solve = lapack.spbsv if bands.dtype == np.float32 else lapack.dpbsv
        solution = np.empty_like(right_hand_side)
        for band, right, result in zip(damped, right_hand_side, solution, strict=True):
            matrix = band.reshape(-1, band.shape[-1]).T
            _, x, failed = solve(matrix, right.ravel(), overwrite_ab=True)
            if failed:
                if bands.dtype == np.float64:
                    raise LinAlgError("the equations of postures are not positive definite")
                return self._solve(bands.astype(np.float64), gradient, damping)
            result[...] = x.reshape(result.shape)
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
    by_matrix = diagonals.reshape(3, count, parts, size).swapaxes(1, 2)
    for apart, diagonal in enumerate(by_matrix):
        bands[..., -1 - apart * size] += diagonal
    return bands


_upper = lru_cache(np.triu_indices)  # slow beside the rest for short plans


def _joint_blocks(at: PostureLinearisation) -> Array:
    """(N, 1, 2 A, 2 A) the upper half of the blocks of both hands together."""
    count, hands, size = at.blocks.shape[:3]
    blocks = np.zeros((count, hands, size, hands, size), at.blocks.dtype)
    for hand in range(hands):
        blocks[:, hand, :, hand] = at.blocks[:, hand]
    blocks[at.close, 0, :, 1] = at.between
    return blocks.reshape(count, 1, hands * size, hands * size)
