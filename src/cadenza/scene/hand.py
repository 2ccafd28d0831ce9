"""Builds one Shadow Hand on its forearm from the figures in `shadow_hand`."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from cadenza.scene import shadow_hand as figures
from cadenza.scene.config import SceneConfig, Side
from cadenza.scene.piano import KEYBOARD_HALF_LENGTH
from cadenza.scene.shadow_hand import Geom, Joint, Link, Quaternion, Vector

_GEOM_TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
DRAWN_GROUP, COLLIDING_GROUP = 0, 3  # MuJoCo's viewers hide group 3
PALM_LINKS = ("palm", "lfmetacarpal")
"""What hides the keys from above: drawn so that one sees through it."""

_BODY_RGBA = (0.27, 0.30, 0.35, 1.0)
_LINK_RGBA = (0.80, 0.82, 0.85, 1.0)
FINGERTIP_RGBA = (0.36, 0.39, 0.45, 1.0)  # grey: colours are for what became of a key


def prefix(side: Side) -> str:
    """What the names of one hand's parts begin with."""
    return "rh_" if side == "right" else "lh_"


def add_hand(spec: mujoco.MjSpec, side: Side, config: SceneConfig) -> None:
    """Adds the hand of one `side` with its joints, actuators, fingertip sites and exclusions."""
    for link in figures.LINKS:
        body = _add_link(spec, side, link, config)
        if not link.parent:
            _mount(body, side, config)
        if link.joint and link.joint.name not in _removed(config):
            _add_joint(body, side, link.joint, config)
        _add_geoms(body, side, link, config)
    _add_fingertip_sites(spec, side)
    _add_actuators(spec, side, config)
    for first, second in figures.EXCLUDED_PAIRS:
        spec.add_exclude(bodyname1=prefix(side) + first, bodyname2=prefix(side) + second)


def _removed(config: SceneConfig) -> tuple[str, ...]:
    return figures.REMOVED_WHEN_REDUCED if config.reduced_action_space else ()


def _joint_range(joint: Joint, config: SceneConfig) -> tuple[float, float]:
    reduced = figures.REDUCED_RANGES if config.reduced_action_space else {}
    return reduced.get(joint.name, joint.range)


def _mirror(vector: Vector, side: Side) -> Vector:
    x, y, z = vector
    return vector if side == "right" else (-x, y, z)


def _mirror_axis(axis: Vector, side: Side) -> Vector:
    x, y, z = axis
    return axis if side == "right" else (x, -y, -z)


def _mirror_quat(quat: Quaternion, side: Side) -> Quaternion:
    w, x, y, z = quat
    return quat if side == "right" else (w, x, -y, -z)


def _add_link(spec: mujoco.MjSpec, side: Side, link: Link, config: SceneConfig) -> mujoco.MjsBody:
    # Each hand hangs from a body of its own, as in the published scene: sums are taken per root.
    if not link.parent:
        parent = spec.worldbody.add_body(name=f"{side}_hand")
    else:
        parent = spec.body(prefix(side) + link.parent)
    quat = _mirror_quat(link.quat, side)
    if side == "left" and link.left_quat:
        quat = link.left_quat
    return parent.add_body(
        name=prefix(side) + link.name,
        pos=_mirror(link.pos, side),
        quat=quat,
        mass=link.mass,
        ipos=link.com,
        inertia=link.inertia,
        iquat=link.inertia_quat,
        explicitinertial=True,
        gravcomp=float(config.gravity_compensation),
    )


def _mount(body: mujoco.MjsBody, side: Side, config: SceneConfig) -> None:
    """Places the forearm and gives it the degrees of freedom that were asked for."""
    sign = 1.0 if side == "right" else -1.0
    x, z = figures.MOUNT_XZ
    y = sign * config.hand_spacing / 2
    turn, final = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0, 1]), sign * np.deg2rad(config.attachment_yaw))
    mujoco.mju_mulQuat(final, turn, np.array(figures.MOUNT_QUAT))
    body.pos, body.quat = (x, y, z), final
    for name in config.forearm_dofs:
        dof = figures.FOREARM_DOFS[name]
        mirrored = dof.mirrored and side == "left"
        body.add_joint(
            name=f"{prefix(side)}forearm_{name}",
            type=mujoco.mjtJoint.mjJNT_HINGE if dof.hinge else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[-a for a in dof.axis] if mirrored else dof.axis,
            range=forearm_range(name, y),
            armature=figures.JOINT_ARMATURE,
            frictionloss=_friction_loss(config),
        )


def _friction_loss(config: SceneConfig) -> float:
    return 0.0 if config.physics == "fast" else figures.JOINT_FRICTION_LOSS


def forearm_range(name: str, y: float) -> tuple[float, float]:
    """Range of a forearm joint [m, rad]; a hand mounted at `y` reaches the whole keyboard."""
    if name == "tx":
        return -KEYBOARD_HALF_LENGTH - y, KEYBOARD_HALF_LENGTH - y
    return figures.FOREARM_DOFS[name].range


def _add_joint(body: mujoco.MjsBody, side: Side, joint: Joint, config: SceneConfig) -> None:
    axis = _mirror_axis(joint.axis, side)
    if side == "left" and joint.left_axis:
        axis = joint.left_axis
    body.add_joint(
        name=prefix(side) + joint.name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=axis,
        range=_joint_range(joint, config),
        damping=joint.damping,
        armature=figures.JOINT_ARMATURE,
        frictionloss=_friction_loss(config),
    )


def _add_geoms(body: mujoco.MjsBody, side: Side, link: Link, config: SceneConfig) -> None:
    finger = link.name.removesuffix("distal")
    tip = link.name.endswith("distal")
    drawn = figures.DRAWN.get(link.name)
    for geom in link.geoms:
        if tip and not config.primitive_fingertips:
            geom = figures.ROUND_FINGERTIPS[finger]
        _add_geom(
            body, side, geom,
            group=COLLIDING_GROUP if drawn else DRAWN_GROUP,
            rgba=FINGERTIP_RGBA if tip else _LINK_RGBA,
            contype=1,
            conaffinity=int(config.hand_collisions),
            solref=figures.CONTACT_SOLREF,
            solimp=figures.CONTACT_SOLIMP,
        )  # fmt: skip
    for geom in drawn or ():
        rgba = _BODY_RGBA if link.name in ("forearm", "wrist") else _LINK_RGBA
        _add_geom(body, side, geom, group=DRAWN_GROUP, rgba=rgba, contype=0, conaffinity=0)


def _add_geom(body: mujoco.MjsBody, side: Side, geom: Geom, **attributes: Any) -> None:
    pos, quat, size = geom.pos, geom.quat, geom.size
    if side == "left" and geom.mirrored:
        pos, quat = _mirror(pos, side), geom.left_quat or _mirror_quat(quat, side)
        size = geom.left_size or size
    padded = np.zeros(3)
    padded[: len(size)] = size
    body.add_geom(type=_GEOM_TYPES[geom.type], pos=pos, quat=quat, size=padded, **attributes)


def _add_fingertip_sites(spec: mujoco.MjSpec, side: Side) -> None:
    for finger, z in figures.FINGERTIP_Z.items():
        spec.body(f"{prefix(side)}{finger}distal").add_site(
            name=f"{prefix(side)}{finger}tip", pos=(0, 0, z), size=(0.004, 0.004, 0.004), group=4
        )


def _add_actuators(spec: mujoco.MjSpec, side: Side, config: SceneConfig) -> None:
    for finger in figures.COUPLED_FINGERS:
        tendon = spec.add_tendon(name=f"{prefix(side)}{finger}J0")
        for joint in (2, 1):
            tendon.wrap_joint(f"{prefix(side)}{finger}J{joint}", 1.0)
    ranges = {
        link.joint.name: _joint_range(link.joint, config) for link in figures.LINKS if link.joint
    }
    for actuator in figures.ACTUATORS:
        if actuator.target in _removed(config):
            continue
        coupled = actuator.target.endswith("J0")
        _add_servo(
            spec,
            name=f"{prefix(side)}A_{actuator.target}",
            target=prefix(side) + actuator.target,
            tendon=coupled,
            kp=actuator.kp,
            ctrlrange=figures.COUPLED_CONTROL_RANGE if coupled else ranges[actuator.target],
            force=actuator.force,
        )
    y = spec.body(prefix(side) + "forearm").pos[1]
    for name in config.forearm_dofs:
        _add_servo(
            spec,
            name=f"{prefix(side)}A_forearm_{name}",
            target=f"{prefix(side)}forearm_{name}",
            tendon=False,
            kp=figures.FOREARM_DOFS[name].kp,
            ctrlrange=forearm_range(name, y),
            force=None,
        )


def _add_servo(
    spec: mujoco.MjSpec,
    name: str,
    target: str,
    tendon: bool,
    kp: float,
    ctrlrange: tuple[float, float],
    force: float | None,
) -> None:
    actuator = spec.add_actuator(
        name=name,
        target=target,
        trntype=mujoco.mjtTrn.mjTRN_TENDON if tendon else mujoco.mjtTrn.mjTRN_JOINT,
        ctrlrange=ctrlrange,
    )
    actuator.set_to_position(kp=kp)
    if force is not None:
        actuator.forcerange = (-force, force)
