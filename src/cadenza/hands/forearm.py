"""The forearm that every hand is mounted on: its slides and hinges, and their servos.

Figures from the hands of RoboPianist (Zakka et al., CoRL 2023; PyPI robopianist 1.0.10). In the
forearm's frame z runs along it towards the keys, y out of the back of the hand.
"""

from dataclasses import dataclass

from cadenza.fingers import Side
from cadenza.hands.servo import Servo

FOREARM = "forearm"  # the link that carries a hand
ALONG_KEYBOARD = "forearm_tx"  # the servo that slides a hand along the keyboard
FORWARDS = "forearm_ty"  # the servo that slides it towards the keys and back
WIDTH = 0.149
"""Two forearms touch when they are nearer than this [m]: twice the radius of their shells."""

MOUNT_XZ = (0.4, 0.13)  # [m]
MOUNT_QUAT = (-0.5, -0.5, 0.5, 0.5)


@dataclass(frozen=True)
class ForearmJoint:
    """A slide or hinge between world and forearm with a critically damped servo of gain `kp`.

    The axis is given in the forearm's frame; `mirrored` hinges turn the other way on the left.
    """

    hinge: bool
    axis: tuple[float, float, float]
    kp: float
    range: tuple[float, float]
    mirrored: bool = False


JOINTS: dict[str, ForearmJoint] = {
    "tx": ForearmJoint(False, (-1, 0, 0), 300.0, (0.0, 0.0)),  # range: the whole keyboard
    "ty": ForearmJoint(False, (0, 0, 1), 300.0, (0.0, 0.06)),
    "tz": ForearmJoint(False, (0, 1, 0), 1000.0, (-0.04, 0.0)),
    "roll": ForearmJoint(True, (0, 0, 1), 300.0, (-0.25, 0.25)),
    "pitch": ForearmJoint(True, (1, 0, 0), 50.0, (0.0, 0.15)),
    "yaw": ForearmJoint(True, (0, -1, 0), 300.0, (-0.25, 0.25), mirrored=True),
}

_STIFF = Servo(ease=0.05, acceleration=20.0, stride=0.05)  # planners leave them where they are
SERVOS: dict[str, Servo] = {
    ALONG_KEYBOARD: Servo(0.0, 1000.0, 2.0, 0.05, noise=0.01, correction=0.03),
    FORWARDS: Servo(0.01, 0.05, 8.0, 0.05, noise=0.005, correction=0.015),
} | {f"forearm_{name}": _STIFF for name in ("tz", "roll", "pitch", "yaw")}


def mount_y(side: Side, hand_spacing: float) -> float:
    """The place along the keyboard at which the forearm of one side is mounted [m]."""
    return (hand_spacing if side == "right" else -hand_spacing) / 2


def joint_range(name: str, y: float, half_length: float) -> tuple[float, float]:
    """The range of a forearm's joint [m, rad], by its name in `JOINTS`.

    "tx" reaches all of a keyboard of twice the `half_length`, from a mount at `y` [m].
    """
    return (-half_length - y, half_length - y) if name == "tx" else JOINTS[name].range
