"""Derivatives of the simulation by finite differences."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.scene.scene import Scene
from cadenza.sim.mujoco_simulation import PHYSICS_STATE

Array = NDArray[np.float64]

EPSILON = 1e-8
"""Size of finite differences [m, rad, m/s, rad/s, actuator units]. Contacts and dry friction switch
so often that at 1e-6 the derivatives over a control step can be wrong by their own size."""


class Linearisation(NamedTuple):
    """States and derivatives after each of the P physics steps of T control steps.

    There are K keys, V joints of keys and hands, A actuators, and F fingers of two hands.
    """

    # (T, P, 2 V, 2 V + A) derivatives of positions and velocities by their values at the beginning
    # of the control step, and by the control that is held through it
    jacobian: Array
    key_qpos: Array  # (T, P, K) joint angles of the keys [rad]
    key_xpos: Array  # (T, P, K, 3) centres of the keys' boxes in the world [m]
    key_jacobian: Array  # (T, P, K, 3) their derivatives by the key's own joint [m/rad]
    # (T, P, F, 3) fingertips in the world [m]; zero for a hand that is not there
    fingertip_xpos: Array
    fingertip_jacobian: Array  # (T, P, F, 3, V) their derivatives by the joints


class Lineariser:
    """The linearisation of a scene along trajectories.

    A control is held through a control step of some physics steps. Each physics step is
    differentiated by `mujoco.mjd_transitionFD`, on a pool of threads with an `MjData` for each, and
    the products of these matrices give the derivatives over the control step. So the results are
    the same bits for any number of threads.
    """

    def __init__(
        self,
        scene: Scene,
        num_steps: int,
        num_substeps: int,
        num_threads: int = 1,
        centred: bool = False,
    ) -> None:
        """Allocate the derivatives of a trajectory of T control steps, each of P physics steps.

        Threads have data of their own. Centred differences take twice the time of forward ones.
        Raises CadenzaError if the keys of the scene can sleep.
        """
        if scene.config.sleeping_keys:
            raise CadenzaError(
                "MuJoCo cannot compute derivatives with sleeping keys: set sleeping_keys=False"
            )
        self.scene = scene
        self._shape = num_steps, num_substeps
        self._data = [mujoco.MjData(scene.model) for _ in range(num_steps * num_substeps)]
        self._rolled_out = mujoco.MjData(scene.model)
        self._pool, self._centred = ThreadPoolExecutor(num_threads), centred

    def linearise(self, state: Array, ctrl: Array) -> Linearisation:
        """States and derivatives along the trajectory of controls (T, A), each held for a step.

        It begins in `state` (S,), as `MujocoSimulation.physics_state` returns it.
        """
        states = self._roll_out(state, ctrl)
        transitions = np.array(list(self._pool.map(self._differentiate, self._data)))
        steps = np.split(transitions, self._shape[0])
        return states._replace(jacobian=np.array([list(_products(step)) for step in steps]))

    def _empty(self) -> Linearisation:
        model, shape = self.scene.model, self._shape
        keys, fingers = self.scene.keyboard.num_keys, self.scene.fingers.count
        return Linearisation(
            jacobian=np.empty(0),
            key_qpos=np.empty((*shape, keys)),
            key_xpos=np.empty((*shape, keys, 3)),
            key_jacobian=np.empty((*shape, keys, 3)),
            fingertip_xpos=np.zeros((*shape, fingers, 3)),
            fingertip_jacobian=np.zeros((*shape, fingers, 3, model.nv)),
        )

    def _roll_out(self, state: Array, ctrl: Array) -> Linearisation:
        """The states after each physics step; leaves the states before them in `_data`."""
        model, data, states = self.scene.model, self._rolled_out, self._empty()
        mujoco.mj_resetData(model, data)
        mujoco.mj_setState(model, data, state, PHYSICS_STATE)
        for row, before in zip(np.ndindex(self._shape), self._data, strict=True):
            data.ctrl = ctrl[row[0]]
            mujoco.mj_copyState(model, data, before, PHYSICS_STATE)
            mujoco.mj_step(model, data)
            self._read(states, row)
        return states

    def _read(self, states: Linearisation, row: tuple[int, int]) -> None:
        model, data, scene = self.scene.model, self._rolled_out, self.scene
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        keys = scene.key_qpos  # as all joints have one coordinate, these are their joints too
        states.key_qpos[row] = data.qpos[keys]
        states.key_xpos[row] = data.geom_xpos[scene.key_geoms]
        lever = states.key_xpos[row] - data.xanchor[keys]
        states.key_jacobian[row] = np.cross(data.xaxis[keys], lever)
        states.fingertip_xpos[row][scene.present_fingers] = data.site_xpos[scene.fingertip_sites]
        there = states.fingertip_jacobian[row][scene.present_fingers]
        for jacobian, site in zip(there, scene.fingertip_sites, strict=True):
            mujoco.mj_jacSite(model, data, jacobian, None, site)

    def _differentiate(self, data: Any) -> Array:
        """(2 V, 2 V + A) derivatives of one physics step."""
        model = self.scene.model
        by_state = np.empty((2 * model.nv, 2 * model.nv))
        by_ctrl = np.empty((2 * model.nv, model.nu))
        mujoco.mjd_transitionFD(model, data, EPSILON, self._centred, by_state, by_ctrl, None, None)
        return np.concatenate([by_state, by_ctrl], axis=1)


def _products(transitions: Array) -> Iterator[Array]:
    """Derivatives of each state by the first state, and by a control that is held throughout."""
    size = transitions.shape[1]
    product = np.eye(*transitions.shape[1:])
    for transition in transitions:
        product = transition[:, :size] @ product
        product[:, size:] += transition[:, size:]
        yield product
