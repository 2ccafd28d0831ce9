"""Simulations that a planner puts into any state, and rolls out."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.sim.hands_apart import HandsApart
from cadenza.sim.mujoco_simulation import PHYSICS_STATE, MujocoSimulation
from cadenza.sim.protocol import Simulation, State

Array = NDArray[np.float64]


def as_mujoco(simulation: Simulation) -> MujocoSimulation:
    """`simulation` itself, if a planner can copy its physical state.

    Raises CadenzaError if it runs in another engine, or its hands play apart.
    """
    if isinstance(simulation, HandsApart):
        raise CadenzaError(
            "this agent plans for hands in one scene, and these play apart: "
            "choose hands both, right or left, or another agent"
        )
    if not isinstance(simulation, MujocoSimulation):
        kind = type(simulation).__name__
        raise CadenzaError(
            f"this agent plans in MuJoCo and cannot start from a {kind}: choose the engine c, or "
            "another agent"
        )
    return simulation


class PlanningSimulation(MujocoSimulation):
    """N simulations that can be put into any state, and rolled out for several steps."""

    def rollout(self, ctrl: Array) -> State:
        """Take control steps (N, K, A) in every simulation, and return all states, (N, K).

        The result is that of K times `step`, but no simulation waits for another in between.
        """
        states = State.at_rest(self.scene, *ctrl.shape[:2])
        keys = self.scene.keyboard.num_keys
        paths = np.empty((*ctrl.shape[:2], self.num_substeps + 1, keys))

        def advance(i: int) -> None:
            for k in range(ctrl.shape[1]):
                self._advance(i, ctrl[i, k], None, paths[i, k])
                self._read(i, states, (i, k))

        self._threads.for_each(range(self.num_envs), advance)
        self._read_key_events(states, slice(None), paths)
        self._set_state(State._make(values[:, -1] for values in states))
        return states

    def copy_from(self, other: MujocoSimulation, env_id: int) -> None:
        """Put every simulation of this batch into the physical state of `other`'s `env_id`.

        Its scene is the same but for the physics timestep.
        """
        other.copy_to(self._data, env_id)
        model = self.scene.model
        if model.opt.timestep != other.scene.model.opt.timestep:
            for data in self._data:
                mujoco.mj_step1(model, data)  # how stiff constraints are depends on the timestep
        state = State.at_rest(self.scene, self.num_envs)
        for i in range(self.num_envs):
            self._read(i, state, i)
        self.state = state

    def set_joints(
        self, hand_qpos: Array, hand_qvel: Array, key_qpos: Array, key_qvel: Array | float = 0.0
    ) -> None:
        """Set the joints of every simulation of this batch, and reset everything else.

        Args:
            hand_qpos: (J,) [m, rad].
            hand_qvel: (J,) [m/s, rad/s].
            key_qpos: (K,) [rad].
            key_qvel: (K,) [rad/s].
        """

        def change(_: int, data: mujoco.MjData) -> None:
            mujoco.mj_resetData(self.scene.model, data)
            data.qpos[self.scene.hand_qpos] = hand_qpos
            data.qvel[self.scene.hand_qvel] = hand_qvel
            data.qpos[self.scene.key_qpos] = key_qpos
            data.qvel[self.scene.key_qpos] = key_qvel  # each key is one hinge

        self._change(change)

    def set_physics_state(self, state: Array) -> None:
        """Put every simulation of this batch into a state (S,) that `physics_state` returned.

        The state may come from another scene, which differs from this one in sleeping keys only.
        """

        def change(_: int, data: mujoco.MjData) -> None:
            mujoco.mj_resetData(self.scene.model, data)
            mujoco.mj_setState(self.scene.model, data, state, PHYSICS_STATE)

        self._change(change)

    def coordinates(self) -> Array:
        """(N, 2 V) positions and velocities of all V joints, keys and hands, in MuJoCo's order."""
        return np.array([np.concatenate([data.qpos, data.qvel]) for data in self._data])
