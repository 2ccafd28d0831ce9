"""Receding-horizon plans of a song of which only the next half second, or two, are known.

Fingers, presses, postures and controls are found as for a whole song, but again at every step for
the music then in sight. Two Gauss-Newton steps improve the postures of the last plan; later plans
continue from there (real-time iterations: Diehl, Bock & Schlöder, SIAM Journal on Control and
Optimization 43, 2005).
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

# How far it plans ahead, within sight.
_POSTURES_AHEAD = 0.6  # [s]
_CONTROLS_AHEAD = 0.3  # [s]
_PRESSES_AHEAD = 1.3  # [s] of presses that influence postures
_REMEMBERED = 0.5  # [s] of past presses that do

# Gauss-Newton, usually and for a lifted finger, which has far to go. Keeping derivatives takes 0.7
# of the time.
_LIFTED = SolverOptions(max_iterations=2, max_trials=0, tolerance=0.1, damping=10.0)
_USUAL = _LIFTED._replace(damping=20.0, keep_derivatives=True)
_SETTLED = 0.1  # share of the music in sight in which fingers no longer change
_ONSETS_AT_ONCE = 12  # onsets whose fingers are found together
# A caught finger is lifted, and presses again.
_CAUGHT = 0.012  # [m] beside its target
_LIFT_TIME = 0.15  # [s] until it presses again
_RETRY_TIME = 0.3  # [s] until it may be lifted once more


@dataclass
class _SightedNote:
    key: int
    number: int
    first: int
    last: int | None = None
    """The step from which on it is not held; None while that is out of sight."""
    finger: int = NO_FINGER


class RecedingPlanner:
    """A planner that plans the music in sight at every step.

    A finger that is caught beside its key is lifted above all keys, and presses again.
    """

    def __init__(
        self, scene: Scene, motion: MotionPlanner, players: Players, hand_qpos: Array, dt: float
    ) -> None:
        """Begin without any notes, at joint positions (J,) [m, rad], in steps of `dt` [s]."""
        self._scene, self._dt, self._motion = scene, dt, motion
        self._fingers = OnlineFingering(players, _ONSETS_AT_ONCE)
        self._notes: list[_SightedNote] = []
        self._held: dict[int, _SightedNote] = {}  # by key, at the end of the music seen so far
        self._seen = 0
        self._lifted: dict[tuple[int, int], int] = {}  # (finger, key) -> the step of the lift
        self._blas = ThreadpoolController()
        self._plan = self._motion.still(hand_qpos, 0)
        self._solved: PostureTrajectory | None = None

    def replan(
        self,
        step: int,
        keys: NDArray[np.bool_],
        strikes: Mapping[tuple[int, int], Strike],
        tips: Array,
    ) -> NominalTrajectory:
        """Plan the music in sight at a step, which is the first of the plan.

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
        begin = step - past - 1  # the step before state 0 of the presses
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
            warm_start = np.concatenate([warm_start, warm_start[-1:]])
        with self._blas.limit(limits=1):  # as in `MotionPlanner.plans`
            solved = self._motion.solve(
                before, presses, past, past + ahead, warm_start=warm_start, options=options
            )
            presses = [press.delayed(-past) for press in presses]
            self._plan = self._motion.track(before, presses, solved.part(controlled + 1), played=1)
        self._solved = solved
        return self._plan

    def _lift_caught(
        self, presses: list[Press], step: int, now: int, tips: Array, planned_tips: Array
    ) -> list[Press]:
        """Presses, in which fingers that are caught begin again from above.

        `now` is the state before the step, as presses count states. Fingertips are at `tips`
        (F, 3); the plan has those of the hands in the scene at `planned_tips` (F', 3) [m].
        """
        present, error = self._scene.present_fingers, np.zeros(len(tips))
        error[present] = np.hypot(*(tips[present] - planned_tips)[:, :2].T)
        lift, wait = steps_in(_LIFT_TIME, self._dt), steps_in(_RETRY_TIME, self._dt)
        lifts = {press: since for press, since in self._lifted.items() if step < since + wait}
        result = []
        for press in presses:
            finger_and_key = press.finger, press.key
            if press.first <= now < press.last:
                if error[press.finger] > _CAUGHT:
                    lifts.setdefault(finger_and_key, step)
                if finger_and_key in lifts:
                    first = max(press.first, now + lifts[finger_and_key] + lift - step)
                    press = press._replace(first=first, from_above=True, strike=None)
            if press.first < press.last:
                result.append(press)
        self._lifted = lifts
        return result

    def _update_notes(self, step: int, keys: NDArray[np.bool_]) -> None:
        """Begin and end notes in the steps that have come into sight."""
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
        """Find fingers of notes; those of notes before the step `settled` change no more."""
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
