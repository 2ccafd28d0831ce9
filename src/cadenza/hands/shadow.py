"""The Shadow Dexterous Hand E3M5: five fingers, the last joints of four coupled.

Figures from the hand model of RoboPianist (Zakka et al., CoRL 2023; PyPI robopianist 1.0.10), which
goes back to DeepMind's model in MuJoCo Menagerie after Shadow Robot's description of the E3M5
series. Frames of the links: z along the link, y out of the back of the hand.
"""

from dataclasses import replace

import numpy as np

from cadenza.hands import forearm
from cadenza.hands.body import Actuator, Body, Coupling, Geom, Joint, Link, Quaternion, Vector
from cadenza.hands.hand import FingerChain, Hand
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo
from cadenza.hands.shadow_shells import SHELLS

# Turns a cylinder's z axis onto x.
_ALONG_X: Quaternion = (0.707107, 0.0, 0.707107, 0.0)
_SWAP_XY: Quaternion = (0.707107, 0.0, 0.0, 0.707107)
_CYCLE: Quaternion = (0.5, 0.5, -0.5, 0.5)


def _capsule(radius: float, half_length: float, z: float) -> Geom:
    return Geom("capsule", (radius, half_length), (0, 0, z))


_KNUCKLE_PIN = Geom("cylinder", (0.009, 0.009), quat=_ALONG_X, left_quat=_ALONG_X)
# Fitted to the fingertip's shell, the same on both hands.
_FINGERTIP = Geom(
    "capsule",
    (0.006674529773429324, 0.007783489210122916),
    (-2.3984400542108612e-05, 4.2073253715676145e-04, 1.7646475392848301e-02),
    (0.7030358436460032, -0.0009495615836725945, 0.0009525013178396008, 0.711153143579491),
    mirrored=False,
)
_THUMB_TIP = Geom(
    "capsule",
    (0.008158238697267554, 0.007842507537795659),
    (-8.2545214607151788e-07, 8.0251877710402458e-04, 1.9553373070678535e-02),
    (0.7071507168146272, -0.0011598706415721226, 0.001084121970924425, 0.7070610603676373),
    mirrored=False,
)


# The rounder fingertips: ellipsoids along the axes of the link, with the bounds of the published
# mesh. They hold 0.79 (fingers) and 0.87 (thumb) of its volume, the most that an ellipsoid can.
_ROUND_FINGERTIP = Geom(
    "ellipsoid",
    (0.00856893111, 0.00716911199, 0.01366313501),
    (-2.839e-05, -0.0001691117746, 0.01835379425),
    mirrored=False,
)
_ROUND_THUMB_TIP = Geom(
    "ellipsoid",
    (0.01058339494, 0.008914186407, 0.01582727551),
    (-2e-07, 8.581401573e-05, 0.01916883371),
    mirrored=False,
)
_FOREARM = Link(
    "forearm", "", (0, 0, 0), 3.0, (0, 0, 0.09), (0.0138, 0.0138, 0.00744),
    geoms=(
        # Stands for the shell, a mesh in the published model, within two millimetres of its bounds;
        # the radius is the one at which two forearms touched in a recorded episode.
        Geom("cylinder", (0.07434, 0.0914), (0, 0, 0.0914)),
        Geom("box", (0.035, 0.035, 0.035), (0, -0.01, 0.181),
             (0.924909, 0, 0.380188, 0), mirrored=False),
    ),
)  # fmt: skip

_WRIST = Link(
    "wrist", "forearm", (0, -0.01, 0.21301), 0.1, (0, 0, 0.029), (6.4e-05, 4.38e-05, 3.5e-05),
    (0.5, 0.5, 0.5, 0.5),
    joint=Joint("WRJ2", (0, 1, 0), (-0.523599, 0.174533), damping=0.5),
    geoms=(
        Geom("cylinder", (0.0135, 0.015), quat=(0.499998, 0.5, 0.5, -0.500002), mirrored=False),
        Geom("cylinder", (0.011, 0.005), (-0.026, 0, 0.034), _ALONG_X, left_quat=_ALONG_X),
        Geom("cylinder", (0.011, 0.005), (0.031, 0, 0.034), _ALONG_X, left_quat=_ALONG_X),
        Geom("box", (0.0135, 0.009, 0.005), (-0.021, 0, 0.011), (0.923879, 0, 0.382684, 0)),
        Geom("box", (0.0135, 0.009, 0.005), (0.026, 0, 0.01), (0.923879, 0, -0.382684, 0)),
    ),
)  # fmt: skip

_PALM = Link(
    "palm", "wrist", (0, 0, 0.034), 0.3, (0, 0, 0.035), (0.0005287, 0.0003581, 0.000191), _SWAP_XY,
    joint=Joint("WRJ1", (1, 0, 0), (-0.698132, 0.488692), damping=0.5),
    geoms=(
        Geom("box", (0.031, 0.0035, 0.049), (0.011, 0.0085, 0.038)),
        Geom("box", (0.018, 0.0085, 0.049), (-0.002, -0.0035, 0.038)),
        Geom("box", (0.013, 0.0085, 0.005), (0.029, -0.0035, 0.082)),
        Geom("box", (0.013, 0.007, 0.009), (0.0265, -0.001, 0.07),
             (0.987241, 0.0990545, 0.0124467, 0.124052),
             left_quat=(0.987241, 0.0990545, 0.0124467, -0.124052)),
        Geom("box", (0.0105, 0.0135, 0.012), (0.0315, -0.0085, 0.001),
             left_size=(0.0105, 0.0135, 0.0112)),
        Geom("box", (0.011, 0.0025, 0.015), (0.0125, -0.015, 0.004),
             (0.971338, 0, 0, -0.237703)),
        Geom("box", (0.009, 0.012, 0.002), (0.011, 0, 0.089)),
        Geom("box", (0.01, 0.012, 0.02), (-0.03, 0, 0.009)),
    ),
    hides_keys=True,
)  # fmt: skip


def _finger(name: str, base: str, pos: Vector, spread_axis: Vector) -> tuple[Link, ...]:
    """Knuckle, proximal, middle and distal link of one finger."""
    joint = name.upper()
    return (
        Link(
            f"{name}knuckle", base, pos, 0.008, (0, 0, 0), (3.2e-07, 2.6e-07, 2.6e-07), _CYCLE,
            joint=Joint(f"{joint}J4", spread_axis, (-0.349066, 0.349066)),
            geoms=(_KNUCKLE_PIN,),
        ),
        Link(
            f"{name}proximal", f"{name}knuckle", (0, 0, 0), 0.03, (0, 0, 0.0225),
            (1e-05, 9.8e-06, 1.8e-06), _SWAP_XY,
            joint=Joint(f"{joint}J3", (1, 0, 0), (-0.261799, 1.5708)),
            geoms=(_capsule(0.009, 0.02, 0.025),),
        ),
        Link(
            f"{name}middle", f"{name}proximal", (0, 0, 0.045), 0.017, (0, 0, 0.0125),
            (2.7e-06, 2.6e-06, 8.7e-07), _SWAP_XY,
            joint=Joint(f"{joint}J2", (1, 0, 0), (0.0, 1.5708)),
            geoms=(_capsule(0.009, 0.0125, 0.0125),),
        ),
        Link(
            f"{name}distal", f"{name}middle", (0, 0, 0.025), 0.013, (0, 0, 0.0130769),
            (1.28092e-06, 1.12092e-06, 5.3e-07), _SWAP_XY,
            joint=Joint(f"{joint}J1", (1, 0, 0), (0.0, 1.5708)),
            geoms=(_FINGERTIP,),
            round_geoms=(_ROUND_FINGERTIP,),
        ),
    )  # fmt: skip


_LITTLE_FINGER_METACARPAL = Link(
    "lfmetacarpal", "palm", (-0.033, 0, 0.02071), 0.03, (0, 0, 0.04),
    (1.638e-05, 1.45e-05, 4.272e-06), _SWAP_XY,
    joint=Joint("LFJ5", (0.5735761643640093, 0, 0.8191522347362981), (0.0, 0.785398)),
    geoms=(Geom("box", (0.011, 0.012, 0.025), (0.002, 0, 0.033)),),
    hides_keys=True,
)  # fmt: skip

# The left thumb's frames are turned by half a turn about z after mirroring.
_THUMB = (
    Link(
        "thbase", "palm", (0.034, -0.00858, 0.029), 0.01, (0, 0, 0), (1.6e-07, 1.6e-07, 1.6e-07),
        quat=(0.92388, 0, 0.382683, 0), left_quat=(0, -0.382683, 0, 0.92388),
        joint=Joint("THJ5", (0, 0, -1), (-1.0472, 1.0472)),
        geoms=(Geom("sphere", (0.013,)),),
    ),
    Link(
        "thproximal", "thbase", (0, 0, 0), 0.04, (0, 0, 0.019), (1.36e-05, 1.36e-05, 3.13e-06),
        joint=Joint("THJ4", (1, 0, 0), (0.0, 1.22173), left_axis=(-1, 0, 0)),
        geoms=(_capsule(0.0105, 0.009, 0.02),),
    ),
    Link(
        "thhub", "thproximal", (0, 0, 0.038), 0.005, (0, 0, 0), (1e-06, 1e-06, 3e-07),
        joint=Joint("THJ3", (1, 0, 0), (-0.20944, 0.20944), left_axis=(-1, 0, 0)),
        geoms=(Geom("sphere", (0.011,)),),
    ),
    Link(
        "thmiddle", "thhub", (0, 0, 0), 0.02, (0, 0, 0.016), (5.1e-06, 5.1e-06, 1.21e-06),
        joint=Joint("THJ2", (0, -1, 0), (-0.698132, 0.698132), left_axis=(0, -1, 0)),
        geoms=(_capsule(0.009, 0.009, 0.012), Geom("sphere", (0.01,), (0, 0, 0.03))),
    ),
    Link(
        "thdistal", "thmiddle", (0, 0, 0.032), 0.017, (0, 0, 0.0145588),
        (2.37794e-06, 2.27794e-06, 1e-06), _SWAP_XY, quat=(0.707107, 0, 0, -0.707107),
        left_quat=(0.707107, 0, 0, -0.707107),
        joint=Joint("THJ1", (1, 0, 0), (-0.261799, 1.5708)),
        geoms=(_THUMB_TIP,),
        round_geoms=(_ROUND_THUMB_TIP,),
    ),
)  # fmt: skip

_LINKS = (
    _FOREARM,
    _WRIST,
    _PALM,
    *_finger("ff", "palm", (0.033, 0, 0.095), (0, -1, 0)),
    *_finger("mf", "palm", (0.011, 0, 0.099), (0, -1, 0)),
    *_finger("rf", "palm", (-0.011, 0, 0.095), (0, 1, 0)),
    _LITTLE_FINGER_METACARPAL,
    *_finger("lf", "lfmetacarpal", (0, 0, 0.06579), (0, 1, 0)),
    *_THUMB,
)

_COUPLED_FINGERS = ("FF", "MF", "RF", "LF")  # a tendon, J0, pulls J2 and J1 together


def _finger_actuators(finger: str) -> tuple[Actuator, ...]:
    return (
        Actuator(f"{finger}J4", 1.0, 1.0),
        Actuator(f"{finger}J3", 1.0, 1.0),
        Actuator(f"{finger}J0", 0.5, 1.0),
    )


_ACTUATORS = (
    Actuator("WRJ2", 10.0, 10.0),
    Actuator("WRJ1", 8.0, 5.0),
    Actuator("THJ5", 0.4, 3.0),
    Actuator("THJ4", 1.0, 2.0),
    Actuator("THJ3", 0.5, 1.0),
    Actuator("THJ2", 1.5, 1.0),
    Actuator("THJ1", 1.0, 1.0),
    *_finger_actuators("FF"),
    *_finger_actuators("MF"),
    *_finger_actuators("RF"),
    Actuator("LFJ5", 1.0, 1.0),
    *_finger_actuators("LF"),
)

_BODY = Body(
    links=tuple(replace(link, drawn=SHELLS.get(link.name, ())) for link in _LINKS),
    actuators=_ACTUATORS,
    couplings=tuple(
        Coupling(f"{finger}J0", (f"{finger}J2", f"{finger}J1"), control_range=(0.0, 3.1415))
        for finger in _COUPLED_FINGERS
    ),
    excluded=(("forearm", "wrist"), ("thproximal", "thmiddle")),
    # The paper's reduced action space has no such joints, and the thumb closes one way only.
    locked=("THJ5", "THJ1", "LFJ5"),
    reduced_ranges={"THJ2": (0.0, 0.698132)},
)


# What the search for fingers, planners and learners need to know

_NAMES = ("th", "ff", "mf", "rf", "lf")


def _chain(name: str) -> FingerChain:
    links = tuple(name + link for link in ("proximal", "middle", "distal"))
    if name == "th":
        # Shorter than the others, it presses near the edge of the key.
        return FingerChain(name, links, (0.0105, 0.009, 0.0082), (0, 0, 0.0275), on_white=0.056)
    return FingerChain(name, links, (0.009, 0.009, 0.0067), (0, 0, 0.026), on_white=0.047)


def _servos(name: str, spread: float, knuckle: float, tip: float) -> dict[str, Servo]:
    """Servos of a finger with coupled last joints, which rests just over a white key."""
    finger, joint = _NAMES.index(name), name.upper()
    return {
        f"{joint}J4": Servo(spread, travel=0.2, finger=finger),
        f"{joint}J3": Servo(knuckle, travel=0.4, lift=-0.5, finger=finger),
        f"{joint}J0": Servo(tip, 0.8, 320.0, noise=0.12, travel=0.5, finger=finger),
    }


def _stiff(finger: int) -> Servo:
    """A servo that planners leave where it is: the paper's action space is without it."""
    return Servo(ease=0.05, acceleration=20.0, stride=0.05, finger=finger)


_TH, _LF = 0, 4  # indices of fingers
_SERVOS = {
    "WRJ2": Servo(0.0, 0.3, 40.0, noise=0.03, travel=0.15, correction=0.1),
    "WRJ1": Servo(-0.05, 0.3, 40.0, noise=0.03, travel=0.25, correction=0.1, lift=-0.35),
    "THJ5": _stiff(_TH),
    "THJ4": Servo(0.72, travel=0.4, lift=-0.6, finger=_TH),
    "THJ3": Servo(0.15, travel=0.2, finger=_TH),
    "THJ2": Servo(0.38, travel=0.3, finger=_TH),
    "THJ1": _stiff(_TH),
    **_servos("ff", -0.1, 0.75, 1.2),
    **_servos("mf", -0.05, 0.8, 1.2),
    **_servos("rf", 0.0, 0.8, 1.2),
    "LFJ5": _stiff(_LF),
    **_servos("lf", -0.03, 0.75, 1.15),
}

# Measured with all fingertips 4 cm towards the player from the middle of white keys.
_REACH = Reach(
    rest=np.array([-0.0521, -0.0193, 0.0029, 0.0251, 0.0473]),
    # Fingers side by side on neighbouring keys, which all pairs can reach.
    least=0.0115 * np.maximum(np.arange(5) - np.arange(5)[:, None], 0),
    most=np.array(
        [
            [0.000, 0.085, 0.115, 0.147, 0.182],
            [0.000, 0.000, 0.082, 0.109, 0.127],
            [0.000, 0.000, 0.000, 0.085, 0.104],
            [0.000, 0.000, 0.000, 0.000, 0.085],
            [0.000, 0.000, 0.000, 0.000, 0.000],
        ]
    ),
    outward=np.array([0.092, 0.084, 0.060, 0.037, 0.018]),
    inward=np.array([0.030, 0.081, 0.108, 0.135, 0.150]),
    forearm_width=forearm.WIDTH,
    effort=np.array([0.0, 0.0, 0.0, 0.1, 0.1]),
    effort_on_black=np.array([0.5, 0.0, 0.0, 0.0, 0.2]),
)

# RoboPianist compares the names of shapes by how they begin, and so means more than the forearms.
_KEPT_APART = (
    *(forearm.FOREARM, "palm"),
    *(name + link for name in ("ff", "mf") for link in ("knuckle", "proximal", "middle", "distal")),
    *("rfknuckle", "rfproximal"),
)

SHADOW = Hand(
    name="shadow",
    body=_BODY,
    fingers=tuple(_chain(name) for name in _NAMES),
    servos=_SERVOS,
    reach=_REACH,
    kept_apart=_KEPT_APART,
)
