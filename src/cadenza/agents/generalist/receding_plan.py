"""Receding-horizon plans of a song whose next half second, or the next two, are known.

Fingers, presses, postures and controls are found as for a whole song, but again at every step for
what is in sight then. Each time postures begin with those of the plan before, which two steps of
Gauss-Newton improve: what is still lacking, the plans that follow make up for
(real-time iterations: Diehl, Bock & Schlöder, SIAM Journal on Control and Optimization 43, 2005).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from cadenza.agents.agent import Array, steps_in
from cadenza.agents.planner.plan.inverse_kinematics import THOROUGH, SolverOptions
from cadenza.agents.planner.plan.nominal_trajectory import (
    MotionPlanner,
    NominalTrajectory,
    PostureTrajectory,
)
from cadenza.agents.planner.plan.presses import Press, Strike
from cadenza.fingering.online import OnlineFingering
from cadenza.fingering.players import Players
from cadenza.fingers import NO_FINGER
from cadenza.scene.scene import Scene

# How far ahead, as far as it is in sight.
_POSTURES_AHEAD = 0.6  # [s]
_CONTROLS_AHEAD = 0.3  # [s]
_PRESSES_AHEAD = 1.3  # [s] whose presses matter to postures
_REMEMBERED = 0.5  # [s] of the past whose presses matter to them

# Gauss-Newton, usually and where a finger is lifted, which has far to go: derivatives that are kept
# take 0.7 of the time.
_LIFTED = SolverOptions(max_iterations=2, max_trials=0, tolerance=0.1, damping=10.0)
_USUAL = _LIFTED._replace(damping=20.0, keep_derivatives=True)
_SETTLED = 0.1  # of what is in sight, in which fingers do not change
_ONSETS_AT_ONCE = 12  # for which fingers are found together
# A finger that is caught is lifted, and presses again.
_CAUGHT = 0.012  # [m] beside where it should press
_LIFT_TIME = 0.15  # [s] until it presses again
_RETRY_TIME = 0.3  # [s] until it may be lifted once more


@dataclass
class _SightedNote:
    """A note that is in sight, or was."""

    key: int
    number: int
    first: int
    last: int | None = None
    """The step from which on it is not held; None as long as that is not in sight."""
    finger: int = NO_FINGER


class RecedingPlanner:
    """A planner that plans at every step what is in sight then.

    A finger that is not where it should press is lifted above all keys, and presses again.
    """

    def __init__(
        self, scene: Scene, motion: MotionPlanner, players: Players, hand_qpos: Array, dt: float
    ) -> None:
        """Begin without any notes, at joint positions (J,) [m, rad], in steps of `dt` [s]."""
        self._scene, self._dt, self._motion = scene, dt, motion
        self._fingers = OnlineFingering(players, _ONSETS_AT_ONCE)
        self._notes: list[_SightedNote] = []
        self._held: dict[int, _SightedNote] = {}  # by key, at the end of what was seen
        self._seen = 0
        self._lifted: dict[tuple[int, int], int] = {}  # finger and key, and since when
        self._blas = ThreadpoolController()
        self._plan = self._motion.still(hand_qpos, 0)  # from its first step on, as what follows
        self._solved: PostureTrajectory | None = None

    def replan(
        self,
        step: int,
        keys: NDArray[np.bool_],
        strikes: Mapping[tuple[int, int], Strike],
        tips: Array,
    ) -> NominalTrajectory:
        """Plan what is in sight at a step; the plan's first step is this one.

        Args:
            step: the step of the song: 0, then always the next.
            keys: (S, K) the keys that should be down after this step and those after it.
            strikes: how keys are to begin to sound in these steps, by step and key.
            tips: (F, 3) positions of the fingertips [m].
        """
        self._update_notes(step, keys)
        self._find_fingers(step + max(1, round(_SETTLED * len(keys))))
        past = min(step, steps_in(_REMEMBERED, self._dt))
        horizon, ahead, controlled = (
            min(len(keys), steps_in(seconds, self._dt))
            for seconds in (_PRESSES_AHEAD, _POSTURES_AHEAD, _CONTROLS_AHEAD)
        )
        begin = step - past - 1  # the step that leads to state 0 of the presses
        presses = [
            press._replace(strike=strikes.get((begin + press.first, press.key)))
            for press in self._motion.presses(self._fingering(step, past, horizon))
        ]
        if self._solved is None:
            before, warm_start, options = self._plan, None, THOROUGH
        else:
            before = self._plan.part(0, 1)
            presses = self._lift_caught(presses, step, past, tips, before.fingertips[1])
            options = _LIFTED if self._lifted else _USUAL
            warm_start = self._solved.correction[2:]
            warm_start = np.concatenate([warm_start, warm_start[-1:]])  # as far as is planned now
        with self._blas.limit(limits=1):  # as in `MotionPlanner.plans`
            solved = self._motion.solve(
                before, presses, past, past + ahead, warm_start=warm_start, options=options
            )
            presses = [press.delayed(-past) for press in presses]
            self._plan = self._motion.track(before, presses, solved.part(controlled + 1), played=1)
        self._solved = solved
        return self._plan

    def _lift_caught(
        self, presses: list[Press], step: int, now: int, tips: Array, planned: Array
    ) -> list[Press]:
        """Presses, which begin again from above where a finger is caught elsewhere.

        `now` is the state before the step, as presses count them. Fingertips are at `tips` (F, 3);
        those of the hands in the scene were to be at `planned` (F', 3) [m].
        """
        there, off = self._scene.present_fingers, np.zeros(len(tips))
        off[there] = np.hypot(*(tips[there] - planned)[:, :2].T)
        lift, wait = steps_in(_LIFT_TIME, self._dt), steps_in(_RETRY_TIME, self._dt)
        lifted = {press: since for press, since in self._lifted.items() if step < since + wait}
        result = []
        for press in presses:
            place = press.finger, press.key
            if press.first <= now < press.last:
                if off[press.finger] > _CAUGHT:
                    lifted.setdefault(place, step)
                if place in lifted:
                    first = max(press.first, now + lifted[place] + lift - step)
                    press = press._replace(first=first, from_above=True, strike=None)
            if press.first < press.last:
                result.append(press)
        self._lifted = lifted
        return result

    def _update_notes(self, step: int, keys: NDArray[np.bool_]) -> None:
        """Begin and end notes in what was not in sight before."""
        dt = self._dt
        for now, row in enumerate(keys[self._seen - step :], start=self._seen):
            down = set(np.flatnonzero(row).tolist())
            for key in self._held.keys() - down:
                note = self._held.pop(key)
                note.last = now
                self._fingers.end(note.number, (now - 0.5) * dt)  # in the middle of a step
            for key in sorted(down - self._held.keys()):
                note = _SightedNote(key, self._fingers.begin(key, now * dt), now)
                self._held[key] = note
                self._notes.append(note)
        self._seen = step + len(keys)

    def _find_fingers(self, settled: int) -> None:
        """Find fingers of notes, and settle them for notes that begin before a step."""
        fingers = self._fingers.find(settled * self._dt)
        for note in self._notes:
            if note.number in fingers:
                note.finger = self._scene.fingers.number(fingers[note.number])

    def _fingering(self, step: int, past: int, ahead: int) -> NDArray[np.int8]:
        """Fingers (P + S, K) that should press the keys before and after a step, -1 for none."""
        first = step - past
        self._notes = [note for note in self._notes if note.last is None or note.last > first]
        fingers = np.full((past + ahead, self._scene.keyboard.num_keys), NO_FINGER, np.int8)
        for note in self._notes:
            end = None if note.last is None else note.last - first
            fingers[max(note.first - first, 0) : end, note.key] = note.finger
        return fingers
