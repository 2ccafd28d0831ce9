"""What networks would have a hand do: the first candidate of a search."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.networks.inputs import Corrections, HandInputs, sizes_of
from cadenza.agents.planner.search.networks.weights import Weights
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts

Array = NDArray[np.float64]


class Proposal:
    """Corrects one hand's plan by networks that have learnt from other songs how to.

    They answer step by step to where a trial of their answers has come to.
    """

    def __init__(self, plan: SongPlan, side: Side, weights: Weights, first: int) -> None:
        """Args:
        plan: of the song, as far as it goes.
        side: of the hand.
        weights: of the networks.
        first: the first step that is proposed.
        """
        alone, servos, _ = hand_alone(plan.scene, side)
        self._inputs = HandInputs(plan, [side], alone, first)
        self._weights, self._corrections = weights, Corrections.of([side], alone)
        self._tracking, self._servos = plan.nominal.tracking.of(servos), servos_of(alone)

    def controls(
        self, trials: HandRollouts, step: int, planned: Array, before: Array, key_qpos: Array
    ) -> Iterator[Array]:
        """(A,) the controls of H steps, of a trial that is made with them.

        Args:
            trials: of this hand, in whose first place that is.
            step: the first of the steps.
            planned: (H, A) their controls by the plan, without feedback.
            before: (A,) by how much the controls of the step before them were corrected.
            key_qpos: (K,) of the whole keyboard before them [rad].
        """
        key_qpos, answer = key_qpos.copy(), self._corrections.answer(before[None])
        for row, ctrl in enumerate(planned, step):
            posture = self._servos.of_joints.T @ np.stack(trials.hand_joints(), axis=1)
            ctrl = self._servos.clip(ctrl - self._tracking.feedback(row, posture))
            key_qpos[trials.keys] = trials.key_qpos()
            told = self._inputs.at(row, posture[None], answer, trials.fingertips(), key_qpos)
            corrected = self._servos.clip(ctrl + self._corrections.ctrl(self._weights(told)))
            answer = self._corrections.answer(corrected - ctrl)
            yield corrected[0]


def proposal(plan: SongPlan, side: Side, weights: Weights | None, first: int) -> Proposal | None:
    """By networks; None if there are none, or if they have learnt with other hands.

    Args:
        plan: of the song, as far as it goes.
        side: of the hand.
        weights: of the networks.
        first: the first step that is proposed.
    """
    if weights is None or weights.sizes != sizes_of(plan.scene):
        return None
    return Proposal(plan, side, weights, first)
