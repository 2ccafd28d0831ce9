"""The body of the Allegro Hand v3 on a forearm.

Figures of the right hand from Wonik Robotics' published description (SimLab, allegro_hand_ros) as
MuJoCo Menagerie states it in `wonik_allegro`, BSD-2-Clause: joints, links, boxes, tips, servos. A
link weighs what its box does at Menagerie's density. Frames of palm and fingers are those of the
description: z along the fingers, x out of the palm, y towards the index finger. The left hand is
the mirror image of the right one. The forearm and how the palm sits on it are Cadenza's own; there
is no wrist.
"""

from __future__ import annotations

from cadenza.hands.body import (
    FINGERTIP_RGBA,
    FOREARM_RGBA,
    LINK_RGBA,
    Actuator,
    Body,
    Geom,
    Joint,
    Link,
    Quaternion,
    Vector,
)

_DENSITY = 800.0  # [kg/m^3]
_KP, _DAMPING = 10.0, 1.0  # [N m/rad], [N m s/rad]
_FORCE = 10.0  # [N m] more than a servo asks for within its range
_FINGER_WIDTH = (0.0098, 0.01375)  # half sizes across the palm's normal and across the fingers

# Turns the description's palm into the forearm's frame, whose y is out of the back of the hand.
_PALM_QUAT: Quaternion = (0.703574, 0.070593, 0.070593, -0.703574)
_PALM_POS: Vector = (0.0, 0.0, 0.35)


def _box(half_size: Vector, pos: Vector) -> Geom:
    return Geom("box", half_size, pos)


def _link(
    name: str,
    parent: str,
    pos: Vector,
    box: Geom,
    joint: Joint | None = None,
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0),
    tip: Geom | None = None,
) -> Link:
    """A link that weighs what its `box` does."""
    x, y, z = box.size
    mass = 8 * x * y * z * _DENSITY
    inertia = (mass * (y * y + z * z) / 3, mass * (x * x + z * z) / 3, mass * (x * x + y * y) / 3)
    return Link(
        name, parent, pos, mass, box.pos, inertia, quat=quat, joint=joint,
        geoms=(box, tip) if tip else (box,),
        rgba=FINGERTIP_RGBA if tip else LINK_RGBA,
        hides_keys=not joint,
    )  # fmt: skip


def _joint(name: str, axis: Vector, low: float, high: float) -> Joint:
    return Joint(name, axis, (low, high), damping=_DAMPING)


def _finger(name: str, pos: Vector, quat: Quaternion, tip: Geom) -> tuple[Link, ...]:
    x, y = _FINGER_WIDTH
    return (
        _link(
            f"{name}base", "palm", pos, _box((x, y, 0.0082), (0, 0, 0.0082)),
            _joint(f"{name}J0", (0, 0, 1), -0.47, 0.47), quat,
        ),
        _link(
            f"{name}proximal", f"{name}base", (0, 0, 0.0164), _box((x, y, 0.027), (0, 0, 0.027)),
            _joint(f"{name}J1", (0, 1, 0), -0.196, 1.61),
        ),
        _link(
            f"{name}medial", f"{name}proximal", (0, 0, 0.054), _box((x, y, 0.0192), (0, 0, 0.0192)),
            _joint(f"{name}J2", (0, 1, 0), -0.174, 1.709),
        ),
        _link(
            f"{name}distal", f"{name}medial", (0, 0, 0.0384), _box((x, y, 0.008), (0, 0, 0.008)),
            _joint(f"{name}J3", (0, 1, 0), -0.227, 1.618),
            tip=tip,
        ),
    )  # fmt: skip


def _thumb(tip: Geom) -> tuple[Link, ...]:
    x, y = _FINGER_WIDTH
    return (
        _link(
            "thbase", "palm", (-0.0182, 0.019333, -0.045987),
            _box((0.0179, 0.017, 0.02275), (-0.0179, 0.009, 0.0145)),
            _joint("thJ0", (-1, 0, 0), 0.263, 1.396), (0.477714, -0.521334, -0.521334, -0.477714),
        ),
        _link(
            "thproximal", "thbase", (-0.027, 0.005, 0.0399),
            _box((x, y, 0.00885), (0, 0, 0.00885)), _joint("thJ1", (0, 0, 1), -0.105, 1.163),
        ),
        _link(
            "thmedial", "thproximal", (0, 0, 0.0177), _box((x, y, 0.0257), (0, 0, 0.0257)),
            _joint("thJ2", (0, 1, 0), -0.189, 1.644),
        ),
        _link(
            "thdistal", "thmedial", (0, 0, 0.0514), _box((x, y, 0.0157), (0, 0, 0.0157)),
            _joint("thJ3", (0, 1, 0), -0.162, 1.719),
            tip=tip,
        ),
    )  # fmt: skip


# As wide as the other hand's, so that two hands keep the same distance.
_FOREARM = Link(
    "forearm", "", (0, 0, 0), 3.0, (0, 0, 0.09), (0.0138, 0.0138, 0.00744),
    geoms=(Geom("cylinder", (0.07434, 0.0914), (0, 0, 0.0914)),),
    drawn=(
        Geom("cylinder", (0.046, 0.075), (0, 0, 0.085)),
        Geom("cylinder", (0.03, 0.07), (0, 0, 0.23)),  # into the palm
    ),
    rgba=FOREARM_RGBA,
)  # fmt: skip

_PALM = _link(
    "palm", "forearm", _PALM_POS, _box((0.0204, 0.0565, 0.0475), (-0.0093, 0, -0.0475)),
    quat=_PALM_QUAT,
)  # fmt: skip

_FINGERS = ("ff", "mf", "rf", "th")


def _body(finger_tip: Geom, thumb_tip: Geom) -> Body:
    return Body(
        links=(
            _FOREARM,
            _PALM,
            *_finger("ff", (0, 0.0435, -0.001542), (0.999048, -0.0436194, 0, 0), finger_tip),
            *_finger("mf", (0, 0, 0.0007), (1, 0, 0, 0), finger_tip),
            *_finger("rf", (0, -0.0435, -0.001542), (0.999048, 0.0436194, 0, 0), finger_tip),
            *_thumb(thumb_tip),
        ),
        actuators=tuple(
            Actuator(f"{finger}J{joint}", _KP, _FORCE) for finger in _FINGERS for joint in range(4)
        ),
        excluded=(
            ("forearm", "palm"),
            *(("palm", f"{finger}base") for finger in _FINGERS),
            ("palm", "thproximal"),
        ),
        armature=0.0,
        friction_loss=0.0,
    )


BODY = _body(
    finger_tip=Geom("capsule", (0.012, 0.01), (0, 0, 0.019)),
    thumb_tip=Geom("capsule", (0.012, 0.008), (0, 0, 0.035)),
)
NARROW_TIPS = _body(  # as long, and half as wide
    finger_tip=Geom("capsule", (0.006, 0.016), (0, 0, 0.019)),
    thumb_tip=Geom("capsule", (0.006, 0.014), (0, 0, 0.035)),
)
