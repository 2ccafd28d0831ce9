"""The servos of the hands: what they move, and what stands against them.

All figures are read off the compiled model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cadenza.hands.body import SERVO
from cadenza.hands.forearm import ALONG_KEYBOARD
from cadenza.hands.servo import Servo
from cadenza.scene.scene import Scene, hand_on_keys

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Servos:
    """A servos of a scene, in its order, and J joints of the hands.

    A posture (A,) is given in the servos' coordinates. Joints that share a tendon have one
    coordinate, the sum of their angles, of which each takes an equal share.
    """

    names: tuple[str, ...]
    """Joint or tendon of each, without its side: "FFJ3", "forearm_tx"."""
    joints: Array
    """(A, J) what a unit of each coordinate adds to each joint [rad/rad, m/m]."""
    stiffness: Array
    """(A,) [N/m, N m/rad]."""
    damping: Array
    """(A,) [N s/m, N m s/rad]."""
    inertia: Array
    """(A,) with all other joints at rest [kg, kg m^2], in the posture of the compiled model; of an
    arm, where it begins."""
    low: Array
    """(A,) the range of the coordinate, and of its control [m, rad]."""
    high: Array
    """(A,)"""
    uses: tuple[Servo, ...]
    """What else is known of each."""

    @property
    def along_keyboard(self) -> list[int]:
        """Those that slide the forearms, the right one first."""
        return [a for a, name in enumerate(self.names) if name == ALONG_KEYBOARD]

    @cached_property
    def of_joints(self) -> Array:
        """(J, A) what makes coordinates of the joints' positions; the inverse of `joints`."""
        return np.asarray(np.linalg.pinv(self.joints), np.float64)

    @cached_property
    def noise(self) -> Array:
        """(A,) standard deviation of what planners try around their plans [m, rad]."""
        return np.array([use.noise for use in self.uses])

    @cached_property
    def correction(self) -> Array:
        """(A,) the most that a residual policy corrects each [m, rad]."""
        return np.array([use.correction for use in self.uses])

    @cached_property
    def lift(self) -> Array:
        """(A,) what frees a hand that is caught between keys [m, rad]."""
        return np.array([use.lift for use in self.uses])

    @cached_property
    def finger(self) -> NDArray[np.intp]:
        """(A,) of its hand that each moves, 0 for the thumb, -1 for the whole hand."""
        return np.array([-1 if use.finger is None else use.finger for use in self.uses], np.intp)

    def clip(self, coordinates: Array) -> Array:
        """Positions or controls (..., A) within their ranges."""
        return within(coordinates, self.low, self.high)

    def lead(self, dt: float) -> Array:
        """(3, A) what three positions, `dt` [s] apart, count in a control that goes through them.

        It is held from the second to the third: where they are in the middle of that, and what
        damping and inertia make it run ahead of them.
        """
        damped = self.damping / self.stiffness / dt
        driven = self.inertia / self.stiffness / dt**2
        return np.array([driven, 0.5 - damped - 2 * driven, 0.5 + damped + driven])


def within(values: NDArray[Any], low: ArrayLike, high: ArrayLike) -> NDArray[Any]:
    """As `np.clip`, in half the time if they are few, which matters to plans of a few steps."""
    return np.minimum(np.maximum(values, low), high)


@lru_cache(maxsize=8)  # short plans ask again and again
def servos_of(scene: Scene) -> Servos:
    """The servos of a scene with hands."""
    model, dofs = scene.model, scene.hand_qvel
    joints = np.zeros((model.nu, len(scene.hand_joint_names)))
    for a in range(model.nu):
        target = model.actuator_trnid[a, 0]
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON:
            first = model.tendon_adr[target]
            pulled = model.wrap_objid[first : first + model.tendon_num[target]]
        else:
            pulled = np.array([target])
        joints[a, model.jnt_dofadr[pulled] - dofs.start] = 1.0 / len(pulled)
    names = tuple(name.split(SERVO, 1)[1] for name in scene.actuator_names)
    # Of a unit of speed, dissipation adds up over the joints of a coordinate. So does kinetic
    # energy, but for what joints of one tendon carry of each other.
    return Servos(
        names=names,
        joints=joints,
        stiffness=model.actuator_gainprm[:, 0].copy(),
        damping=joints**2 @ model.dof_damping[dofs] - model.actuator_biasprm[:, 2],
        inertia=joints**2 @ _inertia(scene)[dofs],
        low=model.actuator_ctrlrange[:, 0].copy(),
        high=model.actuator_ctrlrange[:, 1].copy(),
        uses=tuple(map(scene.hand.servo, names)),
    )


def _inertia(scene: Scene) -> Array:
    """(V,) of each degree of freedom with the others at rest: the diagonal of the mass matrix."""
    model = scene.model
    if scene.hand.body.mount is None:
        return model.dof_M0
    data = mujoco.MjData(model)
    data.qpos[scene.hand_qpos] = scene.hand_start
    mujoco.mj_forward(model, data)
    units, columns = np.eye(model.nv), np.zeros((model.nv, model.nv))
    for unit, column in zip(units, columns, strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    return np.diagonal(columns)


class Reaction:
    """What the motion of all joints asks of each servo beside its own inertia.

    A forearm that is pushed along the keyboard would leave its hand behind.
    """

    def __init__(self, scene: Scene, servos: Servos) -> None:
        """Args:
        scene: with hands. Gravity is compensated in its model.
        servos: of the scene.
        """
        self._servos, self._model = servos, hand_on_keys(scene, range(0), ())
        self._model.opt.gravity = 0.0
        self._data = mujoco.MjData(self._model)

    def along(self, postures: Array, dt: float) -> Array:
        """(T, A) [N, N m] by inverse dynamics: recursive Newton-Euler, MuJoCo's `mj_rne`, which
        leaves the inertia of motors to its caller.

        Of postures (T + 1, A), `dt` [s] apart; row t belongs to the step from posture t to t + 1.
        """
        servos, model, data = self._servos, self._model, self._data
        speed = np.gradient(postures, dt, axis=0)
        acceleration = np.zeros_like(postures)
        acceleration[1:-1] = np.diff(postures, n=2, axis=0) / dt**2
        force = np.zeros((len(postures) - 1, model.nv))
        rows = zip(*(a @ servos.joints for a in (postures, speed, acceleration)), strict=True)
        for t, (qpos, qvel, qacc) in enumerate(list(rows)[:-1]):
            data.qpos, data.qvel, data.qacc = qpos, qvel, qacc
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 1, force[t])
            force[t] += model.dof_armature * data.qacc
        return force @ servos.joints.T - servos.inertia * acceleration[:-1]
