"""Domain randomization of models: variations of one scene, like real pianos and robots."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from copy import copy
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of

Factors = Mapping[str, NDArray[np.float64]]
"""Name of a quantity, see `shapes` -> its factors, or offsets [m] or tilts [rad]."""

SCALED_FIELDS = {
    "mass": ("body_mass", "body_inertia"),
    "friction": ("geom_friction",),
    "joint_damping": ("dof_damping",),
    "joint_friction": ("dof_frictionloss",),
    "armature": ("dof_armature",),
    # Gain and bias alike, so that a servo comes to rest where it did.
    "servo_gain": ("actuator_gainprm", "actuator_biasprm"),
    "key_spring": ("jnt_stiffness",),
    "force_limit": ("actuator_forcerange",),
    "key_travel": ("jnt_range",),
}
"""Name of a scaled quantity -> the fields of `mujoco.MjModel` that its factors multiply."""
POSE_FIELDS = {
    "keyboard_offset": ("body_pos",),
    "keyboard_tilt": ("body_quat",),
    "mount_offset": ("body_pos",),
    "mount_tilt": ("body_quat",),
}
"""Name of a changed pose -> the field of `mujoco.MjModel` that has it."""
KEY_SOUNDING = "key_sounding"
"""The name of factors that no model has: of the depth from which each key sounds."""
_OF_KEYS = {"key_spring", "key_travel"}  # each key is one hinge
_INERTIAL = {"mass", "armature"}  # MuJoCo has computed other fields from these
_COMPUTED = "body_subtreemass", "body_invweight0", "dof_invweight0", "tendon_invweight0"


def shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    """Name of a quantity that can differ -> the shape of its factors, offsets or tilts.

    - mass (bodies,): mass and inertia of each body, keys included; the weight of the hands stays
      compensated where it is,
    - friction (): one factor for all contacts, because two surfaces that touch have the greater
      friction of both, and factors of their own would increase it on the whole,
    - joint_damping, joint_friction, armature (V,): damping, dry friction and motor inertia of each
      joint, keys included,
    - servo_gain (A,): of each servo, for position and speed alike,
    - key_spring, key_travel, key_sounding (K,): of each key the stiffness of its spring, its way
      down, and the part of the nominal way after which it sounds,
    - force_limit (A,): of each servo that has one,
    - keyboard_offset, keyboard_tilt (3,): place [m] and rotation vector [rad] of the keyboard,
    - mount_offset, mount_tilt (H, 3): the same of the base of each hand.

    Bodies, joints and servos are in the order of the model, axes those of the world. The keyboard
    turns about its middle. Sizes are not scaled.
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
        "force_limit": (model.nu,),
        "key_travel": (scene.keyboard.num_keys,),
        KEY_SOUNDING: (scene.keyboard.num_keys,),
        "keyboard_offset": (3,),
        "keyboard_tilt": (3,),
        "mount_offset": (len(scene.sides), 3),
        "mount_tilt": (len(scene.sides), 3),
    }


def scale(model: mujoco.MjModel, scene: Scene, factors: Factors, data: mujoco.MjData) -> None:
    """Change fields of `model`, a copy of the scene's, by `factors` from their nominal values.

    Earlier factors of the same names are replaced. MuJoCo computes with `data`, which has to be
    reset afterwards.
    """
    for name, factor in factors.items():
        if name in POSE_FIELDS:
            _displace(model, scene, name, factor)
        rows = scene.key_qpos if name in _OF_KEYS else slice(None)
        for field in SCALED_FIELDS.get(name, ()):
            nominal = getattr(scene.model, field)[rows]
            getattr(model, field)[rows] = (nominal.T * factor).T
    if factors.keys() & _INERTIAL:
        mujoco.mj_setConst(model, data)


def _displace(model: mujoco.MjModel, scene: Scene, name: str, by: NDArray[np.float64]) -> None:
    """Move or turn the keyboard, or the bases of the hands."""
    names = ["piano"] if name.startswith("keyboard") else [f"{side}_hand" for side in scene.sides]
    for body, offset in zip(names, by.reshape(-1, 3), strict=True):
        i = model.body(body).id
        if name.endswith("offset"):
            model.body_pos[i] = scene.model.body_pos[i] + offset
            continue
        turned, angle = np.zeros(4), float(np.linalg.norm(offset))
        mujoco.mju_axisAngle2Quat(turned, offset / (angle or 1.0), angle)
        mujoco.mju_mulQuat(model.body_quat[i], turned, scene.model.body_quat[i])


def affected_fields(names: Collection[str]) -> tuple[str, ...]:
    """The fields of a model that differ and change motion if quantities of these names do."""
    computed = _COMPUTED if _INERTIAL & set(names) else ()
    fields = SCALED_FIELDS | POSE_FIELDS
    return (*dict.fromkeys(f for name in names for f in fields.get(name, ())), *computed)


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


def with_servo_damping(scene: Scene, factors: NDArray[np.float64]) -> Scene:
    """The scene with the damping of the joints of each servo multiplied by factors (A,)."""
    moves = servos_of(scene).joints > 0  # (A, J)
    of_dofs = np.ones(scene.model.nv)
    of_dofs[scene.hand_qvel] = np.where(moves.any(axis=0), factors @ moves, 1.0)
    model = copy(scene.model)
    scale(model, scene, {"joint_damping": of_dofs}, mujoco.MjData(model))
    return replace(scene, model=model)
