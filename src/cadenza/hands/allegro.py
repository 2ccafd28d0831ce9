"""The Allegro Hand v3 on a forearm: four fingers of four joints, larger than human, no wrist.

Figures of the right hand from Wonik Robotics' published description (SimLab, allegro_hand_ros) as
MuJoCo Menagerie states it in `wonik_allegro`, BSD-2-Clause: joints, links, boxes, tips, servos. A
link weighs what its box does at Menagerie's density. Frames of palm and fingers are those of the
description: z along the fingers, x out of the palm, y towards the index finger. The left hand is
the mirror image of the right one. The forearm and how the palm sits on it are Cadenza's own.
"""

from dataclasses import replace

import numpy as np

from cadenza.hands import forearm
from cadenza.hands.body import ROTOR, Actuator, Body, Geom, Joint, Link, Quaternion, Vector
from cadenza.hands.hand import FingerChain, Hand
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo
from cadenza.hands.shell import METAL, RUBBER, SLEEVE, TRIM, Shell, ring, rounded_box

_DENSITY = 800.0  # [kg/m^3]
_KP, _DAMPING = 10.0, 1.0  # [N m/rad], [N m s/rad]
_FORCE = 10.0  # [N m] more than a servo asks for within its range
_INSET = (0.0004, 0.0008, 0.0030)  # [m] by which the drawing of a link is smaller than its box
_ROUND = 0.0055  # [m] the radius of its edges
_PIN, _PIN_RADIUS = 0.0075, 0.0068  # [m] of hinges: half of the length, and radius
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
    """A link whose mass and inertia are those of its `box`."""
    x, y, z = box.size
    mass = 8 * x * y * z * _DENSITY
    inertia = (mass * (y * y + z * z) / 3, mass * (x * x + z * z) / 3, mass * (x * x + y * y) / 3)
    return Link(
        name, parent, pos, mass, box.pos, inertia, quat=quat, joint=joint,
        geoms=(box, tip) if tip else (box,),
        drawn=_shells(box, tip),
        hides_keys=joint is None or box.pos[0] != 0.0,
    )  # fmt: skip


def _shells(box: Geom, tip: Geom | None) -> tuple[Shell, ...]:
    """A cover a little smaller than the `box`, a hinge where it begins, and the `tip` in rubber."""
    half_size, pos = np.array(box.size), np.array(box.pos)
    x, y, z = (half_size - np.array(_INSET)).tolist()
    shells = [Shell(rounded_box((x, y, z), box.pos, min(_ROUND, x, y, z)))]
    if pos[0] == 0.0:  # of a finger
        shells.append(Shell(((0.0, -_PIN, 0.0, _PIN_RADIUS), (0.0, _PIN, 0.0, _PIN_RADIUS)), METAL))
    if tip:
        radius, half_length = tip.size
        ends = (tip.pos[2] - half_length, tip.pos[2] + half_length)
        shells.append(Shell(tuple((0.0, 0.0, end, radius) for end in ends), RUBBER))
    return tuple(shells)


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
FOREARM = Link(
    "forearm", "", (0, 0, 0), 3.0, (0, 0, 0.09), (0.0138, 0.0138, 0.00744),
    geoms=(Geom("cylinder", (0.07434, 0.0914), (0, 0, 0.0914)),),
    drawn=(
        Shell((*ring(0.046, 0.038, 0.036), *ring(0.040, 0.165, 0.004)), SLEEVE),
        Shell(ring(0.0475, 0.040, 0.003), METAL),
        Shell(ring(0.0425, 0.166, 0.0035), TRIM),
        Shell((*ring(0.038, 0.168, 0.005), *ring(0.030, 0.262, 0.005)), METAL),
    ),
)  # fmt: skip

# The palm is narrower at the wrist, and has a foot where the forearm holds it.
_PALM = Shell(
    (
        *rounded_box((0.0190, 0.0545, 0.0100), (-0.0093, 0.0, -0.0140), 0.0090),
        *rounded_box((0.0170, 0.0400, 0.0100), (-0.0093, 0.0, -0.0830), 0.0090),
    )
)
_FOOT = Shell(ring(0.0330, -0.0935, 0.0050), METAL)
_BACK_PLATE = Shell(
    (
        *rounded_box((0.0030, 0.0430, 0.0040), (-0.0275, 0.0, -0.0200), 0.0025),
        *rounded_box((0.0030, 0.0330, 0.0040), (-0.0250, 0.0, -0.0740), 0.0025),
    ),
    SLEEVE,
)
_EDGE = Shell(((-0.0275, -0.040, -0.0125, 0.0022), (-0.0275, 0.040, -0.0125, 0.0022)), TRIM)


def _palm() -> Link:
    box = _box((0.0204, 0.0565, 0.0475), (-0.0093, 0, -0.0475))
    palm = _link("palm", "forearm", _PALM_POS, box, quat=_PALM_QUAT)
    return replace(palm, drawn=(_PALM, _FOOT, _BACK_PLATE, _EDGE))


_FINGERS = ("ff", "mf", "rf", "th")


def _body(finger_tip: Geom, thumb_tip: Geom, rotor: float) -> Body:
    return Body(
        links=(
            FOREARM,
            _palm(),
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
        armature=rotor,
        friction_loss=0.0,
    )


_BODY = _body(
    finger_tip=Geom("capsule", (0.012, 0.01), (0, 0, 0.019)),
    thumb_tip=Geom("capsule", (0.012, 0.008), (0, 0, 0.035)),
    rotor=ROTOR,
)
_NARROW_BODY = _body(  # of the same length, and half the width
    finger_tip=Geom("capsule", (0.006, 0.016), (0, 0, 0.019)),
    thumb_tip=Geom("capsule", (0.006, 0.014), (0, 0, 0.035)),
    rotor=0.0,  # with which the figures of docs/mini-piano.md were learnt
)


# What the search for fingers, planners and learners need to know

_NAMES = ("th", "ff", "mf", "rf")
# Its servos follow within a tenth of a second, ten times as stiff as the other hand's: motions have
# to be gentle, and exploration around them small.
_NOISE = 0.04  # [rad]
_CORRECTION = 0.1  # [rad]
# A fingertip goes 3 cm either way. Over their whole range random actions move it by 10 cm, and
# hardly ever press a single key.
_TRAVEL = 0.3  # [rad]
_ACCELERATION = 40.0  # [rad/s^2]
_LINKS = ("proximal", "medial", "distal")
# Fingers are as wide as keys. On neighbouring keys they have room one behind the other.
_ON_WHITE = {"th": 0.07, "ff": 0.058, "mf": 0.042, "rf": 0.058}
# From the knuckle to the last joint, of fingers that are just over white keys.
_REST = {
    "th": (1.21, 0.17, 0.88, 0.06),
    "ff": (-0.35, 0.85, 1.33, -0.15),
    "mf": (-0.28, 0.68, 1.44, -0.17),
    "rf": (-0.20, 0.74, 1.44, -0.15),
}
# 3 cm above the keys: straight fingers would have to be drawn back across the black keys.
_START = {
    "th": (0.58, 0.66, 1.10, 0.78),
    "ff": (-0.47, 0.56, 1.70, 0.39),
    "mf": (-0.40, 0.38, 1.70, 0.56),
    "rf": (-0.29, 0.46, 1.70, 0.59),
}


def _chain(name: str) -> FingerChain:
    tip = (0.0, 0.0, 0.043 if name == "th" else 0.029)
    links = tuple(name + link for link in _LINKS)
    return FingerChain(name, links, (0.0155, 0.0155, 0.012), tip, _ON_WHITE[name])


def _narrow(finger: FingerChain) -> FingerChain:
    """`finger` with a tip that is half as wide and ends at the same place."""
    *radii, radius = finger.radii
    x, y, z = finger.tip
    return replace(finger, radii=(*radii, radius / 2), tip=(x, y, z + radius / 2))


def _servos(name: str) -> dict[str, Servo]:
    finger = _NAMES.index(name)
    lifts = (0.0, -0.3 if finger else 0.0, 0.0, 0.0)
    return {
        f"{name}J{joint}": Servo(
            rest,
            acceleration=_ACCELERATION,
            noise=_NOISE,
            travel=_TRAVEL,
            correction=_CORRECTION,
            lift=lift,
            finger=finger,
        )
        for joint, (rest, lift) in enumerate(zip(_REST[name], lifts, strict=True))
    }


# Measured by `cadenza hand measure`; `rest` are its fingertips at rest, not while all press.
_REACH = Reach(
    rest=np.array([-0.048, -0.012, 0.026, 0.064]),
    least=0.0115 * np.maximum(np.arange(4) - np.arange(4)[:, None], 0),
    most=np.array(
        [
            [0.000, 0.073, 0.133, 0.164],
            [0.000, 0.000, 0.152, 0.199],
            [0.000, 0.000, 0.000, 0.154],
            [0.000, 0.000, 0.000, 0.000],
        ]
    ),
    outward=np.array([0.086, 0.101, 0.056, 0.012]),
    inward=np.array([0.029, 0.012, 0.056, 0.101]),
    forearm_width=forearm.WIDTH,
    effort=np.array([0.0, 0.0, 0.0, 0.1]),
    effort_on_black=np.array([0.5, 0.0, 0.0, 0.0]),
)

ALLEGRO = Hand(
    name="allegro",
    body=_BODY,
    fingers=tuple(_chain(name) for name in _NAMES),
    servos={joint: servo for name in _NAMES for joint, servo in _servos(name).items()},
    reach=_REACH,
    thumb_meets=3,
    start={f"{name}J{j}": q for name, qpos in _START.items() for j, q in enumerate(qpos)},
)

ALLEGRO_NARROW = replace(
    ALLEGRO,
    name="allegro-narrow",
    body=_NARROW_BODY,
    fingers=tuple(_narrow(finger) for finger in ALLEGRO.fingers),
)
