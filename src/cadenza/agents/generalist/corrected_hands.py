"""The hands that play a plan, with corrections."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.networks.inputs import FAR, Corrections, HandInputs, InputLayout
from cadenza.agents.planner.search.networks.weights import Floats, Weights
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State


class CorrectedHands:
    """All H hands of a scene, which play a plan with corrections by networks.

    Attributes:
        lookahead: the number of steps of the plan that the networks' inputs depend on.
        servos: the hands' servos among all of the scene, which are all.
        corrections: the map from outputs of the networks to corrections of controls.
        layout: the meaning of each input of a hand.
        output: (H, A) the output for the step before: of the networks, or of what was played.
    """

    lookahead = FAR

    def __init__(self, plan: SongPlan, weights: Weights | None = None) -> None:
        """Follows a plan; `weights` are the networks by which hands act."""
        scene, self._weights = plan.scene, weights
        self._sides, self._fingers = scene.sides, scene.present_fingers
        self._alone = hand_alone(scene, self._sides[0]).scene
        self._all_servos, self.servos = servos_of(scene), scene.servos_on(*self._sides)
        self.corrections = Corrections.of(self._sides, self._alone)
        self.layout = InputLayout.of(self._alone)
        self.output = np.zeros_like(self.corrections.sign)
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Changes the plan, from `step` on, to one that goes further."""
        self._inputs = HandInputs(plan, self._sides, self._alone, step)
        self._tracking = plan.nominal.tracking

    def observe(self, step: int, state: State) -> tuple[Floats, Array]:
        """The networks' inputs (H, D) before a step, and the controls (H A,) that they correct."""
        (here,) = self._all_servos.state(state.hand_qpos[:1], state.hand_qvel[:1])
        planned = self._tracking.controls(self._all_servos, step, here)
        tips, key_qpos = state.fingertip_xpos[0, self._fingers], state.key_qpos[0]
        here = here.reshape(*self.output.shape, 2)
        return self._inputs.at(step, here, self.output, tips, key_qpos), planned

    def act(self, step: int, state: State) -> Array:
        """(H A,) the next controls."""
        assert self._weights is not None
        inputs, planned = self.observe(step, state)
        return self.corrected(planned, self._weights(inputs))

    def corrected(self, planned: Array, output: Floats) -> Array:
        """(H A,) the controls of a step: those planned (H A,), corrected by the output (H, A)."""
        ctrl = self._all_servos.clip(planned + self.corrections.ctrl(output).ravel())
        self.record(ctrl, planned)
        return ctrl

    def record(self, ctrl: Array, planned: Array) -> None:
        """Records the output of a step, given its controls (H A,) and those that were planned."""
        self.output = self.output_for(ctrl, planned)

    def output_for(self, ctrl: Array, planned: Array) -> Array:
        """(H, A) the output that corrects planned controls (H A,) to `ctrl` (H A,)."""
        return self.corrections.output((ctrl - planned).reshape(self.output.shape))
