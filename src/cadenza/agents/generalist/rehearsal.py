"""Plays a plan in a simulation, and changes it by how far fingertips were astray.

Nothing is drawn and nothing is chosen: it is iterative learning control over all that has been
planned. What comes of it serves twice: a plan that has been rehearsed is played better, and how it
is changed is what the networks learn to foresee.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.generalist.corrected_hand import CorrectedHand
from cadenza.agents.generalist.weights import Floats
from cadenza.agents.planning.correction import FURTHEST
from cadenza.agents.planning.hand_part import ASTRAY, HandPart
from cadenza.agents.planning.learning_control import changes
from cadenza.agents.planning.song_plan import SongPlan
from cadenza.fingers import SIDES, Side
from cadenza.scene.kinematics import TIP, Kinematics
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

_SHARE = 0.7  # of the changes that should be enough: nothing is as simple as they take it to be


class Answers(Protocol):
    """What corrects a hand."""

    def __call__(self, told: Floats, /) -> Floats:
        """(A,) of what is told of it (D,)."""


class Take(NamedTuple):
    """What came of S steps of one hand, of A servos."""

    told: Floats
    """(S, D) before each step."""
    changes: Array
    """(S, A) to the controls that were played, which would have been better."""
    better: Array
    """(S, A) what would have been the answers then."""


class Rehearsal:
    """Both hands in a simulation of their own."""

    def __init__(self, plan: SongPlan, start: State, answers: Answers) -> None:
        """Args:
        plan: of the song, as far as it goes.
        start: the first of its states is where the hands begin.
        answers: what corrects the plan as it is played.
        """
        self._answers, self._step = answers, 0
        self._ctrl = plan.nominal.tracking.ctrl[:0]
        dt = plan.track.config.control_timestep
        self._here, self._back = (PlanningSimulation(plan.scene, 1, dt) for _ in range(2))
        self._here.place(start.hand_qpos[0], start.hand_qvel[0], start.key_qpos[0])
        self._hands = [RehearsedHand(plan, side) for side in plan.scene.sides]

    def rehearsed(self, plan: SongPlan, times: int) -> SongPlan:
        """The plan with other controls, after it has been rehearsed so many times.

        Args:
            plan: goes further than the one before, whose changes it takes over.
            times: that the new part is played, each time from where the last time of the part
                before has come to.
        """
        first, ctrl = self._step, plan.nominal.tracking.ctrl.copy()
        ctrl[: len(self._ctrl)] = self._ctrl
        self._back.copy_from(self._here, 0)
        answers = [hand.corrected.answer for hand in self._hands]
        for _ in range(times):
            self._step = first
            self._here.copy_from(self._back, 0)
            for hand, answer in zip(self._hands, answers, strict=True):
                hand.corrected.answer = answer
            takes = self.play(with_controls(plan, ctrl))
            ctrl = ctrl.copy()
            for hand, take in zip(self._hands, takes, strict=True):
                there = ctrl[first:, hand.servos] + _SHARE * take.changes
                ctrl[first:, hand.servos] = hand.corrected.clip(there)
        self._ctrl = ctrl
        return with_controls(plan, ctrl)

    def play(self, plan: SongPlan, pushes: Array | None = None) -> list[Take]:
        """Goes on to where the plan ends: what came of it, for each hand.

        Args:
            plan: goes further than the one before.
            pushes: (T, A) what is added to the controls of both hands.
        """
        first, last = self._step, plan.nominal.num_steps
        for hand in self._hands:
            hand.begin(plan, first)
        ctrl = np.zeros((1, len(plan.scene.actuator_names)))
        for step in range(first, last):
            before = self._here.state
            for hand in self._hands:
                push = 0.0 if pushes is None else pushes[step, hand.servos]
                ctrl[0, hand.servos] = hand.act(step, before, self._answers, push)
            self._here.step(ctrl)
            for hand in self._hands:
                hand.note(self._here.state)
        self._step = last
        return [hand.take() for hand in self._hands]


class RehearsedHand:
    """One hand as it rehearses.

    Attributes:
        corrected: it.
        servos: which of all the scene's are this hand's.
    """

    def __init__(self, plan: SongPlan, side: Side) -> None:
        self._side, self._dt = side, plan.track.config.control_timestep
        self.corrected = CorrectedHand(plan, side)
        self.servos = self.corrected.servos
        alone = hand_alone(plan.scene, side).scene
        self._of_servos = servos_of(alone)
        self._kinematics = Kinematics(alone, self._of_servos)
        self._sigma = np.array([alone.hand.servo(name).noise for name in self._of_servos.names])
        self._fingers = plan.scene.fingers.of_hand(SIDES.index(side))

    def begin(self, plan: SongPlan, step: int) -> None:
        """Rehearses that plan from that step on."""
        self._plan, self._first = plan, step
        self.corrected.follow(plan, step)
        self._steps: list[tuple[Floats, Array, Array]] = []
        self._states: list[tuple[Array, Array]] = []

    def act(self, step: int, state: State, answers: Answers, push: Array | float) -> Array:
        """(A,) the next controls, with a `push` (A,) besides."""
        hand = self.corrected
        told, planned = hand.see(step, state)
        ctrl = hand.clip(planned + hand.corrections.ctrl(answers(told)) + push)
        hand.played(ctrl, planned)
        self._steps.append((told, planned, ctrl))
        return ctrl

    def note(self, state: State) -> None:
        """Keeps where the hand is after a step."""
        posture = self.corrected.posture(state)[:, 0]
        self._states.append((posture, state.fingertip_xpos[0, self._fingers].copy()))

    def take(self) -> Take:
        """What came of it since `begin`."""
        told, planned, played = (np.array(some) for some in zip(*self._steps, strict=True))
        postures, fingertips = (np.array(some) for some in zip(*self._states, strict=True))
        changed = self._changes(postures, fingertips)
        hand = self.corrected
        return Take(told, changed, hand.corrections.answer(hand.clip(played + changed) - planned))

    def _changes(self, postures: Array, fingertips: Array) -> Array:
        """(S, A) to controls that have led to postures (S, A) and fingertips (S, F, 3)."""
        part, after = HandPart(self._plan, self._side), slice(self._first + 1, None)
        off = part.fingertips[after] - fingertips
        far = np.linalg.norm(off, axis=2, keepdims=True)
        off *= FURTHEST / np.maximum(far, FURTHEST)
        motion = self._kinematics.fingers(postures)[1][:, :, TIP]
        gain = self._plan.nominal.tracking.of(self.servos).gain[self._first :]
        weight = part.weight[after][: len(off)] / ASTRAY
        return changes(off, weight, motion, gain, self._of_servos, self._sigma, self._dt)


def with_controls(plan: SongPlan, ctrl: Array) -> SongPlan:
    """The same plan with other controls (T, A)."""
    nominal = plan.nominal
    return plan._replace(nominal=nominal._replace(tracking=nominal.tracking._replace(ctrl=ctrl)))
