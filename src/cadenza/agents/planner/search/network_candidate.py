"""The candidate of a search that networks compute."""

from __future__ import annotations

from collections.abc import Iterator

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.networks.inputs import Corrections, HandInputs
from cadenza.agents.planner.search.networks.weights import Weights
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts


class NetworkCandidate:
    """Corrections of one hand's plan by networks that were trained on other songs.

    The networks act step by step on the state that the rollout of their own controls has reached.
    """

    def __init__(self, plan: SongPlan, side: Side, weights: Weights, first: int) -> None:
        """Prepares inputs for the steps of a plan from `first` on, as far as it goes."""
        alone, servos, _ = hand_alone(plan.scene, side)
        self._inputs = HandInputs(plan, [side], alone, first)
        self._weights, self._corrections = weights, Corrections.of([side], alone)
        self._tracking, self._servos = plan.nominal.tracking.of(servos), servos_of(alone)

    def controls(
        self, simulator: HandRollouts, step: int, planned: Array, previous: Array, key_qpos: Array
    ) -> Iterator[Array]:
        """The controls (A,) of each of H steps, for a rollout in slot 0 that is made with them.

        Args:
            simulator: the simulator of this hand.
            step: the first of the steps.
            planned: (H, A) the controls of the plan, without feedback.
            previous: (A,) the correction of the controls of the step before.
            key_qpos: (K,) the angles of all keys before the first step [rad].
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
