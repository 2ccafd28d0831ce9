"""The nominal plan of a song: how hands would play it if everything went as modelled.

It has presses, fingertips, postures and controls: inverse kinematics of the song, and its tracking
by the servos. It needs no simulation; the search makes up for what is not modelled.

A song is planned in windows, one after the other, so that the first action does not wait for the
last note. The first window is short, and each is longer than the last: the longer it takes to plan,
the more music is left to play meanwhile. A window begins with the posture, the motion and the
presses at the end of the last one, and plans further ahead than it is kept.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Array, Progress, silent, steps_in
from cadenza.agents.planner.plan.fingertip_targets import (
    Targets,
    by_hand,
    pressing_forces,
    targets_of,
)
from cadenza.agents.planner.plan.inverse_kinematics import THOROUGH, SolverOptions, solve_postures
from cadenza.agents.planner.plan.presses import Press, presses_of
from cadenza.agents.planner.plan.releases import release_in_time
from cadenza.agents.planner.plan.rest_poses import RestPoses, forearm_places
from cadenza.agents.planner.plan.strike_model import NO_STRIKES, PlannedStrikes
from cadenza.agents.planner.plan.tracking import Tracking, track
from cadenza.fingers import Side
from cadenza.hands.reach import JumpTimes
from cadenza.rounding import check_rounding
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import Scene
from cadenza.scene.servos import Reaction

Fingering = NDArray[np.int8]
Delays = NDArray[np.integer] | int

# The first guess of inverse kinematics.
_ARRIVAL = 0.15  # [s] before a press by which the hand has arrived
_SMOOTHING = 0.1  # [s] standard deviation of the filter that smooths its path

_DAMPING = 2e-6  # [m^2] of `lowering`, for postures in which servos hardly lower the fingertip

# Windows.
_FIRST_WINDOW = 2.5  # [s] kept: to play one second, a hand rehearses more than two
_GROWTH = 3.0  # the length of the next window, as a multiple of the plan so far
_MAX_WINDOW = 26.0  # [s] kept
_OVERLAP = 4.0  # [s] beyond a window that it plans too, and the next one plans again
_SETTLED = 0.5  # [s] between the end of a press and a window that it does not influence


class NominalTrajectory(NamedTuple):
    """A plan for the first T steps of a song, of a scene with A servos and F fingers.

    Its arrays are views of those of the whole song, of which later windows are still written.
    """

    presses: list[Press]  # presses that begin in these steps, by time
    postures: Array  # (T + 1, A) the coordinates of the servos [m, rad]
    fingertips: Array  # (T + 1, F, 3) [m]
    tracking: Tracking
    # (T, A) the changes of servos that lower fingertips by 1 m after each step [rad/m]. Those of a
    # finger lower its own fingertip, and those of the whole hand are 0.
    lowering: Array

    @property
    def num_steps(self) -> int:
        """T, the number of control steps."""
        return len(self.postures) - 1

    @property
    def arrays(self) -> tuple[Array, ...]:
        """All arrays of the plan."""
        return self.postures, self.fingertips, *self.tracking, self.lowering

    def part(self, first: int, last: int) -> NominalTrajectory:
        """Steps from `first` up to, not including, `last`: views, and no presses."""
        steps, states = slice(first, last), slice(first, last + 1)
        ctrl, gain, expected = self.tracking
        tracking = Tracking(ctrl[steps], gain[steps], expected[states])
        return NominalTrajectory(
            [], self.postures[states], self.fingertips[states], tracking, self.lowering[steps]
        )


class PostureTrajectory(NamedTuple):
    """Postures (S, A) of hands that press keys; the first is the current posture."""

    postures: Array
    guess: Array  # (S, A) the first guess, which postures stay near
    targets: Targets  # the boxes of their fingertips

    @property
    def correction(self) -> Array:
        """Difference (S, A) from the first guess: a warm start for the next solution."""
        return self.postures - self.guess

    def part(self, last: int) -> PostureTrajectory:
        """States up to, not including, `last`, as views."""
        return PostureTrajectory(
            self.postures[:last], self.guess[:last], self.targets.part(0, last)
        )


class MotionPlanner:
    """A planner of motions of the hands of a scene, in control steps of `dt` [s].

    In all methods, `fingers` (T, K) are the numbers of the fingers that should hold the keys down
    after each step, -1 for none. `release_delays` (T, H) are the steps by which a hand releases
    keys later than usual before its strikes in each step: an array, or one number for all.
    """

    def __init__(self, scene: Scene, dt: float, jump_times: JumpTimes | None = None) -> None:
        """Prepare for a scene with one hand or two; `jump_times` replace the hand's."""
        check_rounding()
        self._scene, self._dt = scene, dt
        self._hand = replace(scene.hand, jump_times=jump_times or scene.hand.jump_times)
        self._kinematics = Kinematics(scene)
        self._servos = self._kinematics.servos
        self._reaction = Reaction(scene, self._servos)
        self._rest_poses = RestPoses(self._kinematics)
        self._forearm_places = forearm_places(self._kinematics)

    def plans(
        self,
        fingers: Fingering,
        hand_qpos: Array,
        progress: Progress = silent,
        release_delays: Delays = 0,
        strikes: PlannedStrikes = NO_STRIKES,
    ) -> Iterator[NominalTrajectory]:
        """Plan a song from joint positions (J,), and report the progress of "postures".

        `strikes` are the targets of timed strikes.

        Yields:
            The plan so far, a window longer each time; the last one is of the whole song.
        """
        steps, correction = len(fingers), None
        delays = np.broadcast_to(release_delays, (steps, len(self._scene.sides)))
        song = self.still(hand_qpos, steps)
        plan = song.part(0, 0)
        while (first := plan.num_steps) < steps:
            # In several threads, BLAS is slower for small products, and rounds differently.
            with threadpool_limits(1):
                window, length, correction = self._window(
                    plan, fingers, delays, strikes, correction, progress
                )
            last = first + length
            target, source = song.part(first, last), window.part(0, length)
            for values, new in zip(target.arrays, source.arrays, strict=True):
                values[:] = new
            plan = song.part(0, last)._replace(presses=_joined_presses(plan, window, length))
            yield plan

    def still(self, hand_qpos: Array, steps: int) -> NominalTrajectory:
        """Empty plan of `steps` steps, which begins with hands at rest."""
        servos, fingers = len(self._servos.names), len(self._scene.fingertip_sites)
        tracking = Tracking(
            ctrl=np.zeros((steps, servos)),
            gain=np.zeros((steps, servos, 2)),
            expected=np.zeros((steps + 1, servos, 2)),
        )
        postures = np.zeros((steps + 1, servos))
        postures[0] = hand_qpos @ self._servos.of_joints
        tracking.expected[0, :, 0] = postures[0]
        fingertips, lowering = np.zeros((steps + 1, fingers, 3)), np.zeros((steps, servos))
        return NominalTrajectory([], postures, fingertips, tracking, lowering)

    def _window(
        self,
        plan: NominalTrajectory,
        fingers: Fingering,
        delays: NDArray[np.integer],
        strikes: PlannedStrikes,
        warm_start: Array | None,
        progress: Progress,
    ) -> tuple[NominalTrajectory, int, Array]:
        """Plan the steps after `plan`.

        Returns the window, the number of its steps to keep, and the warm start of the next window.
        """
        first, dt = plan.num_steps, self._dt
        shortest, longest = steps_in(_FIRST_WINDOW, dt), steps_in(_MAX_WINDOW, dt)
        length = min(max(round(_GROWTH * first), shortest), longest)
        last = min(first + length + steps_in(_OVERLAP, dt), len(fingers))
        if last == len(fingers):
            length = last - first
        since = _first_relevant_row(fingers, first, steps_in(_SETTLED, dt))
        by_place = strikes.by_place(since, last)
        presses = [
            press._replace(strike=by_place.get((since + press.first - 1, press.key)))
            for press in self.presses(fingers[since:last], delays[since:last])
        ]
        solved = self.solve(plan, presses, first - since, last - since, progress, warm_start)
        window = self.track(plan, [press.delayed(since) for press in presses], solved)
        return window, length, solved.correction[length + 1 :]

    def presses(self, fingers: Fingering, release_delays: Delays = 0) -> list[Press]:
        """Presses by time, which end in time for the hands to reach their next ones."""
        sides, presses = self._scene.sides, presses_of(fingers, self._scene.fingers)
        if np.any(release_delays):
            delays = np.broadcast_to(release_delays, (len(fingers), len(sides)))
            presses = [
                press._replace(release_delay=int(delays[press.first - 1, sides.index(press.side)]))
                for press in presses
            ]
        is_black = self._scene.keyboard.is_black
        return release_in_time(presses, self._forearm_places, is_black, self._dt, self._hand)

    def solve(
        self,
        plan: NominalTrajectory,
        presses: list[Press],
        first: int,
        last: int,
        progress: Progress = silent,
        warm_start: Array | None = None,
        options: SolverOptions = THOROUGH,
    ) -> PostureTrajectory:
        """Find the postures from before step `first` to after step `last` - 1.

        The `presses` count steps in the same way. The `plan` of the steps before has one posture or
        more. `warm_start` (N, A) is the last `correction` of the first N postures.
        """
        dt = self._dt
        targets = targets_of(self._scene, presses, last + 1, dt).part(first, last + 1)
        guess, before = self._guess(plan, presses, first, last), plan.postures[-2:][0]
        begin = guess
        if warm_start is not None:
            begin = guess.copy()
            begin[1 : len(warm_start) + 1] += warm_start[: len(guess) - 1]
        postures = solve_postures(
            self._kinematics, targets, guess, before, dt, progress, begin, options
        )
        return PostureTrajectory(postures, guess, targets)

    def track(
        self,
        plan: NominalTrajectory,
        presses: list[Press],
        solved: PostureTrajectory,
        played: int | None = None,
    ) -> NominalTrajectory:
        """Find the controls that lead the hands along postures, after the steps of `plan`.

        Forces are compensated in the first `played` steps only, by default in all.
        """
        servos, postures, start = self._servos, solved.postures, plan.tracking.expected[-1]
        steps = len(postures) - 1 if played is None else played
        tips, jacobian = self._kinematics.fingertips(postures, slice(1, steps + 1))
        hands = len(self._scene.sides)
        press_force = solved.targets.force[1 : steps + 1, self._scene.present_fingers]
        heights = by_hand(jacobian[:, :, 2], hands)
        force = pressing_forces(heights, by_hand(press_force, hands))
        previous = plan.postures[-2:-1]
        trajectory = np.concatenate([previous, postures[: steps + 2]])
        reaction = self._reaction.along(trajectory, self._dt)[len(previous) :][:steps]
        offset = np.zeros_like(postures[1:])
        offset[:steps] = (force.reshape(steps, -1) + reaction) / servos.stiffness
        tracking = track(servos, postures, start, offset, self._dt)
        lowering = np.zeros_like(offset)
        lowering[:steps] = self._lowering(heights).reshape(steps, -1)
        return NominalTrajectory(presses, postures, tips, tracking, lowering)

    def _lowering(self, heights: Array) -> Array:
        """The `lowering` (S, H, A), given the Jacobian (S, H, F, A) of the heights of fingertips.

        It is the smallest change in units of the noise of the planner's search.
        """
        fingers, count = heights.shape[2:]
        noise, finger = self._servos.noise[:count], self._servos.finger[:count]
        down = -heights * noise * (finger == np.arange(fingers)[:, None])
        smallest = down / (np.square(down).sum(axis=-1, keepdims=True) + _DAMPING)
        return smallest.sum(axis=2) * noise

    def _guess(self, plan: NominalTrajectory, presses: list[Press], first: int, last: int) -> Array:
        """Rest postures (S, A) over the current or next keys, after the current posture."""
        states, current = last + 1, plan.postures[-1]
        lead = steps_in(_ARRIVAL, self._dt)
        paths = dict[Side, Array]()
        for side in self._scene.sides:
            place, count = np.zeros(states), np.zeros(states)
            for press in presses:
                if press.side == side:
                    rows = slice(max(press.first - lead, 0), press.last)
                    place[rows] += self._forearm_places[press.key, press.finger]
                    count[rows] += 1
            if plan.num_steps and not count[first]:
                place[first], count[first] = self._rest_poses.place(current, side), 1
            if count.any():
                knots = np.flatnonzero(count)
                paths[side] = np.interp(np.arange(states), knots, place[knots] / count[knots])
        if paths:  # filtered together, to save time
            width = _SMOOTHING / self._dt
            smooth = gaussian_filter1d(list(paths.values()), width, mode="nearest")
            paths = dict(zip(paths, smooth, strict=True))
        guess = self._rest_poses.at(paths, states)
        guess[first] = current
        return guess[first:]


def _first_relevant_row(fingers: Fingering, first: int, settling: int) -> int:
    """First row of `fingers` (T, K) with presses within `settling` rows before `first`."""
    settled = max(first - settling, 0)
    held = fingers[settled] >= 0
    changes = fingers[:settled, held] != fingers[settled, held]
    begins = [int(rows[-1]) + 1 if len(rows) else 0 for rows in map(np.flatnonzero, changes.T)]
    return max(min(begins, default=settled) - 1, 0)


def _joined_presses(plan: NominalTrajectory, window: NominalTrajectory, steps: int) -> list[Press]:
    """Presses of `plan` and of the first `steps` of the window that follows."""
    first = plan.num_steps
    later = [
        press for press in window.presses if press.first <= first + steps and press.last > first
    ]
    since = min((press.first for press in later), default=first)
    settled = bisect_left(plan.presses, since, key=lambda press: press.first)
    by_begin = {(press.first, press.key): press for press in plan.presses[settled:]}
    for press in later:
        begin = press.first, press.key
        # The window does not know what comes before a press that had begun.
        by_begin[begin] = press._replace(jumps_to=by_begin.get(begin, press).jumps_to)
    return plan.presses[:settled] + [by_begin[begin] for begin in sorted(by_begin)]
