"""A hand without a single hinge: five pistons side by side, over five white keys."""

from __future__ import annotations

import numpy as np
import pytest

import cadenza
from cadenza import Note, SceneConfig, Score
from cadenza.hands import forearm
from cadenza.hands.body import Actuator, Body, Geom, Joint, Link
from cadenza.hands.hand import Finger, Hand
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo

RADIUS = 0.006  # [m]
RIGHT = 0.0235 * np.arange(-2, 3)  # [m] of the forearm; neighbouring white keys
APART = np.maximum(RIGHT - RIGHT[:, None], 0.0)
OFF = 0.002  # [m] that a piston can be beside the middle of its key


def piston(number: int) -> Link:
    return Link(
        f"rod{number}",
        "palm",
        pos=(-RIGHT[number], 0, 0.08),
        mass=0.05,
        com=(0, -0.04, 0),
        inertia=(3e-5, 3e-6, 3e-5),
        joint=Joint(f"push{number}", axis=(0, -1, 0), range=(0.0, 0.04), damping=2.0, slide=True),
        geoms=(Geom("capsule", (RADIUS, 0.035), (0, -0.045, 0), (0.5**0.5, 0.5**0.5, 0, 0)),),
    )


BODY = Body(
    links=(
        Link(forearm.FOREARM, "", (0, 0, 0), 3.0, (0, 0, 0.09), (0.014, 0.014, 0.007)),
        Link("palm", forearm.FOREARM, (0, 0, 0.25), 0.3, (0, 0, 0.04), (5e-4, 4e-4, 2e-4)),
        *map(piston, range(5)),
    ),
    actuators=tuple(Actuator(f"push{number}", kp=400.0, force=10.0) for number in range(5)),
)
PISTONS = Hand(
    name="pistons",
    body=BODY,
    fingers=tuple(
        Finger(f"piston{number}", (f"rod{number}",), (RADIUS,), (0, -0.08, 0), on_white=0.05)
        for number in range(5)
    ),
    servos={
        f"push{number}": Servo(0.012, 0.02, 4.0, 0.02, noise=0.003, lift=-0.01, finger=number)
        for number in range(5)
    },
    reach=Reach(
        rest=RIGHT,
        least=np.maximum(APART - OFF, 0.0),
        most=APART + OFF * (APART > 0),
        outward=OFF - RIGHT,
        inward=OFF + RIGHT,
        forearm_width=0.1,
    ),
)


@pytest.mark.parametrize(("side", "lowest"), [("right", 60), ("left", 48)])
def test_the_planner_plays_with_it(side: str, lowest: int) -> None:
    song = Score(tuple(Note(0.4 * i, 0.4 * i + 0.4, lowest + p) for i, p in enumerate((0, 4, 2))))
    scene = SceneConfig(hand=f"{__name__}:PISTONS", hands=side)
    performance = cadenza.play(song, scene=scene)
    assert performance.metrics["note_onset_f1"] == 1.0
    assert performance.metrics["f1"] > 0.9
