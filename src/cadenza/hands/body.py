"""The body of a hand as tables of links, joints and servos, and its builder for MuJoCo.

The tables are the right hand's; the left hand is mostly its mirror image in the planes x = 0 of all
links, but for the few figures that are given for it. Lengths in [m], masses in [kg], angles in
[rad], quaternions w, x, y, z.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.configs import NotNegative, Positive
from cadenza.fingers import Side
from cadenza.hands import forearm
from cadenza.hands.shell import Shell

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Shape = Literal["sphere", "capsule", "cylinder", "box", "ellipsoid"]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)
LINK_RGBA = (0.80, 0.82, 0.85, 1.0)
CONTACT_SOLREF = (0.005, 1.0)
CONTACT_SOLIMP = (0.5, 0.99, 0.0001, 0.5, 2.0)

ROTOR = 2e-4
"""Inertia of a motor behind its gears [kg m^2], that of RoboPianist's hands (Zakka et al., 2023).

Without it, finger links of a few grams chatter on keys, and slide off them.
"""

GEOM_TYPES: dict[Shape, tuple[mujoco.mjtGeom, int]] = {
    "sphere": (mujoco.mjtGeom.mjGEOM_SPHERE, 1),
    "capsule": (mujoco.mjtGeom.mjGEOM_CAPSULE, 2),
    "cylinder": (mujoco.mjtGeom.mjGEOM_CYLINDER, 2),
    "box": (mujoco.mjtGeom.mjGEOM_BOX, 3),
    "ellipsoid": (mujoco.mjtGeom.mjGEOM_ELLIPSOID, 3),
}
"""Type of a `Geom` -> MuJoCo's type, and how many numbers its size has."""

SHAPES = {int(kind): (name, count) for name, (kind, count) in GEOM_TYPES.items()}
"""MuJoCo's type -> the type of a `Geom`, and how many numbers its size has."""

SERVO = "A_"  # prefix of the names of servos, before the name of the joint or tendon that they move


def prefix(side: Side) -> str:
    """The prefix of the names of one hand's bodies, joints, sites and actuators."""
    return "rh_" if side == "right" else "lh_"


@dataclass(frozen=True)
class Geom:
    """A shape fixed to a link; `mirrored` is False for the few that are the same on both hands."""

    type: Shape
    size: tuple[Positive, ...]
    pos: Vector = (0.0, 0.0, 0.0)
    quat: Quaternion = IDENTITY
    mirrored: bool = True
    left_size: tuple[Positive, ...] | None = None
    left_quat: Quaternion | None = None


@dataclass(frozen=True)
class Joint:
    """A hinge, or a slide along its axis.

    Mirrored, the axis (x, y, z) of a hinge is (x, -y, -z), unless `left_axis` is given, and that of
    a slide is (-x, y, z).
    """

    name: str
    axis: Vector
    range: tuple[float, float]
    damping: float = 0.05
    left_axis: Vector | None = None
    slide: bool = False
    armature: float | None = None
    """Its rotor inertia, if it is not that of the body's joints."""
    friction_loss: float | None = None
    """Its dry friction, if it is not that of the body's joints."""


@dataclass(frozen=True)
class Link:
    """A rigid link with at most one joint to its parent; the first, without parent, is mounted."""

    name: str
    parent: str
    pos: Vector
    mass: NotNegative
    com: Vector
    inertia: Vector
    inertia_quat: Quaternion = IDENTITY
    quat: Quaternion = IDENTITY
    left_quat: Quaternion | None = None
    joint: Joint | None = None
    geoms: tuple[Geom, ...] = ()
    """The shapes that collide."""
    round_geoms: tuple[Geom, ...] = ()
    """The shapes that collide instead if the fingertips are not to be primitive."""
    drawn: tuple[Shell, ...] = ()
    """The shapes that pages and films draw instead."""
    hides_keys: bool = False
    """Whether it is drawn transparent while it hides keys that sound."""


@dataclass(frozen=True)
class Actuator:
    """A position servo of gain `kp` [N m/rad] that can apply up to `force` [N m], None: any."""

    target: str
    """A joint or a coupling."""
    kp: Positive
    force: Positive | None
    kv: float = 0.0
    """The damping [N m s/rad]."""


@dataclass(frozen=True)
class Coupling:
    """A tendon that pulls joints together: its length is the sum of their angles."""

    name: str
    joints: tuple[str, ...]
    control_range: tuple[float, float]


@dataclass(frozen=True)
class Follower:
    """A joint without a motor, whose angle is always `ratio` times that of its leader."""

    joint: str
    leader: str
    ratio: float


@dataclass(frozen=True)
class HandOptions:
    """The options of a `SceneConfig` that concern the hands."""

    reduced_action_space: bool
    forearm_dofs: tuple[str, ...]
    hand_spacing: float
    attachment_yaw: float
    gravity_compensation: bool
    primitive_fingertips: bool
    hand_collisions: bool
    apart: bool
    dry_friction: bool
    touch: bool
    keyboard_half_length: float  # half the length of the keyboard [m]


@dataclass(frozen=True)
class Mount:
    """The place of the first link of a right arm, which does not slide.

    The left arm stands at the mirrored place with the same `quat`. It is a true mirror image only
    if the frame's x axis runs along the keyboard.
    """

    pos: Vector
    quat: Quaternion
    home: float
    """The hand's place along the keyboard while all servos are at rest [m]."""
    low: float
    """The lowest place that the arm brings its hand to, in the same posture [m]."""
    high: float
    """The highest such place [m]."""


@dataclass(frozen=True, eq=False)
class Body:
    """A right hand with its forearm, the first link; or with an arm on a `mount`."""

    links: tuple[Link, ...]
    actuators: tuple[Actuator, ...]
    couplings: tuple[Coupling, ...] = ()
    followers: tuple[Follower, ...] = ()
    excluded: tuple[tuple[str, str], ...] = ()
    """Pairs of links that do not collide, beside parents and children."""
    locked: tuple[str, ...] = ()
    """The joints that the reduced action space leaves out."""
    reduced_ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Ranges of joints in the reduced action space, where they differ."""
    mount: Mount | None = None
    """The mount of an arm; None for a forearm that slides."""
    mirrored_masses: bool = False
    """Whether the left hand's masses are mirrored. Those of the published hands are not."""
    armature: float = ROTOR
    """Rotor inertia of every joint [kg m^2], and of the forearm's slides [kg]."""
    friction_loss: float = 0.01
    """Dry friction of every joint [N m], and of the forearm's slides [N]."""


_CONTACT_BITS: dict[Side, int] = {"right": 8, "left": 16}  # bits of contype and conaffinity


class BodyBuilder:
    """The builder of the body of one hand in a scene, whose tables are of its side."""

    def __init__(self, body: Body, spec: mujoco.MjSpec, side: Side, options: HandOptions) -> None:
        self._body, self._spec, self._side, self._options = body, spec, side, options
        self._prefix = prefix(side)
        self._locked = body.locked if options.reduced_action_space else ()
        # Hands that play apart collide with themselves and with keys, but not with each other.
        self._own_bits = _CONTACT_BITS[side] if options.apart and options.hand_collisions else 0
        self._mount_y = forearm.mount_y(side, options.hand_spacing)
        dofs = () if body.mount else options.forearm_dofs
        self._forearm_joints = [self._forearm_joint(name) for name in dofs]
        self._forearm_actuators = [
            Actuator(f"{forearm.FOREARM}_{name}", forearm.JOINTS[name].kp, None) for name in dofs
        ]

    def build(self) -> None:
        """Add links, joints, geoms, tendons, actuators and exclusions."""
        ranges = {each.name: each.control_range for each in self._body.couplings}
        for link in self._body.links:
            body = self._add_link(link)
            if not link.parent:
                self._mount(body)
            for joint in self._joints_of(link):
                ranges[joint.name] = joint.range
                self._add_joint(body, joint)
            self._add_geoms(body, link)
        self._add_couplings()
        for actuator in (*self._body.actuators, *self._forearm_actuators):
            if actuator.target not in self._locked:
                self._add_servo(actuator, ranges[actuator.target])
        for first, second in self._body.excluded:
            self._spec.add_exclude(bodyname1=self._prefix + first, bodyname2=self._prefix + second)

    def _forearm_joint(self, name: str) -> Joint:
        dof = forearm.JOINTS[name]
        x, y, z = dof.axis
        return Joint(
            f"{forearm.FOREARM}_{name}",
            (-x, -y, -z) if dof.mirrored and self._side == "left" else dof.axis,
            forearm.joint_range(name, self._mount_y, self._options.keyboard_half_length),
            damping=0.0,
            slide=not dof.hinge,
        )

    def _joints_of(self, link: Link) -> list[Joint]:
        joints = [] if link.parent else list(self._forearm_joints)
        if link.joint and link.joint.name not in self._locked:
            reduced = self._body.reduced_ranges if self._options.reduced_action_space else {}
            limits = reduced.get(link.joint.name, link.joint.range)
            joints.append(replace(link.joint, range=limits))
        return joints

    def _add_link(self, link: Link) -> mujoco.MjsBody:
        # Each hand hangs from a body of its own, as in the published scene: sums are per root.
        if not link.parent:
            parent = self._spec.worldbody.add_body(name=f"{self._side}_hand")
        else:
            parent = self._spec.body(self._prefix + link.parent)
        return parent.add_body(
            name=self._prefix + link.name,
            pos=link.pos,
            quat=link.quat,
            mass=link.mass,
            ipos=link.com,
            inertia=link.inertia,
            iquat=link.inertia_quat,
            explicitinertial=True,
            gravcomp=float(self._options.gravity_compensation),
        )

    def _mount(self, body: mujoco.MjsBody) -> None:
        """Place the first link."""
        sign = 1.0 if self._side == "right" else -1.0
        if (mount := self._body.mount) is not None:
            x, y, z = mount.pos
            body.pos, body.quat = (x, sign * y, z), mount.quat
            return
        x, z = forearm.MOUNT_XZ
        yaw = sign * np.deg2rad(self._options.attachment_yaw)
        turn = np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0, 1]), yaw)
        body.pos, body.quat = (x, self._mount_y, z), product(turn, np.array(forearm.MOUNT_QUAT))

    def _add_joint(self, body: mujoco.MjsBody, joint: Joint) -> None:
        armature, loss = joint.armature, joint.friction_loss
        loss = self._body.friction_loss if loss is None else loss
        body.add_joint(
            name=self._prefix + joint.name,
            type=mujoco.mjtJoint.mjJNT_SLIDE if joint.slide else mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            range=joint.range,
            damping=joint.damping,
            armature=self._body.armature if armature is None else armature,
            frictionloss=loss if self._options.dry_friction else 0.0,
        )

    def _add_geoms(self, body: mujoco.MjsBody, link: Link) -> None:
        geoms = link.geoms
        if link.round_geoms and not self._options.primitive_fingertips:
            geoms = link.round_geoms
        for geom in geoms:
            kind, count = GEOM_TYPES[geom.type]
            body.add_geom(
                type=kind,
                pos=geom.pos,
                quat=geom.quat,
                size=(*geom.size, *[0.0] * (3 - count)),
                rgba=LINK_RGBA,
                contype=1 | self._own_bits,
                conaffinity=self._own_bits or int(self._options.hand_collisions),
                solref=CONTACT_SOLREF,
                solimp=CONTACT_SOLIMP,
            )

    def _add_couplings(self) -> None:
        for coupling in self._body.couplings:
            tendon = self._spec.add_tendon(name=self._prefix + coupling.name)
            for joint in coupling.joints:
                tendon.wrap_joint(self._prefix + joint, 1.0)
        for follower in self._body.followers:
            equality = self._spec.add_equality(
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name1=self._prefix + follower.joint,
                name2=self._prefix + follower.leader,
                solref=CONTACT_SOLREF,
            )
            equality.data[1] = follower.ratio

    def _add_servo(self, actuator: Actuator, control_range: tuple[float, float]) -> None:
        coupled = actuator.target in {coupling.name for coupling in self._body.couplings}
        servo = self._spec.add_actuator(
            name=f"{self._prefix}{SERVO}{actuator.target}",
            target=self._prefix + actuator.target,
            trntype=mujoco.mjtTrn.mjTRN_TENDON if coupled else mujoco.mjtTrn.mjTRN_JOINT,
            ctrlrange=control_range,
        )
        servo.set_to_position(kp=actuator.kp, kv=actuator.kv)
        if actuator.force is not None:
            servo.forcerange = (-actuator.force, actuator.force)


def mirror_image(body: Body) -> Body:
    """The left hand's body, from the right hand's."""
    return replace(body, links=tuple(_mirrored_link(each, body) for each in body.links))


def mirrored(vector: Vector) -> Vector:
    """A vector of the right hand as the left hand has it."""
    x, y, z = vector
    return -x, y, z


def _mirrored_link(link: Link, body: Body) -> Link:
    com, inertia_quat = link.com, link.inertia_quat
    if body.mirrored_masses:
        com, inertia_quat = mirrored(com), _mirror_quat(inertia_quat)
    return replace(
        link,
        pos=mirrored(link.pos),
        quat=link.left_quat or _mirror_quat(link.quat),
        com=com,
        inertia_quat=inertia_quat,
        joint=link.joint and _mirrored_joint(link.joint),
        geoms=tuple(map(_mirrored_geom, link.geoms)),
        round_geoms=tuple(map(_mirrored_geom, link.round_geoms)),
    )


def _mirrored_joint(joint: Joint) -> Joint:
    x, y, z = joint.axis
    turned = mirrored(joint.axis) if joint.slide else (x, -y, -z)
    return replace(joint, axis=joint.left_axis or turned)


def _mirrored_geom(geom: Geom) -> Geom:
    if not geom.mirrored:
        return geom
    quat, size = geom.left_quat or _mirror_quat(geom.quat), geom.left_size or geom.size
    return replace(geom, pos=mirrored(geom.pos), quat=quat, size=size)


def _mirror_quat(quat: Quaternion) -> Quaternion:
    w, x, y, z = quat
    return w, x, -y, -z


def product(first: Array, second: Array) -> Quaternion:
    """The product of two quaternions (4,)."""
    quat = np.zeros(4)
    mujoco.mju_mulQuat(quat, first, second)
    w, x, y, z = quat.tolist()
    return w, x, y, z


def quaternion_of(rotation: Array) -> Quaternion:
    """The quaternion of a rotation (3, 3)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    w, x, y, z = quat.tolist()
    return w, x, y, z
