"""One hand that plays a plan, with corrections."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planning.learnt.inputs import FAR, About, Corrections, HandInputs
from cadenza.agents.planning.learnt.weights import Floats, Weights
from cadenza.agents.planning.song_plan import SongPlan
from cadenza.agents.planning.tracking import Follower
from cadenza.fingers import SIDES, Side
from cadenza.scene.scene import hand_alone
from cadenza.sim.protocol import State


class CorrectedHand:
    """One hand, and what is corrected of its plan.

    Attributes:
        steps_seen: how many steps of the plan matter to one.
        servos: which of all the scene's are this hand's.
        corrections: how answers are read.
        about: what it is told.
        answer: (A,) by how much the step before was corrected.
    """

    steps_seen = FAR

    def __init__(self, plan: SongPlan, side: Side, weights: Weights | None = None) -> None:
        """`weights` are what corrects it, when it plays."""
        self._side, self._weights = side, weights
        self._alone, self.servos, self._joints = hand_alone(plan.scene, side)
        self._fingers = plan.scene.fingers.of_hand(SIDES.index(side))
        self.corrections = Corrections.of(side, self._alone)
        self.about = About.of(self._alone)
        self.answer = np.zeros(len(self.corrections.scale))
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """From that step on, by a plan that goes further than the one before."""
        self._inputs = HandInputs(plan, self._side, self._alone, self.servos, step)
        self._tracking = plan.nominal.tracking.of(self.servos)
        self._follower = Follower(self._alone, self._tracking)

    def posture(self, state: State) -> Array:
        """(A, 2) position and speed of its servos."""
        joints = state.hand_qpos[:1, self._joints], state.hand_qvel[:1, self._joints]
        (posture,) = self._follower.posture(*joints)
        return posture

    def see(self, step: int, state: State) -> tuple[Floats, Array]:
        """(D,) what is told before a step, and (A,) the controls that it corrects."""
        posture, tips = self.posture(state), state.fingertip_xpos[0, self._fingers]
        planned = self.clip(self._tracking.ctrl[step] - self._tracking.feedback(step, posture))
        told = self._inputs.at(step, posture, self.answer, tips, state.key_qpos[0])
        return told, planned

    def act(self, step: int, state: State) -> Array:
        """(A,) the next controls."""
        assert self._weights is not None
        inputs, planned = self.see(step, state)
        return self.corrected(planned, self._weights(inputs))

    def corrected(self, planned: Array, answer: Floats) -> Array:
        """(A,) the controls of a step, which are planned, with the networks' answer (A,) to it."""
        ctrl = self.clip(planned + self.corrections.ctrl(answer))
        self.played(ctrl, planned)
        return ctrl

    def clip(self, ctrl: Array) -> Array:
        """Controls (..., A) within their range."""
        return self._follower.clip(ctrl)

    def played(self, ctrl: Array, planned: Array) -> None:
        """Keeps how the controls (A,) of a step differ from those that were planned (A,)."""
        self.answer = self.corrections.answer(ctrl - planned)
