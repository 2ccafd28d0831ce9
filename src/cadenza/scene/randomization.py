"""Domain randomization of models: one scene, scaled as real instruments and robots differ."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from copy import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.scene.scene import Scene

Factors = Mapping[str, NDArray[np.float64]]
"""Name of a scaled quantity, see `shapes` -> its factors."""

SCALED_FIELDS = {
    "mass": ("body_mass", "body_inertia"),
    "friction": ("geom_friction",),
    "joint_damping": ("dof_damping",),
    "joint_friction": ("dof_frictionloss",),
    "armature": ("dof_armature",),
    # Gain and bias alike, so that a servo comes to rest where it did.
    "servo_gain": ("actuator_gainprm", "actuator_biasprm"),
    "key_spring": ("jnt_stiffness",),
}
"""Name of a scaled quantity -> the fields of `mujoco.MjModel` that its factors multiply."""
_INERTIAL = {"mass", "armature"}  # MuJoCo has computed other fields from these
_COMPUTED = "body_subtreemass", "body_invweight0", "dof_invweight0", "tendon_invweight0"


def shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    """Name of a quantity that can be scaled -> the shape of its factors.

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
    """Set fields of `model`, a copy of that of `scene`, to the nominal ones times `factors`.

    Earlier factors of the same names are replaced. MuJoCo computes with `data`, which has to be
    reset afterwards.
    """
    for name, factor in factors.items():
        rows = scene.key_qpos if name == "key_spring" else slice(None)  # each key is one hinge
        for field in SCALED_FIELDS[name]:
            nominal = getattr(scene.model, field)[rows]
            getattr(model, field)[rows] = (nominal.T * factor).T
    if factors.keys() & _INERTIAL:
        mujoco.mj_setConst(model, data)


def affected_fields(names: Collection[str]) -> tuple[str, ...]:
    """The fields of a model that differ where quantities of these names are scaled.

    Those on which no motion depends are left out.
    """
    computed = _COMPUTED if _INERTIAL & set(names) else ()
    return (*(field for name in names for field in SCALED_FIELDS[name]), *computed)


def scaled_fields(scene: Scene, each: Iterable[Factors]) -> dict[str, NDArray[np.float32]]:
    """Name of a field that differs -> its values (M, ...) in M models, with `each` their factors.

    All have factors of the same names.
    """
    model, data = copy(scene.model), mujoco.MjData(scene.model)
    values: defaultdict[str, list[NDArray[np.float32]]] = defaultdict(list)
    for factors in each:
        scale(model, scene, factors, data)
        for name in affected_fields(factors):
            values[name].append(getattr(model, name).astype(np.float32))
    return {name: np.stack(rows) for name, rows in values.items()}


def sliding(scene: Scene) -> NDArray[np.bool_]:
    """(J,) whether each joint of the hands is a slide, not a hinge."""
    kinds = scene.model.jnt_type[scene.hand_qpos]  # each joint has one coordinate
    return np.asarray(kinds == mujoco.mjtJoint.mjJNT_SLIDE)
