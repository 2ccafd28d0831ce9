"""The hands that play a plan, with corrections."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Follower
from cadenza.agents.planner.search.networks.inputs import FAR, Corrections, HandInputs, InputLayout
from cadenza.agents.planner.search.networks.weights import Floats, Weights
from cadenza.scene.scene import hand_alone
from cadenza.sim.protocol import State


class CorrectedHands:
    """All H hands of a scene, and what is corrected of their plan.

    Attributes:
        steps_seen: number of steps ahead that the networks' inputs need a plan of.
        servos: the hands' servos among all of the scene, which are all.
        corrections: what makes controls of the networks' answers.
        about: what each of a hand's inputs is about.
        answer: (H, A) the correction of the step before, as the networks answer.
    """

    steps_seen = FAR

    def __init__(self, plan: SongPlan, weights: Weights | None = None) -> None:
        """`weights` are those of the networks, which correct the hands when they act."""
        scene, self._weights = plan.scene, weights
        self._sides, self._fingers = scene.sides, scene.fingers_there
        self._alone = hand_alone(scene, self._sides[0]).scene
        self.servos = scene.servos_on(*self._sides)
        self.corrections = Corrections.of(self._sides, self._alone)
        self.about = InputLayout.of(self._alone)
        self.answer = np.zeros_like(self.corrections.sign)
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Plays on from a step by a plan that goes further than the one before."""
        self._inputs = HandInputs(plan, self._sides, self._alone, step)
        self._tracking = plan.nominal.tracking
        self._follower = Follower(plan.scene, self._tracking)

    def observe(self, step: int, state: State) -> tuple[Floats, Array]:
        """The networks' inputs (H, D) before a step, and the controls (H A,) that they correct."""
        (posture,) = self._follower.posture(state.hand_qpos[:1], state.hand_qvel[:1])
        planned = self._tracking.ctrl[step] - self._tracking.feedback(step, posture)
        tips, key_qpos = state.fingertip_xpos[0, self._fingers], state.key_qpos[0]
        posture = posture.reshape(*self.answer.shape, 2)
        inputs = self._inputs.at(step, posture, self.answer, tips, key_qpos)
        return inputs, self._follower.clip(planned)

    def act(self, step: int, state: State) -> Array:
        """(H A,) the next controls."""
        assert self._weights is not None
        inputs, planned = self.observe(step, state)
        return self.corrected(planned, self._weights(inputs))

    def corrected(self, planned: Array, answers: Floats) -> Array:
        """(H A,) the controls of a step: those planned (H A,), corrected by the answers (H, A)."""
        ctrl = self._follower.clip(planned + self.corrections.ctrl(answers).ravel())
        self.played(ctrl, planned)
        return ctrl

    def played(self, ctrl: Array, planned: Array) -> None:
        """Remembers the correction of a step: controls (H A,), less those that were planned."""
        self.answer = self.recommended(ctrl, planned)

    def recommended(self, ctrl: Array, planned: Array) -> Array:
        """(H, A) the answers that would make controls (H A,) of those that were planned."""
        return self.corrections.output((ctrl - planned).reshape(self.answer.shape))
