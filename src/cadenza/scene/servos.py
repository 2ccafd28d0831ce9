"""The servos of the hands: their joints, stiffness, damping and inertia.

All figures come from the compiled model.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from cadenza.hands.body import SERVO
from cadenza.hands.forearm import ALONG_KEYBOARD
from cadenza.hands.servo import Servo
from cadenza.scene.scene import Scene, reduced_model

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Servos:
    """The A servos of a scene, in its order, which move the J joints of the hands.

    A posture (A,) is given in the servos' coordinates. Joints that share a tendon have one
    coordinate, the sum of their angles, and each takes an equal share of it. A joint that follows
    another moves with the coordinate of that one.
    """

    # Names of their joints or tendons, without the side, such as "FFJ3" and "forearm_tx"
    names: tuple[str, ...]
    joints: Array  # (A, J) derivative of the joints by each coordinate [rad/rad, m/m]
    stiffness: Array  # (A,) stiffness [N/m, N m/rad]
    damping: Array  # (A,) damping [N s/m, N m s/rad]
    # (A,) inertia with all other joints at rest [kg, kg m^2], in the posture of the compiled model
    # or that in which an arm begins
    inertia: Array
    low: Array  # (A,) lower bounds of the coordinates, and of their controls [m, rad]
    high: Array  # (A,) upper bounds [m, rad]
    slides: NDArray[np.bool_]  # (A,) whether each moves a slide [m], not a hinge [rad]
    uses: tuple[Servo, ...]  # the servos as planners and policies use them

    @property
    def along_keyboard(self) -> list[int]:
        """Indices of the servos that slide the forearms, the right one first."""
        return [a for a, name in enumerate(self.names) if name == ALONG_KEYBOARD]

    @cached_property
    def of_joints(self) -> Array:
        """(J, A) map from joint positions to coordinates: the pseudoinverse of `joints`."""
        with threadpool_limits(1):  # the last bits depend on how many threads share it
            return np.asarray(np.linalg.pinv(self.joints), np.float64)

    @cached_property
    def noise(self) -> Array:
        """(A,) standard deviations of planners' samples around their plans [m, rad]."""
        return np.array([use.noise for use in self.uses])

    @cached_property
    def correction(self) -> Array:
        """(A,) largest corrections by the generalist's networks [m, rad]."""
        return np.array([use.correction for use in self.uses])

    @cached_property
    def lift(self) -> Array:
        """(A,) motion that frees a hand caught between keys [m, rad]."""
        return np.array([use.lift for use in self.uses])

    @cached_property
    def finger(self) -> NDArray[np.intp]:
        """(A,) index of the finger that each moves, 0 for the thumb, -1 for the whole hand."""
        return np.array([-1 if use.finger is None else use.finger for use in self.uses], np.intp)

    def of_each(self, joint: float, slide: float) -> Array:
        """(A,) an angle of a hinge or a length of a slide, in the coordinates of the servos."""
        return np.where(self.slides, slide, joint) / np.abs(self.joints).max(axis=1)

    def state(self, hand_qpos: Array, hand_qvel: Array) -> Array:
        """(..., A, 2) position and speed of each servo at joints (..., J)."""
        return np.stack([hand_qpos @ self.of_joints, hand_qvel @ self.of_joints], axis=-1)

    def clip(self, coordinates: Array) -> Array:
        """`coordinates` (..., A), positions or controls, clipped to their ranges."""
        return clip(coordinates, self.low, self.high)

    def lead(self, dt: float) -> Array:
        """(3, A) weights of three positions, `dt` [s] apart, in the control that follows them.

        The control is held from the second position to the third. It aims at the middle between
        these, and leads as damping and inertia need.
        """
        damped = self.damping / self.stiffness / dt
        driven = self.inertia / self.stiffness / dt**2
        return np.array([driven, 0.5 - damped - 2 * driven, 0.5 + damped + driven])


def clip(values: NDArray[Any], low: ArrayLike, high: ArrayLike) -> NDArray[Any]:
    """`values` clipped as by `np.clip`, in half the time for the few of a short plan."""
    return np.minimum(np.maximum(values, low), high)


def sliding(scene: Scene) -> NDArray[np.bool_]:
    """(J,) whether each joint of the hands is a slide, not a hinge."""
    kinds = scene.model.jnt_type[scene.hand_qpos]  # each joint has one coordinate
    return np.asarray(kinds == mujoco.mjtJoint.mjJNT_SLIDE)


@lru_cache(maxsize=8)  # for short plans
def servos_of(scene: Scene) -> Servos:
    """The servos of a scene with hands."""
    model, dofs = scene.model, scene.hand_qvel
    joints = np.zeros((model.nu, len(scene.hand_joint_names)))
    for a in range(model.nu):
        target = model.actuator_trnid[a, 0]
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON:
            first = model.tendon_adr[target]
            moved = model.wrap_objid[first : first + model.tendon_num[target]]
        else:
            moved = np.array([target])
        joints[a, model.jnt_dofadr[moved] - dofs.start] = 1.0 / len(moved)
    for equality in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT):
        pair = [model.eq_obj1id[equality], model.eq_obj2id[equality]]
        follower, leader = model.jnt_dofadr[pair] - dofs.start
        joints[:, follower] = model.eq_data[equality, 1] * joints[:, leader]
    names = tuple(name.split(SERVO, 1)[1] for name in scene.actuator_names)
    # Dissipation at unit speed is a sum over the joints of a coordinate. So is kinetic energy,
    # except that joints of one tendon carry each other.
    return Servos(
        names=names,
        joints=joints,
        stiffness=model.actuator_gainprm[:, 0].copy(),
        damping=joints**2 @ model.dof_damping[dofs] - model.actuator_biasprm[:, 2],
        inertia=joints**2 @ _inertia(scene)[dofs],
        low=model.actuator_ctrlrange[:, 0].copy(),
        high=model.actuator_ctrlrange[:, 1].copy(),
        slides=joints @ sliding(scene) > 0,
        uses=tuple(map(scene.hand.servo, names)),
    )


def _inertia(scene: Scene) -> Array:
    """(V,) the diagonal of the mass matrix: inertia with all other joints at rest."""
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
    """Inverse dynamics: the force on each servo from the motion of all other joints.

    Without it, a forearm that is pushed along the keyboard would leave its hand behind.
    """

    def __init__(self, scene: Scene, servos: Servos) -> None:
        """Copy the model of a scene with hands, without gravity, which is compensated."""
        self._servos, self._model = servos, reduced_model(scene, range(0), ())
        self._model.opt.gravity = 0.0
        self._data = mujoco.MjData(self._model)

    def along(self, postures: Array, dt: float) -> Array:
        """(T, A) forces along a trajectory of postures (T + 1, A), `dt` [s] apart [N, N m].

        Row t belongs to the step from posture t to t + 1. By the recursive Newton-Euler algorithm,
        MuJoCo's `mj_rne`, which leaves out the inertia of motors.
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
