"""A keyboard as a value, and its part of the MuJoCo scene.

World frame: x towards the player, y to the player's right, z up; the keyboard's middle is at y = 0.
Sizes in [m], masses in [kg], angles in [rad].
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cadenza.configs import NotNegative, Positive, wrong_types
from cadenza.errors import CadenzaError
from cadenza.keyboards.loudness import PianoAction

Array = NDArray[np.float64]
Colour = tuple[float, float, float, float]

_BLACK_IN_OCTAVE = (1, 3, 6, 8, 10)  # counted from C
_WHITE_FROM_A = {9: 0, 11: 1, 0: 2, 2: 3, 4: 4, 5: 5, 7: 6}  # by place in the octave from C
# For white keys A to G: the number of white keys before it in its group of black keys.
_FROM_GROUP_START = np.array([2, 0, 0, 1, 0, 0, 1])


@dataclass(frozen=True)
class KeyShape:
    """A kind of key: a box whose hinge runs along y through the end away from the player."""

    half_size: tuple[Positive, Positive, Positive]
    centre_x: float
    centre_z: float
    mass: Positive
    dip: Positive
    """Depth to which the player's end goes down [m]."""
    rgba: Colour

    @property
    def travel(self) -> float:
        """The angle from rest to stop [rad]."""
        return float(np.arctan2(self.dip, 2 * self.half_size[0]))

    @property
    def top(self) -> float:
        """The height of its upper face [m]."""
        return self.centre_z + self.half_size[2]


@dataclass(frozen=True)
class KeySpring:
    """The spring that brings a key back up."""

    stiffness: float
    """Torque per angle [N m/rad]."""
    reference: float
    """Angle at which the spring would be slack [rad]."""
    damping: float
    """Torque per speed [N m s/rad]."""
    armature: float
    """Additional inertia of the hinge [kg m^2]."""


@dataclass(frozen=True)
class KeyServo:
    """The servo of a key of a piano that plays itself."""

    stiffness: float
    """Torque per angle [N m/rad]."""
    damping: float
    """Torque per speed [N m s/rad]."""


@dataclass(frozen=True)
class Base:
    """The box behind the keys."""

    pos: tuple[float, float, float]
    half_depth: Positive
    half_height: Positive
    density: Positive
    rgba: Colour


@dataclass(frozen=True)
class Keyboard:
    """A row of K keys. Arrays over the keys run from the lowest to the highest."""

    name: str
    lowest_pitch: int
    """MIDI number of key 0, which is white."""
    num_keys: int
    """K, the number of keys."""
    white: KeyShape
    black: KeyShape
    gap: NotNegative
    """Gap between white keys [m]."""
    spring: KeySpring
    servo: KeyServo
    base: Base
    sound_tolerance: float
    """The distance from its stop at which a key sounds [rad]."""
    contact_solref: tuple[float, float]
    """MuJoCo's time constant and damping ratio of contacts with keys."""
    action: PianoAction = field(default_factory=PianoAction)
    """How loud a key sounds."""

    def __post_init__(self) -> None:
        """Check the figures; raises CadenzaError if there can be no such keyboard."""
        for fault in _faults(self):
            raise CadenzaError(f"keyboard {self.name}: {fault}")

    # Pitches

    @property
    def pitches(self) -> range:
        """The MIDI numbers of the keys."""
        return range(self.lowest_pitch, self.lowest_pitch + self.num_keys)

    @cached_property
    def is_black(self) -> NDArray[np.bool_]:
        """(K,) whether each key is black."""
        return np.isin(np.array(self.pitches) % 12, _BLACK_IN_OCTAVE)

    def shape(self, key: int) -> KeyShape:
        """The shape of one key."""
        return self.black if self.is_black[key] else self.white

    # Places and motion

    @property
    def spacing(self) -> float:
        """The distance from one white key's centre to the next [m]."""
        return 2 * self.white.half_size[1] + self.gap

    @property
    def bounds(self) -> NDArray[np.float64]:
        """The lowest and the highest x, y and z of all keys at rest, (2, 3) [m]."""
        low, high = self.centre - self.half_size, self.centre + self.half_size
        return np.stack([low.min(axis=0), high.max(axis=0)])

    @property
    def half_length(self) -> float:
        """The distance from the middle to either end [m]."""
        whites = self._num_whites
        return (whites * (2 * self.white.half_size[1]) + (whites - 1) * self.gap) / 2

    @property
    def _num_whites(self) -> int:
        return int(np.count_nonzero(~self.is_black))

    @cached_property
    def half_size(self) -> Array:
        """(K, 3) half sizes of the keys' boxes [m]."""
        return np.array([self.shape(k).half_size for k in range(self.num_keys)])

    @cached_property
    def centre(self) -> Array:
        """(K, 3) centres of the keys' boxes at rest [m]."""
        shapes = [self.shape(k) for k in range(self.num_keys)]
        x, z = [shape.centre_x for shape in shapes], [shape.centre_z for shape in shapes]
        return np.stack([x, self._y(), z], axis=1)

    def _y(self) -> Array:
        """(K,) places of the keys along the keyboard [m], summed in the published order.

        Black keys stand where the white key to their right begins, counted from the first white
        key of their group of two or three; where that is not on the keyboard, in the middle of the
        gap. Recorded performances depend on the last bit: a finger catches on a key or it does not.
        """
        width, start = 2 * self.white.half_size[1], -self.half_length
        white_before = np.cumsum(~self.is_black) - 1  # the white key that is, or is to the left
        letter = (white_before + _WHITE_FROM_A[self.lowest_pitch % 12]) % 7
        group = white_before - _FROM_GROUP_START[letter]
        white = start + width * 0.5 + white_before * self.spacing
        black = start + (white_before - group + 1) * self.spacing + group * self.spacing
        in_gap = (white_before + 1) * width + white_before * self.gap + (0.5 * self.gap + start)
        return np.where(self.is_black, np.where(group < 0, in_gap, black), white)

    @cached_property
    def grid_y(self) -> Array:
        """(K,) places along the keyboard as if black keys stood halfway between white ones [m]."""
        place = np.cumsum(~self.is_black) - 1 + 0.5 * self.is_black
        return self.spacing * (place - (self._num_whites - 1) / 2)

    @cached_property
    def travel(self) -> Array:
        """(K,) angle of each key from rest to stop [rad]."""
        return np.array([self.shape(k).travel for k in range(self.num_keys)])

    @cached_property
    def sounds_from(self) -> Array:
        """(K,) angle from which each key sounds [rad]."""
        return self.travel - self.sound_tolerance

    @cached_property
    def holding_torque(self) -> Array:
        """(K,) torque that holds each key at its stop against its spring [N m]."""
        return self.spring.stiffness * (self.travel - self.spring.reference)

    # Loudness

    def velocity(self, speed: Array) -> Array:
        """The MIDI velocities of keys that begin to sound at these angular speeds (...) [rad/s].

        White and black keys lift the same hammers by the same lever: that of a white key. The
        arrays are NumPy's or those of a library like it, which can compile this.
        """
        return self.action.velocity(2 * self.white.half_size[0] * speed)

    def speed(self, velocity: ArrayLike) -> Array:
        """The angular speeds [rad/s] at which keys sound with these MIDI velocities."""
        return self.action.key_speed(velocity) / (2 * self.white.half_size[0])

    # The scene

    def key_name(self, key: int) -> str:
        """The name of the key's body, joint and geom."""
        return f"{'black' if self.is_black[key] else 'white'}_key_{key}"

    def add_to(self, spec: mujoco.MjSpec, keys: range, actuated: bool) -> None:
        """Add base and keys to the world of `spec`; `actuated` keys follow a position target."""
        piano = spec.worldbody.add_body(name="piano")
        self._add_base(piano)
        for key in keys:
            self._add_key(piano, key)
        if actuated:
            for key in keys:
                self._add_key_actuator(spec, key)

    def _add_base(self, piano: mujoco.MjsBody) -> None:
        body = piano.add_body(name="base", pos=self.base.pos)
        body.add_geom(
            name="base",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(self.base.half_depth, self.half_length, self.base.half_height),
            density=self.base.density,
            rgba=self.base.rgba,
            contype=0,
            conaffinity=1,
            solref=self.contact_solref,
        )

    def _add_key(self, piano: mujoco.MjsBody, key: int) -> None:
        shape, name = self.shape(key), self.key_name(key)
        body = piano.add_body(name=name, pos=self.centre[key])
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=(0, 1, 0),
            pos=(-shape.half_size[0], 0, 0),
            range=(0, shape.travel),
            stiffness=self.spring.stiffness,
            springref=self.spring.reference,
            damping=self.spring.damping,
            armature=self.spring.armature,
        )
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=shape.half_size,
            mass=shape.mass,
            rgba=shape.rgba,
            contype=0,
            conaffinity=1,
            solref=self.contact_solref,
        )

    def _add_key_actuator(self, spec: mujoco.MjSpec, key: int) -> None:
        """A servo stiff enough to hold the key at its stop against its spring.

        The published piano applies a torque equal to the control, which hardly moves the key, and
        calls a key pressed when its control passes the middle of the range. Here the key really
        goes down, and sounds when it does.
        """
        name = self.key_name(key)
        actuator = spec.add_actuator(
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrlrange=(0, self.shape(key).travel),
        )
        actuator.set_to_position(kp=self.servo.stiffness, kv=self.servo.damping)


def _faults(keyboard: Keyboard) -> Iterator[str]:
    yield from wrong_types(keyboard)
    first, count = keyboard.lowest_pitch, keyboard.num_keys
    if not 0 <= first < first + count <= 128:
        yield f"has {count} keys from pitch {first} on; MIDI's pitches are 0 to 127"
    if first % 12 in _BLACK_IN_OCTAVE:
        yield f"its first key, lowest_pitch {first}, is black; begin with a white one"
    travel = min(keyboard.white.travel, keyboard.black.travel)
    if not 0 < keyboard.sound_tolerance < travel:
        yield (
            f"sound_tolerance is {keyboard.sound_tolerance}; "
            f"give more than 0 and less than a key turns, {travel:.3f} rad"
        )
