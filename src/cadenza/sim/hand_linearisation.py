"""Derivatives of control steps by hands and controls, from finite differences."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.scene.scene import Scene
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

Array = NDArray[np.float64]


class HandLinearisation(NamedTuple):
    """Derivatives of T control steps of hands with J joints and A actuators, among K keys.

    They are by z = (positions, velocities, control), 2 J + A numbers, at the beginning of the step.
    """

    hands: Array
    """(T, 2 J, 2 J + A) derivatives of the hands' positions and speeds."""
    keys: Array
    """(T, K, 2 J + A) derivatives of the keys' angles."""
    fingertips: Array
    """(T, F, 3, 2 J + A) derivatives of the fingertips' positions."""
    states: State
    """States after the steps, arrays (T, ...)."""


class HandLineariser:
    """Linearises by finite differences as large as the deviations that are expected.

    `linearisation.Lineariser` differentiates every physics step, with differences so small that dry
    friction holds the joints.
    """

    def __init__(
        self, scene: Scene, difference: Array, control_timestep: float, num_threads: int = 1
    ) -> None:
        """Allocates a simulation for the nominal step, and one for each difference.

        Args:
            scene: a scene with hands, whose keys may sleep.
            difference: (2 J + A,) size of the difference of each element of z.
            control_timestep: time of a control step [s].
            num_threads: number of threads that share the work.
        """
        self._difference = difference
        self._joints = len(scene.hand_joint_names)
        self._displaced = np.concatenate([np.zeros((1, len(difference))), np.diag(difference)])
        self._nominal = PlanningSimulation(scene, 1, control_timestep)
        self._batch = PlanningSimulation(scene, 1 + len(difference), control_timestep, num_threads)

    def linearise(self, start: MujocoSimulation, ctrl: Array) -> HandLinearisation:
        """Linearises the steps that simulation 0 of `start` would take with controls (T, A)."""
        self._nominal.copy_from(start, 0)
        rows = [self._step(control) for control in ctrl]
        hands, keys, fingertips, states = zip(*rows, strict=True)
        joined = State._make(np.concatenate(parts) for parts in zip(*states, strict=True))
        return HandLinearisation(np.array(hands), np.array(keys), np.array(fingertips), joined)

    def _step(self, control: Array) -> tuple[Array, Array, Array, State]:
        batch, joints = self._batch, self._joints
        batch.copy_from(self._nominal, 0)
        batch.displace_hands(self._displaced[:, :joints], self._displaced[:, joints : 2 * joints])
        batch.step(control + self._displaced[:, 2 * joints :])
        self._nominal.step(control[None])
        state = batch.state
        hands = np.concatenate([state.hand_qpos, state.hand_qvel], axis=1)
        return (
            self._derivatives(hands),
            self._derivatives(state.key_qpos),
            self._derivatives(state.fingertip_xpos),
            self._nominal.state,
        )

    def _derivatives(self, values: Array) -> Array:
        """(..., 2 J + A) derivatives from values (1 + 2 J + A, ...)."""
        return np.moveaxis(values[1:] - values[0], 0, -1) / self._difference
