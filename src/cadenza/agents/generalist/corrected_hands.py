"""The hands that play a plan, with corrections."""

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.networks.inputs import FAR, Corrections, HandInputs, InputLayout
from cadenza.agents.planner.search.networks.weights import Floats, Weights
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State

MAX_LOWER = 1.5  # maximum change of a finger's height where it strikes [cm]
_CM = 0.01  # [m]


class CorrectedHands:
    """All H hands of a scene, which play a plan with corrections by networks.

    Attributes:
        lookahead: the number of steps of the plan that the networks' inputs depend on.
        servos: the hands' servos among those of the scene: all of them.
        corrections: the map from outputs of the networks to corrections of controls.
        layout: the meaning of each input of a hand.
        output: (H, A) the output for the step before: of the networks, or of the controls played.
    """

    lookahead = FAR

    def __init__(self, plan: SongPlan, weights: Weights | None = None) -> None:
        """Follow a plan; `weights` are the networks that correct it."""
        scene, self._weights = plan.scene, weights
        self._sides, self._fingers = scene.sides, scene.present_fingers
        self._alone = hand_alone(scene, self._sides[0]).scene
        self._all_servos, self.servos = servos_of(scene), scene.servos_on(*self._sides)
        self.corrections = Corrections.of(self._sides, self._alone)
        self.layout = InputLayout.of(self._alone)
        self._finger = servos_of(self._alone).finger
        self._is_finger = self._finger >= 0
        self.output = np.zeros_like(self.corrections.sign)
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a longer plan."""
        self._inputs = HandInputs(plan, self._sides, self._alone, step)
        self._tracking, self._lowering = plan.nominal.tracking, plan.nominal.lowering

    def observe(self, step: int, state: State) -> tuple[Floats, Array]:
        """Networks' inputs (H, D) before a step, and the controls (H A,) that they correct."""
        (servo_state,) = self._all_servos.state(state.hand_qpos[:1], state.hand_qvel[:1])
        planned_ctrl = self._tracking.controls(self._all_servos, step, servo_state)
        tips, key_qpos = state.fingertip_xpos[0, self._fingers], state.key_qpos[0]
        servo_state = servo_state.reshape(*self.output.shape, 2)
        return self._inputs.at(step, servo_state, self.output, tips, key_qpos), planned_ctrl

    def act(self, step: int, state: State) -> Array:
        """Next controls (H A,)."""
        assert self._weights is not None
        inputs, planned_ctrl = self.observe(step, state)
        output, striking = self._weights(inputs), self.striking(inputs)
        if self._weights.striking and striking.any():
            touch = self._weights.touch(inputs) * striking[..., None]
            planned_ctrl, output = self.touched(step, planned_ctrl, output, touch)
        return self.corrected(planned_ctrl, output)

    def striking(self, inputs: Floats) -> NDArray[np.bool_]:
        """Fingers (H, F) that strike in the step, by the inputs (H, D)."""
        return inputs[:, self.layout.striking] > 0

    def touched(
        self, step: int, planned_ctrl: Array, output: Floats, touch: Floats
    ) -> tuple[Array, Floats]:
        """Planned controls (H A,) of a step, and outputs (H, A), with touches (H, F, 2).

        The first value of a touch is how much lower the finger is led [cm]; the second is the share
        by which the correction of its servos is reduced. The correction of the whole hand is
        reduced by the mean share of the fingers that strike. Fingers that do not strike have 0.
        """
        lower = np.clip(touch[..., 0], -MAX_LOWER, MAX_LOWER) * _CM
        reduction, striking = np.clip(touch[..., 1], 0.0, 1.0), touch.any(axis=2)
        hand_reduction = reduction.sum(axis=1, keepdims=True) / np.maximum(
            striking.sum(axis=1, keepdims=True), 1
        )
        lower = np.where(self._is_finger, lower[:, self._finger], 0.0)
        lowered = planned_ctrl + self._lowering[step] * lower.ravel()
        share = 1 - np.where(self._is_finger, reduction[:, self._finger], hand_reduction)
        return self._all_servos.clip(lowered), output * share

    def corrected(self, planned_ctrl: Array, output: Floats) -> Array:
        """Controls (H A,) of a step: the planned ones (H A,), corrected by the output (H, A)."""
        ctrl = self._all_servos.clip(planned_ctrl + self.corrections.ctrl(output).ravel())
        self.record(ctrl, planned_ctrl)
        return ctrl

    def record(self, ctrl: Array, planned_ctrl: Array) -> None:
        """Record the output of a step, given its controls (H A,) and the planned ones."""
        self.output = self.output_for(ctrl, planned_ctrl)

    def output_for(self, ctrl: Array, planned_ctrl: Array) -> Array:
        """Output (H, A) that corrects planned controls (H A,) to `ctrl` (H A,)."""
        return self.corrections.output((ctrl - planned_ctrl).reshape(self.output.shape))
