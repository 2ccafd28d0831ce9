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
_NUM_WHITE = 52
_WHITE_WIDTH, _GAP = 0.0225, 0.001
_SPACING = _WHITE_WIDTH + _GAP  # from one white key's centre to the next
_KEYBOARD_LENGTH = _NUM_WHITE * _WHITE_WIDTH + (_NUM_WHITE - 1) * _GAP
KEYBOARD_HALF_LENGTH = _KEYBOARD_LENGTH / 2

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
BLACK = KeyShape(
    (0.045, 0.005, 0.009), -0.15 / 2 + 0.09 / 2, 0.0225 + 0.0125 - 0.018 / 2, 0.02, 0.008
)

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


# Of white keys A B C D E F G: how many white keys of its group of black keys came before.
_FROM_GROUP_START = np.array([2, 0, 0, 1, 0, 0, 1])


def _key_y() -> NDArray[np.float64]:
    """(88,) where the keys lie along the keyboard [m], summed in the published order.

    Black keys stand where the white key to their right begins, counted from the first white key
    of their group of two or three; only the lowest stands in the middle of the gap. Recorded
    performances depend on the last bit: a finger catches on a key or it does not.
    """
    white_before = np.cumsum(~IS_BLACK) - 1  # number of the white key that is, or is to the left
    group = white_before - _FROM_GROUP_START[white_before % 7]
    start = -_KEYBOARD_LENGTH * 0.5
    y = np.where(
        IS_BLACK,
        start + (white_before - group + 1) * _SPACING + group * _SPACING,
        start + _WHITE_WIDTH * 0.5 + white_before * _SPACING,
    )
    y[1] = _WHITE_WIDTH + 0.5 * (-_KEYBOARD_LENGTH + _GAP)
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


def holding_torque(key: int) -> float:
    """What holds the key at its stop against its spring [N m]."""
    return float(_STIFFNESS * (KEY_TRAVEL[key] - _SPRING_REFERENCE))


def key_name(key: int) -> str:
    """Name of the key's body; its joint and geom carry the same name."""
    return f"{'black' if IS_BLACK[key] else 'white'}_key_{key}"


def add_piano(spec: mujoco.MjSpec, actuated: bool) -> None:
    """Adds base and keys to the world of `spec`; `actuated` keys follow a position target."""
    piano = spec.worldbody.add_body(name="piano")
    _add_base(piano)
    for key in range(NUM_KEYS):
        _add_key(piano, key)
    if actuated:
        for key in range(NUM_KEYS):
            _add_key_actuator(spec, key)


def _add_base(piano: mujoco.MjsBody) -> None:
    base = piano.add_body(name="base", pos=(-0.127, 0.0, 0.02))
    base.add_geom(
        name="base",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.05, KEYBOARD_HALF_LENGTH, 0.02),
        density=1000,
        rgba=BASE_RGBA,
        **_CONTACT,
    )


def _add_key(piano: mujoco.MjsBody, key: int) -> None:
    shape, name = _shape(key), key_name(key)
    body = piano.add_body(name=name, pos=KEY_CENTRE[key])
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
