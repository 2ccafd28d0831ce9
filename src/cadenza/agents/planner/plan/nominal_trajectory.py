"""How the hands would play a song if everything went as modelled.

Presses, fingertips, postures, controls: inverse kinematics of the song, and what makes the servos
follow. No simulation is needed for it; `refinement` makes up for what is not modelled.

A song is planned in windows, one after the other, so that the first action does not wait for the
last note. The first is short, and each is longer than the one before, so that whoever plays has the
more in hand the longer the next one takes. A window begins with the posture, the motion and the
presses that the one before has come to, and looks further ahead than it is kept.
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

from cadenza.agents.agent import Progress, silent
from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.plan.fingertip_targets import Targets, by_hand, pressing, targets_of
from cadenza.agents.planner.plan.inverse_kinematics import (
    THOROUGH,
    Effort,
    rest_posture,
    solve_postures,
)
from cadenza.agents.planner.plan.presses import Press, presses_of
from cadenza.agents.planner.plan.release_times import let_go_in_time
from cadenza.agents.planner.plan.rest_poses import RestPoses
from cadenza.agents.planner.plan.tracking import Tracking, track
from cadenza.fingers import NO_FINGER
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import Scene
from cadenza.scene.servos import Reaction, Servos, servos_of

Array = NDArray[np.float64]

_LEAD = 0.15  # [s] before a press in which the first guess has the hand there
_SMOOTH = 0.1  # [s] standard deviation of the filter that smooths the first guess
_FIRST = 2.5  # [s] that the first window plans: who plays a second has rehearsed more than two
_MORE = 3.0  # times what has been planned is what the next one plans
_MOST = 26.0  # [s] that a window plans
_OVERLAP = 4.0  # [s] that it plans besides, and the next one plans again
_SETTLED = 0.5  # [s] before a window in which presses have ended that do not matter to it


class NominalTrajectory(NamedTuple):
    """A plan for the first T steps of a song, of a scene with A servos and F fingers.

    Its arrays are views of those of the whole song, which go on being written.
    """

    presses: list[Press]
    """That begin in these steps, by time."""
    postures: Array
    """(T + 1, A) in the servos' coordinates."""
    fingertips: Array
    """(T + 1, F, 3) [m]"""
    tracking: Tracking

    @property
    def num_steps(self) -> int:
        """T"""
        return len(self.postures) - 1

    @property
    def arrays(self) -> tuple[Array, ...]:
        """All of it but the presses."""
        return self.postures, self.fingertips, *self.tracking

    def part(self, first: int, last: int) -> NominalTrajectory:
        """The steps from `first` up to, not including, `last`: views, and no presses."""
        steps, states = slice(first, last), slice(first, last + 1)
        ctrl, gain, expected = self.tracking
        tracking = Tracking(ctrl[steps], gain[steps], expected[states])
        return NominalTrajectory([], self.postures[states], self.fingertips[states], tracking)


def nominal_plans(
    scene: Scene,
    keys: NDArray[np.bool_],
    fingers: NDArray[np.int8],
    hand_qpos: Array,
    dt: float,
    progress: Progress = silent,
    later: NDArray[np.integer] | int = 0,
    haste: float = 1.0,
) -> Iterator[NominalTrajectory]:
    """Plans how to play `keys` (T, K) with `fingers` (T, K), a window more each time.

    Args:
        scene: with one hand or two.
        keys: that should be down after each step.
        fingers: that should press them, -1 for none.
        hand_qpos: (J,) where the joints of the hands are.
        dt: control step [s].
        progress: is told of "postures".
        later: (T, H) by how many steps later than usual a hand lets go to be in time for what it
            presses in each step, or for all.
        haste: times the acceleration with which the hands are known to jump.

    Yields:
        The plan so far; the last one is the whole.
    """
    hands = Motion(scene, dt, haste)
    asked = np.where(keys & scene.has_fingers(fingers), fingers, np.int8(NO_FINGER))
    later = np.broadcast_to(later, (len(asked), len(scene.sides)))
    whole = hands.at_rest(hand_qpos, len(asked))
    plan, known = whole.part(0, 0), None
    while plan.num_steps < len(asked):
        # BLAS shares small products among threads, which takes longer, and other bits come out.
        with threadpool_limits(1):
            window, kept, known = hands.window(plan, asked, later, known, progress)
        last = plan.num_steps + kept
        there, here = whole.part(plan.num_steps, last), window.part(0, kept)
        for values, new in zip(there.arrays, here.arrays, strict=True):
            values[:] = new
        plan = whole.part(0, last)._replace(presses=_joined(plan, window, kept))
        yield plan


def forearm_places(scene: Scene, kinematics: Kinematics, rest: Array) -> Array:
    """(K, F) where a forearm is when one of its fingers presses a key at ease; `let_go_in_time`.

    `rest` is the posture (A,) in which fingers are at ease.
    """
    rest_y = np.zeros(scene.fingers.count)
    rest_y[scene.fingers_there] = kinematics.fingertips(rest[None])[0][0, :, 1]
    return scene.keyboard.centre[:, 1, None] - rest_y


def controls_along(
    scene: Scene,
    kinematics: Kinematics,
    servos: Servos,
    reaction: Reaction,
    targets: Targets,
    postures: Array,
    earlier: Array,
    start: Array,
    dt: float,
    played: int | None = None,
) -> tuple[Array, Tracking]:
    """The fingertips (S, F, 3) along postures, and controls that lead along them.

    Args:
        scene: with one hand or two.
        kinematics: of the scene.
        servos: of the scene.
        reaction: of their motion.
        targets: which say what is pressed with.
        postures: (S, A); the first is where the hands are.
        earlier: (E, A) those before the first, if there are any.
        start: (A, 2) positions and speeds of the servos.
        dt: control step [s].
        played: how many steps will be played by this plan, all by default. The controls of later
            ones do without what makes up for forces.
    """
    steps = len(postures) - 1 if played is None else played
    tips, jacobian = kinematics.fingertips(postures, slice(1, steps + 1))
    hands, pressed = len(scene.sides), targets.force[1 : steps + 1, scene.fingers_there]
    force = pressing(by_hand(jacobian[:, :, 2], hands), by_hand(pressed, hands))
    moving = np.concatenate([earlier, postures[: steps + 2]])
    along = reaction.along(moving, dt)[len(earlier) :][:steps]
    offset = np.zeros_like(postures[1:])
    offset[:steps] = (force.reshape(steps, -1) + along) / servos.stiffness
    return tips, track(servos, postures, start, offset, dt)


class Found(NamedTuple):
    """Postures (S, A) of hands that press keys; in the first one they are."""

    postures: Array
    guess: Array
    """(S, A) what they began with, and are near if they can."""
    targets: Targets
    """What they reach, as far as they can."""

    @property
    def improved(self) -> Array:
        """(S, A) by how much they differ from what they began with."""
        return self.postures - self.guess

    def part(self, last: int) -> Found:
        """The states up to, not including, `last`, as views."""
        return Found(self.postures[:last], self.guess[:last], self.targets.part(0, last))


class Motion:
    """Plans motions of the hands of a scene, in control steps of `dt` [s]."""

    def __init__(self, scene: Scene, dt: float, haste: float = 1.0) -> None:
        """Args:
        scene: with one hand or two.
        dt: control step [s].
        haste: as in `nominal_plans`.
        """
        self._scene, self._dt = scene, dt
        times = scene.hand.jump_times.hurried(haste)
        self._hand = replace(scene.hand, jump_times=times)
        self._servos = servos_of(scene)
        self._kinematics = Kinematics(scene, self._servos)
        self._reaction = Reaction(scene, self._servos)
        self._rest = rest_posture(self._servos)
        self._stances = RestPoses(scene, self._kinematics, self._servos, self._rest)
        self._places = forearm_places(scene, self._kinematics, self._rest)

    def at_rest(self, hand_qpos: Array, steps: int) -> NominalTrajectory:
        """Room for a plan of `steps` steps, which begins with hands that are still."""
        servos, fingers = len(self._servos.names), len(self._scene.fingertip_sites)
        tracking = Tracking(
            ctrl=np.zeros((steps, servos)),
            gain=np.zeros((steps, servos, 2)),
            expected=np.zeros((steps + 1, servos, 2)),
        )
        postures = np.zeros((steps + 1, servos))
        postures[0] = hand_qpos @ self._servos.of_joints
        tracking.expected[0, :, 0] = postures[0]
        return NominalTrajectory([], postures, np.zeros((steps + 1, fingers, 3)), tracking)

    def window(
        self,
        plan: NominalTrajectory,
        asked: NDArray[np.int8],
        later: NDArray[np.integer],
        known: Array | None,
        progress: Progress,
    ) -> tuple[NominalTrajectory, int, Array]:
        """A plan for the steps after `plan`, how many of them to keep, and what is `known` then.

        Args:
            plan: of the first steps.
            asked: (T, K) fingers that should press the keys, -1 for none.
            later: (T, H), as in `nominal_plans`.
            known: what the window before found for these steps, as in `found`.
            progress: is told of "postures".
        """
        first, dt = plan.num_steps, self._dt
        kept = min(max(round(_MORE * first), steps_in(_FIRST, dt)), steps_in(_MOST, dt))
        last = min(first + kept + steps_in(_OVERLAP, dt), len(asked))
        if last == len(asked):
            kept = last - first
        since = _begin_of_presses(asked, first, steps_in(_SETTLED, dt))
        presses = self.presses(asked[since:last], later[since:last])
        found = self.found(plan, presses, first - since, last - since, progress, known)
        window = self.led_along(plan, presses, found)
        presses = [p._replace(first=p.first + since, last=p.last + since) for p in presses]
        return window._replace(presses=presses), kept, found.improved[kept + 1 :]

    def presses(self, asked: NDArray[np.int8], later: NDArray[np.integer] | int = 0) -> list[Press]:
        """By time, as far as the hands can be there.

        Args:
            asked: (T, K) fingers that should press the keys, -1 for none.
            later: (T, H), or for all, as in `nominal_plans`.
        """
        sides, wanted = self._scene.sides, presses_of(asked >= 0, asked, self._scene.fingers)
        if np.any(later):
            later = np.broadcast_to(later, (len(asked), len(sides)))
            wanted = [
                press._replace(later=int(later[press.first - 1, sides.index(press.side)]))
                for press in wanted
            ]
        is_black = self._scene.keyboard.is_black
        return let_go_in_time(wanted, self._places, is_black, self._dt, self._hand)

    def found(
        self,
        plan: NominalTrajectory,
        presses: list[Press],
        first: int,
        last: int,
        progress: Progress = silent,
        known: Array | None = None,
        effort: Effort = THOROUGH,
    ) -> Found:
        """Where hands are to be before the steps from `first` to `last`, and after the last.

        Args:
            plan: of the steps before, at least one posture.
            presses: that concern these steps.
            first: step, as presses count them.
            last: step; not included.
            progress: is told of "postures".
            known: (N, A) by how much postures after the first steps were `improved` before.
            effort: how long they are looked for.
        """
        dt, model = self._dt, (self._scene, self._kinematics, self._servos)
        targets = targets_of(self._scene, presses, last + 1, dt).part(first, last + 1)
        guess, before = self._guess(plan, presses, first, last), plan.postures[-2:][0]
        begin = guess
        if known is not None:
            begin = guess.copy()
            begin[1 : len(known) + 1] += known[: len(guess) - 1]
        postures = solve_postures(*model, targets, guess, before, dt, progress, begin, effort)
        return Found(postures, guess, targets)

    def led_along(
        self, plan: NominalTrajectory, presses: list[Press], found: Found, played: int | None = None
    ) -> NominalTrajectory:
        """What leads the hands along what was found to come after a plan.

        `played` is as in `controls_along`.
        """
        fingertips, tracking = controls_along(
            self._scene,
            self._kinematics,
            self._servos,
            self._reaction,
            found.targets,
            found.postures,
            plan.postures[-2:-1],
            plan.tracking.expected[-1],
            self._dt,
            played,
        )
        return NominalTrajectory(presses, found.postures, fingertips, tracking)

    def _guess(self, plan: NominalTrajectory, presses: list[Press], first: int, last: int) -> Array:
        """(S, A) hands at rest over the keys that they press or will press next, from `first` on.

        Its first row is where they are.
        """
        states, here = last + 1, plan.postures[-1]
        guess = np.tile(self._rest, (states, 1))
        lead, width = steps_in(_LEAD, self._dt), _SMOOTH / self._dt
        paths = {}
        for side in self._scene.sides:
            place, count = np.zeros(states), np.zeros(states)
            for press in presses:
                if press.side == side:
                    there = slice(max(press.first - lead, 0), press.last)
                    place[there] += self._places[press.key, press.finger]
                    count[there] += 1
            if plan.num_steps and not count[first]:
                place[first], count[first] = self._stances.place(here, side), 1
            if count.any():
                known = np.flatnonzero(count)
                paths[side] = np.interp(np.arange(states), known, place[known] / count[known])
        smooth = gaussian_filter1d(list(paths.values()), width, mode="nearest") if paths else ()
        for side, path in zip(paths, smooth, strict=True):
            self._stances.stand(guess, side, path)
        guess[first] = here
        return guess[first:]


def _begin_of_presses(asked: NDArray[np.int8], first: int, settling: int) -> int:
    """Before which row of `asked` no press began that matters from row `first` on.

    Those do not that ended `settling` rows before.
    """
    settled = max(first - settling, 0)
    held = asked[settled] >= 0
    changes = asked[:settled, held] != asked[settled, held]
    begins = [int(rows[-1]) + 1 if len(rows) else 0 for rows in map(np.flatnonzero, changes.T)]
    return max(min(begins, default=settled) - 1, 0)


def _joined(plan: NominalTrajectory, window: NominalTrajectory, steps: int) -> list[Press]:
    """The presses of `plan` and of the first steps of the window that follows."""
    first = plan.num_steps
    later = [
        press for press in window.presses if press.first <= first + steps and press.last > first
    ]
    since = min((press.first for press in later), default=first)
    settled = bisect_left(plan.presses, since, key=lambda press: press.first)
    known = {(press.first, press.key): press for press in plan.presses[settled:]}
    for press in later:
        begin = press.first, press.key
        # What comes before a press that had begun, the later window does not know.
        known[begin] = press._replace(flies_to=known.get(begin, press).flies_to)
    return plan.presses[:settled] + [known[begin] for begin in sorted(known)]
