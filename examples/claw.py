"""A hand of one's own: a claw of three fingers. docs/how-to/hand.md explains it.

python examples/claw.py [SONG]
"""

import cadenza
import numpy as np
from cadenza.hands import forearm
from cadenza.hands.body import Actuator, Body, Geom, Joint, Link
from cadenza.hands.hand import FingerChain, Hand
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo

LENGTH = 0.05  # [m] of both links of a finger
RADIUS = 0.008  # [m]
PLACES = {"inner": 0.024, "middle": 0.0, "outer": -0.024}  # [m] along x, the thumb's side first


def rod(name: str, parent: str, z: float, joint: Joint) -> Link:
    """A link along its z axis."""
    return Link(
        name,
        parent,
        pos=(0, 0, z),
        mass=0.03,
        com=(0, 0, LENGTH / 2),
        inertia=(6e-6, 6e-6, 1e-6),
        joint=joint,
        geoms=(Geom("capsule", (RADIUS, LENGTH / 2), pos=(0, 0, LENGTH / 2)),),
    )


def finger_links(name: str, x: float) -> tuple[Link, ...]:
    base = Link(
        f"{name}_base",
        "palm",
        pos=(x, 0, 0.09),
        mass=0.02,
        com=(0, 0, 0),
        inertia=(1e-6, 1e-6, 1e-6),
        joint=Joint(f"{name}_spread", axis=(0, -1, 0), range=(-0.4, 0.4)),
        geoms=(Geom("sphere", (RADIUS,)),),
    )
    knuckle = Joint(f"{name}_knuckle", axis=(1, 0, 0), range=(-0.3, 1.5))
    elbow = Joint(f"{name}_elbow", axis=(1, 0, 0), range=(0.0, 1.8))
    upper = rod(f"{name}_upper", base.name, 0.0, knuckle)
    lower = rod(f"{name}_lower", upper.name, LENGTH, elbow)
    return base, upper, lower


FOREARM = Link(
    forearm.FOREARM,
    parent="",
    pos=(0, 0, 0),
    mass=3.0,
    com=(0, 0, 0.09),
    inertia=(0.014, 0.014, 0.007),
    geoms=(Geom("cylinder", (0.04, 0.1), pos=(0, 0, 0.1)),),
)
PALM = Link(
    "palm",
    FOREARM.name,
    pos=(0, -0.01, 0.22),
    mass=0.3,
    com=(0, 0, 0.04),
    inertia=(5e-4, 4e-4, 2e-4),
    geoms=(Geom("box", (0.034, 0.01, 0.04), pos=(0, 0, 0.04)),),
    hides_keys=True,
)
BODY = Body(
    links=(FOREARM, PALM, *(link for name, x in PLACES.items() for link in finger_links(name, x))),
    actuators=tuple(
        Actuator(f"{name}_{joint}", kp=2.0, force=2.0)
        for name in PLACES
        for joint in ("spread", "knuckle", "elbow")
    ),
)


def servos(finger: int, name: str) -> dict[str, Servo]:
    return {
        f"{name}_spread": Servo(rest=0.0, finger=finger),
        f"{name}_knuckle": Servo(rest=0.6, lift=-0.5, finger=finger),
        f"{name}_elbow": Servo(rest=1.0, finger=finger),
    }


CLAW = Hand(
    name="claw",
    body=BODY,
    fingers=tuple(
        FingerChain(
            name,
            links=(f"{name}_upper", f"{name}_lower"),
            radii=(RADIUS, RADIUS),
            tip=(0, 0, LENGTH),
            on_white=0.045,
        )
        for name in PLACES
    ),
    servos={
        joint: servo
        for finger, name in enumerate(PLACES)
        for joint, servo in servos(finger, name).items()
    },
    reach=Reach(
        rest=np.array([-0.024, 0.0, 0.024]),
        least=np.array([[0, 0.0115, 0.023], [0, 0, 0.0115], [0, 0, 0]]),
        most=np.array([[0, 0.0515, 0.0755], [0, 0, 0.0515], [0, 0, 0]]),
        outward=np.array([0.039, 0.015, -0.009]),
        inward=np.array([-0.009, 0.015, 0.039]),
        forearm_width=forearm.WIDTH,
    ),
)


if __name__ == "__main__":
    import sys

    song = sys.argv[1] if len(sys.argv) > 1 else "CMajorScaleOneHand"
    performance = cadenza.play(song, scene=cadenza.SceneConfig(hand="claw:CLAW"))
    print(f"F1 {performance.metrics['f1']:.3f}")
    performance.save("played/claw")
