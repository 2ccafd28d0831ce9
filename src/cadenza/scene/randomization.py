"""Models of one scene whose figures differ, as those of real instruments and robots do."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.scene.scene import Scene

Factors = Mapping[str, NDArray[np.float64]]
"""Name of what is scaled, see `shapes` -> its factors."""

_FIGURES = {
    "mass": ("body_mass", "body_inertia"),
    "friction": ("geom_friction",),
    "joint_damping": ("dof_damping",),
    "joint_friction": ("dof_frictionloss",),
    "armature": ("dof_armature",),
    # Gain and bias alike, so that a servo comes to rest where it did.
    "servo_gain": ("actuator_gainprm", "actuator_biasprm"),
    "key_spring": ("jnt_stiffness",),
}
_INERTIAL = {"mass", "armature"}  # from which MuJoCo has computed others


def shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    """Name of what can be scaled -> the shape of its factors.

    - mass (bodies,): mass and inertia of each body, keys included; the weight of the hands stays
      compensated where it is,
    - friction (): that of all contacts in common, because two surfaces that touch take the greater
      of theirs, and factors of their own would make it more on the whole,
    - joint_damping, joint_friction, armature (V,): damping, dry friction and motor inertia of each
      joint, keys included,
    - servo_gain (A,): of each servo, for position and speed alike,
    - key_spring (K,): the stiffness of each key's spring.

    Bodies, joints and servos are in the order of the model. Sizes, places, ranges and the limits of
    forces are not scaled.
    """
    model = scene.model
    return {
        "mass": (model.nbody,),
        "friction": (),
        "joint_damping": (model.nv,),
        "joint_friction": (model.nv,),
        "armature": (model.nv,),
        "servo_gain": (model.nu,),
        "key_spring": (scene.keyboard.num_keys,),
    }


def scale(model: mujoco.MjModel, scene: Scene, factors: Factors, data: mujoco.MjData) -> None:
    """Makes `model`, a copy of that of `scene`, differ from it by `factors` and nothing else.

    What the same names have scaled before is forgotten. `data` is used to compute with, and has to
    be reset afterwards.
    """
    for name, factor in factors.items():
        rows = scene.key_qpos if name == "key_spring" else slice(None)  # each key is one hinge
        for figure in _FIGURES[name]:
            nominal = getattr(scene.model, figure)[rows]
            getattr(model, figure)[rows] = (nominal.T * factor).T
    if factors.keys() & _INERTIAL:
        mujoco.mj_setConst(model, data)


def sliding(scene: Scene) -> NDArray[np.bool_]:
    """(J,) which joints of the hands slide instead of turning."""
    kinds = scene.model.jnt_type[scene.hand_qpos]  # each joint has one coordinate
    return np.asarray(kinds == mujoco.mjtJoint.mjJNT_SLIDE)
