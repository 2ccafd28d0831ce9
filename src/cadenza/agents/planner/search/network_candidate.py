"""The candidate of a search that networks compute."""

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


class NetworkCandidate:
    """Corrections of one hand's plan by networks that were trained on other songs.

    The networks act step by step on the state that the rollout of their own controls has reached.
    """

    def __init__(self, plan: SongPlan, side: Side, weights: Weights, first: int) -> None:
        """Args:
        plan: of the song, as far as it goes.
        side: of the hand.
        weights: of the networks.
        first: the first step of the song that may be asked for.
        """
        alone, servos, _ = hand_alone(plan.scene, side)
        self._inputs = HandInputs(plan, [side], alone, first)
        self._weights, self._corrections = weights, Corrections.of([side], alone)
        self._tracking, self._servos = plan.nominal.tracking.of(servos), servos_of(alone)

    def controls(
        self, simulator: HandRollouts, step: int, planned: Array, previous: Array, key_qpos: Array
    ) -> Iterator[Array]:
        """(A,) the controls of each of H steps, for a rollout in slot 0 that is made with them.

        Args:
            simulator: of this hand.
            step: the first of the steps.
            planned: (H, A) their controls by the plan, without feedback.
            previous: (A,) the correction of the controls of the step before.
            key_qpos: (K,) of the whole keyboard before the first step [rad].
        """
        key_qpos, output = key_qpos.copy(), self._corrections.output(previous[None])
        for row, ctrl in enumerate(planned, step):
            state = simulator.servo_state()
            ctrl = self._servos.clip(ctrl - self._tracking.feedback(row, state))
            key_qpos[simulator.keys] = simulator.key_qpos()
            inputs = self._inputs.at(row, state[None], output, simulator.fingertips(), key_qpos)
            corrected = self._servos.clip(ctrl + self._corrections.ctrl(self._weights(inputs)))
            output = self._corrections.output(corrected - ctrl)
            yield corrected[0]


def network_candidate(
    plan: SongPlan, side: Side, weights: Weights | None, first: int
) -> NetworkCandidate | None:
    """A `NetworkCandidate`; None without networks, or with networks that other hands trained.

    The arguments are those of `NetworkCandidate`.
    """
    if weights is None or weights.sizes != sizes_of(plan.scene):
        return None
    return NetworkCandidate(plan, side, weights, first)
