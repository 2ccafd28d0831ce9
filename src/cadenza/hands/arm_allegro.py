"""Hands on a seven-joint arm, a KUKA LBR iiwa 7 R800, beside the keyboard; one is the Allegro Hand.

Figures of the arm from `iiwa7_allegro.urdf` in the PyPI package differentiable-robot-model 0.2.3
(copyright Facebook, Inc. and its affiliates, MIT License): links, masses, inertias, joint limits,
speeds, torques, and how the hand sits on the flange. Shapes, servos and where the arm stands are
Cadenza's own.
"""

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np

from cadenza.hands import forearm
from cadenza.hands.allegro import ALLEGRO
from cadenza.hands.body import (
    IDENTITY,
    Actuator,
    Geom,
    Joint,
    Link,
    Mount,
    Quaternion,
    Vector,
    product,
    quaternion_of,
)
from cadenza.hands.hand import Hand
from cadenza.hands.servo import Servo
from cadenza.hands.shell import SLEEVE, Shell, ring

_DAMPING = 0.5  # [N m s/rad]
_TORQUE = 300.0  # [N m], the limit of the motors
_HALF = float(np.sqrt(0.5))
_UP: Quaternion = (_HALF, _HALF, 0.0, 0.0)  # rpy (pi/2, 0, 0)
_OVER: Quaternion = (0.0, 0.0, _HALF, _HALF)  # rpy (pi/2, 0, pi), and (-pi/2, pi, 0)


class _ArmLink(NamedTuple):
    """A link and the joint before it, as the URDF has them."""

    pos: Vector
    quat: Quaternion
    limit: float  # [rad] either way
    mass: float
    com: Vector
    moments: Vector  # ixx, iyy, izz
    products: Vector  # ixy, ixz, iyz
    kp: float  # [N m/rad]
    kv: float  # [N m s/rad]
    geoms: tuple[Geom, ...]


def _rod(end: Vector, radius: float) -> Geom:
    """A capsule from the origin to a point."""
    length = float(np.linalg.norm(end))
    x, y, z = np.array(end) / length
    quat = np.array([1 + z, -y, x, 0.0])  # turns z into that direction
    quat /= np.linalg.norm(quat)
    middle: Vector = tuple((np.array(end) / 2).tolist())
    w, i, j, k = quat.tolist()
    return Geom("capsule", (radius, length / 2), middle, (w, i, j, k))


_PARTS = (
    _ArmLink(
        (0, 0, 0.15), IDENTITY, 2.9670597283903604, 3.4525,
        (0, -0.03, 0.12), (0.02183, 0.007703, 0.02083), (0, 0, -0.003887),
        4400.0, 250.0, (_rod((0, 0, 0.19), 0.068),),
    ),
    _ArmLink(
        (0, 0, 0.19), _OVER, 2.0943951023931953, 3.4821,
        (0.0003, 0.059, 0.042), (0.02076, 0.02179, 0.00779), (0, -0.003626, 0),
        4600.0, 265.0, (_rod((0, 0.21, 0), 0.068),),
    ),
    _ArmLink(
        (0, 0.21, 0), _OVER, 2.9670597283903604, 4.05623,
        (0, 0.03, 0.13), (0.03204, 0.00972, 0.03042), (0, 0, 0.006227),
        1800.0, 100.0, (_rod((0, 0, 0.19), 0.063),),
    ),
    _ArmLink(
        (0, 0, 0.19), _UP, 2.0943951023931953, 3.4822,
        (0, 0.067, 0.034), (0.02178, 0.02075, 0.007785), (0, 0, -0.003625),
        1800.0, 100.0, (_rod((0, 0.21, 0), 0.063),),
    ),
    _ArmLink(
        (0, 0.21, 0), _OVER, 2.9670597283903604, 2.1633,
        (0.0001, 0.021, 0.076), (0.01287, 0.005708, 0.01112), (0, 0, -0.003946),
        2000.0, 40.0, (_rod((0, 0.03, 0.12), 0.05),),
    ),
    _ArmLink(
        (0, 0.0607, 0.19), _UP, 2.0943951023931953, 2.3466,
        (0, 0.0006, 0.0004), (0.006509, 0.006259, 0.004527), (0, 0, 0.00031891),
        2000.0, 40.0, (_rod((0, 0, 0.06), 0.05),),
    ),
    _ArmLink(
        (0, 0.081, 0.0607), _OVER, 3.0543261909900763, 3.129,
        (0, 0, 0.02), (0.01464, 0.01465, 0.002872), (0.0005912, 0, 0),
        300.0, 4.0, (Geom("cylinder", (0.045, 0.035), (0, 0, 0.015)),),
    ),
)  # fmt: skip

_FLANGE_TO_PALM: Vector = (0, 0, 0.145)
# Two arms have room side by side, and either reaches past the middle of the keyboard.
_MOUNT = Mount(pos=(0.72, 0.2, 0.0), quat=(_HALF, 0.0, 0.0, _HALF), home=0.2, low=-0.42, high=0.62)

# Of drawings, in radii of a link
_BAND, _CAP, _PROUD = 0.75, 0.72, 1.035  # where a band begins, the radius of caps; how far both go

_BASE = "arm0"
_LINKS = (*(f"arm{number}" for number in range(1, 7)), forearm.FOREARM)
_JOINTS = tuple(f"armJ{number}" for number in range(1, 8))


def _arm() -> tuple[Link, ...]:
    base = Link(
        _BASE, "", (0, 0, 0), 5.0, (-0.1, 0, 0.07), (0.05, 0.06, 0.03),
        geoms=(Geom("cylinder", (0.085, 0.07), (0, 0, 0.07)),),
        drawn=(Shell((*ring(0.085, 0.012, 0.012), *ring(0.07, 0.14, 0.012)), SLEEVE),),
    )  # fmt: skip
    chain = [
        _link(name, parent, joint, part)
        for (parent, name), joint, part in zip(
            pairwise((_BASE, *_LINKS)), _JOINTS, _PARTS, strict=True
        )
    ]
    return base, *chain


def _link(name: str, parent: str, joint: str, part: _ArmLink) -> Link:
    inertia, quat = _principal(part.moments, part.products)
    return Link(
        name, parent, part.pos, part.mass, part.com, inertia, quat, quat=part.quat,
        joint=Joint(joint, (0, 0, 1), (-part.limit, part.limit), damping=_DAMPING),
        geoms=part.geoms, drawn=_shells(part),
    )  # fmt: skip


def _shells(part: _ArmLink) -> tuple[Shell, ...]:
    """A cover along the link, and the visible part of its motor: a band around it, or two caps."""
    (geom,) = part.geoms
    radius, half_length = geom.size
    along = np.zeros(3)
    mujoco.mju_rotVecQuat(along, np.array([0.0, 0.0, half_length]), np.array(geom.quat))
    first, last = np.array(geom.pos) - along, np.array(geom.pos) + along
    cover = Shell(((*first.tolist(), radius), (*last.tolist(), 0.94 * radius)))
    if abs(along[2]) > abs(along[1]):  # it turns about its length
        at = float(first[2]) + _BAND * radius
        return cover, Shell(
            (*ring(_PROUD * radius, at, 0.006), *ring(_PROUD * radius, at + 0.012, 0.006)), SLEEVE
        )
    caps = (ring(_CAP * radius, end * _PROUD * radius, 0.008) for end in (-1, 1))
    return cover, Shell(tuple(ball for cap in caps for ball in cap), SLEEVE)


def _principal(moments: Vector, products: Vector) -> tuple[Vector, Quaternion]:
    """The principal moments of an inertia, and how their axes are turned."""
    tensor = np.diag(moments).astype(float)
    tensor[[0, 0, 1], [1, 2, 2]] = tensor[[1, 2, 2], [0, 0, 1]] = products
    values, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.linalg.det(axes)
    a, b, c = values.tolist()
    return (a, b, c), quaternion_of(axes)


# What the search for fingers, planners and learners need to know

# The palm where that of a forearm at rest is: 13 cm above the table, fingers 11 degrees down.
_HOME = (1.5708, 1.0006, 0.0, -1.8316, 0.0, -1.0614, 0.0)
# Which acceleration of a joint moves the hand by about 3 m/s^2.
_ACCELERATION = (5.0, 5.0, 8.0, 8.0, 12.0, 12.0, 12.0)


def on_arm(hand: Hand, pos: Vector, quat: Quaternion) -> Hand:
    """A hand on the arm instead of a forearm, its palm on the flange at `pos` [m], turned."""
    body = hand.body
    links = [
        replace(link, pos=pos, quat=quat) if link.parent == forearm.FOREARM else link
        for link in body.links[1:]
    ]
    motors = [
        Actuator(joint, part.kp, _TORQUE, part.kv)
        for joint, part in zip(_JOINTS, _PARTS, strict=True)
    ]
    servos = {
        joint: Servo(
            rest, ease=0.15, acceleration=acceleration, stride=0.1, noise=0.005, correction=0.03
        )
        for joint, rest, acceleration in zip(_JOINTS, _HOME, _ACCELERATION, strict=True)
    }
    return replace(
        hand,
        name=f"arm-{hand.name}",
        body=replace(
            body,
            links=(*_arm(), *links),
            actuators=(*motors, *body.actuators),
            excluded=((_BASE, _LINKS[0]), *body.excluded),
            mount=_MOUNT,
            mirrored_masses=True,
        ),
        servos=servos | dict(hand.servos),
        start=dict(hand.start) | dict(zip(_JOINTS, _HOME, strict=True)),
    )


def on_arm_as_on_forearm(hand: Hand) -> Hand:
    """A hand on the arm that is at rest where a forearm would bring it."""
    allegro, palm = (
        link
        for each in (ALLEGRO, hand)
        for link in each.body.links
        if link.parent == forearm.FOREARM
    )
    back, pos = np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(back, np.array(allegro.quat))
    mujoco.mju_rotVecQuat(pos, np.subtract(palm.pos, allegro.pos), back)
    x, y, z = (pos + _FLANGE_TO_PALM).tolist()
    return on_arm(hand, (x, y, z), product(back, np.array(palm.quat)))


ARM_ALLEGRO = on_arm(ALLEGRO, _FLANGE_TO_PALM, IDENTITY)
