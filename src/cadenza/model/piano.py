"""The piano: 88 hinged keys and a base.

Figures from the model of RoboPianist (Zakka et al., CoRL 2023; PyPI robopianist 1.0.10): sizes in
[m], masses in [kg], angles in [rad]. World frame: x towards the player, y to the player's right,
z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

NUM_KEYS = 88
SOUND_TOLERANCE = 0.00872665  # a key sounds within half a degree of its stop [rad]

_BLACK_IN_OCTAVE = (1, 4, 6, 9, 11)  # counted from A
_SPACING = 0.0235  # from one white key's centre to the next
KEYBOARD_HALF_LENGTH = 0.6105
_BLACK_Y_OFFSET = 0.0005  # black keys lie this far to the right of the middle of their neighbours

IS_BLACK: NDArray[np.bool_] = np.array([k % 12 in _BLACK_IN_OCTAVE for k in range(NUM_KEYS)])


@dataclass(frozen=True)
class KeyShape:
    """One kind of key; the hinge runs along y through the end away from the player."""

    half_size: tuple[float, float, float]
    centre_x: float
    centre_z: float
    mass: float
    dip: float  # how far the player's end goes down

    @property
    def travel(self) -> float:
        """Angle from rest to stop [rad]."""
        return float(np.arctan2(self.dip, 2 * self.half_size[0]))


WHITE = KeyShape((0.075, 0.01125, 0.01125), 0.0, 0.01125, 0.04, 0.01)
BLACK = KeyShape((0.045, 0.005, 0.009), -0.03, 0.026, 0.02, 0.008)

_STIFFNESS = 2.0  # [N m / rad]
_SPRING_REFERENCE = -np.deg2rad(1.0)
_DAMPING = 0.05  # [N m s / rad]
_ARMATURE = 0.001  # [kg m^2]
_SERVO_STIFFNESS = 30.0  # [N m / rad], of the piano that plays itself
_SERVO_DAMPING = 0.3  # [N m s / rad]
_CONTACT = {"contype": 0, "conaffinity": 1, "solref": (0.01, 1.0)}

WHITE_RGBA = (0.93, 0.92, 0.89, 1.0)
BLACK_RGBA = (0.08, 0.08, 0.09, 1.0)
BASE_RGBA = (0.16, 0.14, 0.15, 1.0)


def _shape(key: int) -> KeyShape:
    return BLACK if IS_BLACK[key] else WHITE


def _key_y() -> NDArray[np.float64]:
    white = np.flatnonzero(~IS_BLACK)
    y = np.zeros(NUM_KEYS)
    y[white] = (np.arange(len(white)) - (len(white) - 1) / 2) * _SPACING
    black = np.flatnonzero(IS_BLACK)
    y[black] = (y[black - 1] + y[black + 1]) / 2 + _BLACK_Y_OFFSET
    y[1] -= _BLACK_Y_OFFSET  # the published table starts without the offset
    return y


KEY_TRAVEL: NDArray[np.float64] = np.array([_shape(k).travel for k in range(NUM_KEYS)])
KEY_HALF_SIZE: NDArray[np.float64] = np.array([_shape(k).half_size for k in range(NUM_KEYS)])
KEY_CENTRE: NDArray[np.float64] = np.stack(
    [
        [_shape(k).centre_x for k in range(NUM_KEYS)],
        _key_y(),
        [_shape(k).centre_z for k in range(NUM_KEYS)],
    ],
    axis=1,
)


def key_name(key: int) -> str:
    """Name of the key's body; its joint and geom carry the same name."""
    return f"{'black' if IS_BLACK[key] else 'white'}_key_{key}"


def add_piano(spec: mujoco.MjSpec, actuated: bool) -> None:
    """Adds base and keys to the world of `spec`; `actuated` keys follow a position target."""
    _add_base(spec)
    for key in range(NUM_KEYS):
        _add_key(spec, key)
    if actuated:
        for key in range(NUM_KEYS):
            _add_key_actuator(spec, key)


def _add_base(spec: mujoco.MjSpec) -> None:
    base = spec.worldbody.add_body(name="base", pos=(-0.127, 0.0, 0.02))
    base.add_geom(
        name="base",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.05, KEYBOARD_HALF_LENGTH, 0.02),
        density=1000,
        rgba=BASE_RGBA,
        **_CONTACT,
    )


def _add_key(spec: mujoco.MjSpec, key: int) -> None:
    shape, name = _shape(key), key_name(key)
    body = spec.worldbody.add_body(name=name, pos=KEY_CENTRE[key])
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=(0, 1, 0),
        pos=(-shape.half_size[0], 0, 0),
        range=(0, shape.travel),
        stiffness=_STIFFNESS,
        springref=_SPRING_REFERENCE,
        damping=_DAMPING,
        armature=_ARMATURE,
    )
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=shape.half_size,
        mass=shape.mass,
        rgba=BLACK_RGBA if IS_BLACK[key] else WHITE_RGBA,
        **_CONTACT,
    )


def _add_key_actuator(spec: mujoco.MjSpec, key: int) -> None:
    """A servo stiff enough to hold the key at its stop against its spring.

    The published piano applies a torque equal to the control, which hardly moves the key, and
    calls a key pressed when its control passes the middle of the range. Here the key really goes
    down, and sounds when it does.
    """
    name = key_name(key)
    actuator = spec.add_actuator(
        name=name,
        target=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        ctrlrange=(0, _shape(key).travel),
    )
    actuator.set_to_position(kp=_SERVO_STIFFNESS, kv=_SERVO_DAMPING)
