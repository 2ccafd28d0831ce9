"""The Allegro Hand on an arm, as fingering and planners see it."""

from __future__ import annotations

from dataclasses import replace

from cadenza.hands.allegro.hand import ALLEGRO
from cadenza.hands.arm_allegro.figures import BODY, JOINTS
from cadenza.hands.servo import Servo

# The palm where that of a forearm at rest is: 13 cm above the table, fingers 11 degrees down.
_HOME = (1.5708, 1.0006, 0.0, -1.8316, 0.0, -1.0614, 0.0)
# Which acceleration of a joint moves the hand by about 3 m/s^2.
_ACCELERATION = (5.0, 5.0, 8.0, 8.0, 12.0, 12.0, 12.0)

ARM_ALLEGRO = replace(
    ALLEGRO,
    name="arm-allegro",
    body=BODY,
    servos={
        joint: Servo(
            rest, ease=0.15, acceleration=acceleration, stride=0.1, noise=0.005, correction=0.03
        )
        for joint, rest, acceleration in zip(JOINTS, _HOME, _ACCELERATION, strict=True)
    }
    | dict(ALLEGRO.servos),
    start=dict(ALLEGRO.start) | dict(zip(JOINTS, _HOME, strict=True)),
)
