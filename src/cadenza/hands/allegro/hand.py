"""The Allegro Hand as fingering and planners see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadenza.hands import forearm
from cadenza.hands.allegro.figures import BODY, NARROW_TIPS
from cadenza.hands.hand import FingerChain, Hand
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo

_NAMES = ("th", "ff", "mf", "rf")
# Its servos follow within a tenth of a second, ten times as stiff as the other hand's: motions have
# to be gentle, and what is tried around them small.
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


def _finger(name: str) -> FingerChain:
    tip = (0.0, 0.0, 0.043 if name == "th" else 0.029)
    links = tuple(name + link for link in _LINKS)
    return FingerChain(name, links, (0.0155, 0.0155, 0.012), tip, _ON_WHITE[name])


def _narrow(finger: FingerChain) -> FingerChain:
    """With a tip that is half as wide and ends at the same place."""
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


# Measured by tools/measure_reach.py; `rest` is where the fingertips are at rest, by the same tool,
# and not where they are when all press.
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
    body=BODY,
    fingers=tuple(_finger(name) for name in _NAMES),
    servos={joint: servo for name in _NAMES for joint, servo in _servos(name).items()},
    reach=_REACH,
    thumb_meets=3,
    start={f"{name}J{j}": q for name, qpos in _START.items() for j, q in enumerate(qpos)},
)

ALLEGRO_NARROW = replace(
    ALLEGRO,
    name="allegro-narrow",
    body=NARROW_TIPS,
    fingers=tuple(_narrow(finger) for finger in ALLEGRO.fingers),
)
