"""Rehearsals of one hand: a second of its plan at a time, before it plays it.

In a take, the plan is played in simulation, with feedback. If that goes wrong, iterative learning
control changes the controls by how far fingertips were astray, and the hand tries again. Nothing is
drawn. The take that costs least is kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.horizon_cost import HorizonCost
from cadenza.agents.planner.search.iterative_learning_control import changes
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts

Array = NDArray[np.float64]

_SHARE = 0.7  # of the changes that should be enough: nothing is as simple as they take it to be
_SAME = 1e-3  # [m, rad] that joints may be off where a take had them


class RehearsalConfig(NamedTuple):
    """How a hand rehearses; by default, one that searches where that is not enough."""

    window: float = 1.0
    """[s] that are played as they were rehearsed at once."""
    judged: float = 0.2
    """[s] after them that count as well: the hand should be able to go on."""
    seen: float = 0.4
    """[s] after them whose fingertips are corrected, too."""
    takes: int = 5
    """At most."""
    left: float = 0.5
    """Of the mistakes that may be left: with more of them, fingers are caught, which a search frees
    sooner, and the plan is kept."""


_DEFAULT = RehearsalConfig()


class RehearsedRollout(NamedTuple):
    """What came of a rehearsal of S steps."""

    cost: float
    mistakes: int
    """How often a key was wrong."""
    fingertips: Array
    """(S, F, 3) after each step [m]."""
    sounding: NDArray[np.bool_]
    """(S, K) keys likewise, of those that the hand can reach."""
    hand_qpos: Array
    """(S, J) likewise [m, rad]."""
    keys: Array
    """(S, 2, K) positions and speeds of these keys likewise [rad, rad/s]."""


class HandRehearsal:
    """What a hand plays in the next steps, as it has been rehearsed.

    Attributes:
        steps_seen: how many steps of the plan are looked at.
        ends: the step from which on nothing has been rehearsed.
        beyond: (N, A) controls of the steps after that, of the take that is kept.
        keys_then: (2, K) positions and speeds of the keys near the hand then, by the take that is
            kept [rad, rad/s].
        keys: which these are.
    """

    def __init__(
        self, scene: Scene, trials: HandRollouts, dt: float, manner: RehearsalConfig = _DEFAULT
    ) -> None:
        """Args:
        scene: with this hand only.
        trials: of it.
        dt: control step [s].
        manner: how.
        """
        self._takes, self._left = manner.takes, manner.left
        self._servos, self._trials, self._dt = servos_of(scene), trials, dt
        self._window, self._judged = steps_in(manner.window, dt), steps_in(manner.judged, dt)
        self.steps_seen = self._window + steps_in(manner.seen, dt)
        self.forget()

    def forget(self) -> None:
        """As if nothing had been rehearsed."""
        self._first, self._ctrl = 0, np.zeros((0, len(self._servos.noise)))
        self._foreseen = np.zeros((0, 0))  # (N, J)
        self.beyond = self._ctrl
        self.keys, self.keys_then = slice(0), np.zeros((2, 0))

    @property
    def ends(self) -> int:
        return self._first + len(self._ctrl)

    def ctrl(self, step: int) -> Array:
        """(N, A) controls of the step and those after it, as far as they have been rehearsed."""
        return self._ctrl[step - self._first :]

    def foresaw(self, step: int, hand_qpos: Array) -> bool:
        """Whether a take without mistakes had the hand at (J,) before a step [m, rad]."""
        played = step - self._first
        if not 0 < played < len(self._foreseen):
            return False
        return bool(np.abs(hand_qpos - self._foreseen[played - 1]).max() < _SAME)

    def rehearse(self, tracking: Tracking, rows: NDArray[np.intp], ahead: HorizonCost) -> int:
        """Rehearses what comes next, from where trials begin: how many steps were simulated.

        Args:
            tracking: the plan, of this hand's servos.
            rows: (S,) its steps from here on, `steps_seen` or up to its end.
            ahead: what they ask of the hand.
        """
        ctrl = kept = tracking.ctrl[rows]
        best = take = self._play(ctrl, tracking, rows, ahead)
        most, simulated = self._left * take.mistakes, len(rows)
        for _ in range(self._takes - 1):
            if not take.mistakes:
                break
            ctrl = self._servos.clip(
                ctrl + _SHARE * self._changes(take, tracking.gain[rows], ahead)
            )
            take = self._play(ctrl, tracking, rows, ahead)
            simulated += len(rows)
            if take.cost < best.cost and take.mistakes <= most:
                kept, best = ctrl, take
        self._foreseen = best.hand_qpos[: 0 if best.mistakes else self._window]
        self._first, self._ctrl = int(rows[0]), kept[: self._window]
        self.beyond = kept[self._window :]
        self.keys, self.keys_then = self._trials.keys, best.keys[: self._window][-1]
        return simulated

    def _with_feedback(
        self, ctrl: Array, tracking: Tracking, rows: NDArray[np.intp]
    ) -> Iterator[Array]:
        """(A,) the controls of each step, by those (S, A) that are planned."""
        for row, planned in zip(rows, ctrl, strict=True):
            posture = self._servos.of_joints.T @ np.stack(self._trials.hand_joints(), axis=1)
            yield self._servos.clip(planned - tracking.feedback(row, posture))

    def _play(
        self, ctrl: Array, tracking: Tracking, rows: NDArray[np.intp], ahead: HorizonCost
    ) -> RehearsedRollout:
        """What comes of planned controls (S, A), with feedback."""
        controls = self._with_feedback(ctrl, tracking, rows)
        cost, mistakes, tips, qpos, keys = 0.0, 0, *(list[Array]() for _ in range(3))
        sounding, judged = [ahead.sounding], self._window + self._judged
        for k, (key_qpos, fingertips) in enumerate(self._trials.run(controls)):
            more, wrong, sounds = ahead.cost(k, key_qpos, fingertips, sounding[-1])
            if k < judged:
                cost, mistakes = cost + more, mistakes + wrong
            sounding.append(sounds)
            tips.append(fingertips)
            qpos.append(self._trials.hand_joints()[0].copy())
            keys.append(np.stack([key_qpos, self._trials.key_qvel()]))
        if self._trials.unstable():
            cost = np.inf
        return RehearsedRollout(cost, mistakes, *map(np.array, (tips, sounding[1:], qpos, keys)))

    def _changes(self, take: RehearsedRollout, gain: Array, ahead: HorizonCost) -> Array:
        """(S, A) to the controls of a take that would have been better."""
        off, weight = ahead.mending(take.fingertips, take.sounding)
        motion = self._trials.fingertip_motion(take.hand_qpos) @ self._servos.joints.T
        return changes(off, weight, motion, gain, self._servos, self._servos.noise, self._dt)
