"""The Shadow Dexterous Hand as fingering and planners see it."""

from __future__ import annotations

import numpy as np

from cadenza.hands import forearm
from cadenza.hands.hand import FingerChain, Hand
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo
from cadenza.hands.shadow.figures import BODY

_NAMES = ("th", "ff", "mf", "rf", "lf")


def _finger(name: str) -> FingerChain:
    links = tuple(name + link for link in ("proximal", "middle", "distal"))
    if name == "th":
        # Shorter than the others, it presses near the edge of the key.
        return FingerChain(name, links, (0.0105, 0.009, 0.0082), (0, 0, 0.0275), on_white=0.056)
    return FingerChain(name, links, (0.009, 0.009, 0.0067), (0, 0, 0.026), on_white=0.047)


def _servos(name: str, spread: float, knuckle: float, tip: float) -> dict[str, Servo]:
    """Of a finger with coupled last joints; its rest is just over a white key."""
    finger, joint = _NAMES.index(name), name.upper()
    return {
        f"{joint}J4": Servo(spread, finger=finger),
        f"{joint}J3": Servo(knuckle, lift=-0.5, finger=finger),
        f"{joint}J0": Servo(tip, 0.8, 320.0, noise=0.12, finger=finger),
    }


def _stiff(finger: int) -> Servo:
    """Which planners leave where it is: the paper's action space is without it."""
    return Servo(ease=0.05, acceleration=20.0, stride=0.05, finger=finger)


_THUMB, _LITTLE = 0, 4
_SERVOS = {
    "WRJ2": Servo(0.0, 0.3, 40.0, noise=0.03, correction=0.1),
    "WRJ1": Servo(-0.05, 0.3, 40.0, noise=0.03, correction=0.1, lift=-0.35),
    "THJ5": _stiff(_THUMB),
    "THJ4": Servo(0.72, lift=-0.6, finger=_THUMB),
    "THJ3": Servo(0.15, finger=_THUMB),
    "THJ2": Servo(0.38, finger=_THUMB),
    "THJ1": _stiff(_THUMB),
    **_servos("ff", -0.1, 0.75, 1.2),
    **_servos("mf", -0.05, 0.8, 1.2),
    **_servos("rf", 0.0, 0.8, 1.2),
    "LFJ5": _stiff(_LITTLE),
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
    body=BODY,
    fingers=tuple(_finger(name) for name in _NAMES),
    servos=_SERVOS,
    reach=_REACH,
    kept_apart=_KEPT_APART,
)
