"""The ranges of domain randomization, and its draws for an episode."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.configs import MAX_COUNT, check_ranges
from cadenza.errors import CadenzaError
from cadenza.scene.randomization import KEY_SOUNDING, POSE_FIELDS, SCALED_FIELDS, shapes
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of, sliding
from cadenza.tasks.config import DomainRandomization

Array = NDArray[np.float64]

_KINDS = "joint", "slide"
_MIN_FACTOR = {"mass": 0.01, "key_travel": 0.5, KEY_SOUNDING: 0.1}  # 0 for all others
_MAX_FACTOR = dict.fromkeys(SCALED_FIELDS, 100.0) | {"key_travel": 2.0, KEY_SOUNDING: 1.0}
LATENCY, OBSERVATION_LATENCY, SEED = "latency", "observation_latency", "seed"
BIAS, GRAVITY_TILT = "bias", "gravity_tilt"
SERVO_RANGES = {"speed": 100.0, "dead_band": 1.0, "backlash": 1.0}
"""What is drawn for servos, from ranges for joints and for slides such as `joint_speed`, and the
maximum of these."""
_MAX = {f"{kind}_{name}": high for name, high in SERVO_RANGES.items() for kind in _KINDS}
_MAX |= {LATENCY: 1.0, OBSERVATION_LATENCY: 1.0}  # [s]
_MAX_NUMBER = {
    "joint_noise": math.pi,  # [rad], half a turn
    "joint_bias": math.pi,
    "slide_noise": 1.0,  # [m], nearly the keyboard
    "slide_bias": 1.0,
    "key_noise": 1.0,  # all the way down
    "touch_noise": 100.0,  # [N]
    "touch_bias": 100.0,
    "drift": 100.0,
    "control_noise": 1.0,  # half the range
    "joint_control_noise": math.pi,
    "slide_control_noise": 1.0,
    "keyboard_offset": 0.1,  # [m]
    "keyboard_tilt": 0.3,  # [rad]
    "mount_offset": 0.1,
    "mount_tilt": 0.3,
    "gravity_tilt": math.pi,
    "push": 1000.0,  # [N]
}
_PREFIX = "randomization."  # the field of `TaskConfig`
CONTROL, OBSERVATION, PUSH = "control", "observation", "push"
_STREAMS = (
    *("mass", "friction", "joint_damping", "joint_friction", "armature", "servo_gain"),
    *("key_spring", LATENCY, CONTROL, OBSERVATION),
    *("force_limit", "key_travel", KEY_SOUNDING, *POSE_FIELDS, GRAVITY_TILT, PUSH),
    *(*SERVO_RANGES, OBSERVATION_LATENCY, BIAS),
)
"""All that has a random generator of its own, in an order on which all draws depend."""
PUSHES = 1.0  # a second, on average
MINUTE = 60.0  # [s] in which biases wander as far as `DomainRandomization.drift` says


class DrawRanges:
    """The ranges of a task in its scene. All draws of an episode follow from them and from a seed.

    Each field has a generator of its own, so that its draws do not depend on other fields.

    Attributes:
        config: the ranges and standard deviations.
        shapes: name -> shape of all draws for an episode, see `draws`.
        of_model: the names among them of draws that change the model.
        control_noise: (A,) standard deviations of noise on controls, in actuator units.
        observation_noise: (J + K + F,) standard deviations of noise on observed joints [m, rad],
            then on key states, then on touch [N].
        bias: (J + K + F,) standard deviations of constant errors of observations.
        weight: (bodies,) the part of their weight that is compensated [N].
        has_latency: whether actions may be late.
        num_sent: the number of actions that are kept, for the greatest latency.
    """

    def __init__(self, config: DomainRandomization, scene: Scene, control_timestep: float) -> None:
        """Take the nominal scene and the time between two actions [s].

        Raises CadenzaError if a range makes no sense.
        """
        _check(config)
        self.config, self.scene = config, scene
        self.control_timestep = control_timestep
        self.physics_timestep = scene.model.opt.timestep
        self.substeps = round(control_timestep / self.physics_timestep)
        self.low, self.high = scene.action_low[:-1], scene.action_high[:-1]
        of_scene, slides = shapes(scene), sliding(scene)
        self.control_noise = config.control_noise * (self.high - self.low) / 2
        self.control_noise += self._of_each(config.joint_control_noise, config.slide_control_noise)
        of_task = {**dict.fromkeys(SERVO_RANGES, self.low.shape), GRAVITY_TILT: (2,), LATENCY: ()}
        counts = scene.keyboard.num_keys, scene.fingers.count
        self.observation_noise, self.bias = (
            np.concatenate([np.where(slides, slide, joint), np.repeat([key, touch], counts)])
            for slide, joint, key, touch in (
                (config.slide_noise, config.joint_noise, config.key_noise, config.touch_noise),
                (config.slide_bias, config.joint_bias, 0.0, config.touch_bias),
            )
        )
        self.of_model = tuple(filter(self._is_on, of_scene))
        self.shapes = {n: s for n, s in (of_scene | of_task).items() if self._is_on(n)}
        if self.bias.any():
            self.shapes[BIAS] = self.bias.shape
        if self._is_on(OBSERVATION_LATENCY):
            self.shapes[OBSERVATION_LATENCY] = ()
        model = scene.model
        self.weight = model.body_mass * model.body_gravcomp * model.opt.gravity[2]
        self.has_latency = bool(config.latency[1])
        self.num_sent = self.steps_of(config.latency[1]) // self.substeps + 2

    def _is_on(self, name: str) -> bool:
        """Whether a field of the configuration, or one of those for servos, is not the default."""
        names = [f"{kind}_{name}" for kind in _KINDS] if name in SERVO_RANGES else [name]
        return any(getattr(self.config, n) != getattr(DomainRandomization, n) for n in names)

    def _of_each(self, joint: float, slide: float) -> Array:
        """(A,) the value for joints or that for slides, as each servo moves one or the other."""
        if not self.scene.sides:  # keys, which turn
            return np.full(self.low.shape, joint)
        return servos_of(self.scene).of_each(joint, slide)

    def generator(self, seed: int, name: str) -> np.random.Generator:
        """The generator of a field, or of noise, in an episode with this seed."""
        return np.random.default_rng([seed, _STREAMS.index(name)])

    def factors(self, seed: int) -> dict[str, Array]:
        """The factors, offsets and tilts by which the model changes."""
        return {name: self._draw(seed, name) for name in self.of_model}

    def draws(self, seed: int) -> dict[str, Array]:
        """The draws for an episode, by name.

        `factors`; draws from `SERVO_RANGES` for servos, (A,) each; gravity_tilt, the angles (2,) of
        gravity about the axes x and y [rad]; bias, the first errors of sensors (J + K + F,);
        latency and observation_latency, rounded to physics steps [s].
        """
        return {name: self._draw(seed, name) for name in self.shapes}

    def _draw(self, seed: int, name: str) -> Array:
        rng, shape = self.generator(seed, name), self.shapes[name]
        if name == BIAS:
            return self.bias * rng.standard_normal(shape)
        if name in SERVO_RANGES:
            joint, slide = (getattr(self.config, f"{kind}_{name}") for kind in _KINDS)
            return rng.uniform(*map(self._of_each, joint, slide))
        field = getattr(self.config, name)
        low, high = field if isinstance(field, tuple) else (-field, field)
        drawn = rng.uniform(low, high, shape)
        if name in (LATENCY, OBSERVATION_LATENCY):
            drawn = self.steps_of(drawn) * self.physics_timestep
        return np.asarray(drawn)

    def steps_of(self, latency: Any) -> int:
        """The physics steps of a latency, rounded half to even."""
        return round(latency / self.physics_timestep)

    def resting_ctrl(self, start: Any) -> Any:
        """(N, A) the controls that keep the joints (N, J) at their start, of NumPy or JAX."""
        if not self.scene.sides:  # keys, which are up
            start, of_joints = start[:, :0], np.zeros((0, len(self.low)))
        else:
            of_joints = servos_of(self.scene).of_joints
        return (start @ of_joints).clip(self.low, self.high)


def moved_setpoints(ranges: DrawRanges, setpoint: Any, ctrl: Any, drawn: Mapping[str, Any]) -> Any:
    """The setpoints of servos after controls (N, A), with speed limits, dead band and backlash.

    Args:
        ranges: the ranges of the servos.
        setpoint: (N, 2, A) the previous setpoints of each servo's motor and of its load, of NumPy
            or JAX.
        ctrl: (N, A) the controls.
        drawn: draws from `SERVO_RANGES`, (N, A) each, as far as they are on.

    Returns (N, 2, A).
    """
    xp = setpoint.__array_namespace__()
    motor, load = setpoint[:, 0], setpoint[:, 1]
    change = ctrl - motor
    if "dead_band" in drawn:
        change = xp.where(abs(change) < drawn["dead_band"], 0.0, change)
    if "speed" in drawn:  # 0 is no limit
        speed = drawn["speed"]
        limit = xp.where(speed > 0, speed * ranges.control_timestep, xp.inf)
        change = change.clip(-limit, limit)
    motor = motor + change
    play = drawn.get("backlash", 0.0) / 2
    return xp.stack([motor, load.clip(motor - play, motor + play)], axis=1)


def _check(config: DomainRandomization) -> None:
    limits = {n: (_MIN_FACTOR.get(n, 0.0), high) for n, high in _MAX_FACTOR.items()}
    limits |= {name: (0.0, high) for name, high in _MAX.items()}
    for name, (minimum, maximum) in limits.items():
        low, high = getattr(config, name)
        if not minimum <= low <= high <= maximum:
            raise CadenzaError(
                f"{_PREFIX}{name} {low} {high}: give the least and the greatest, both from "
                f"{minimum:g} to {maximum:g}"
            )
    numbers = {name: (0.0, high) for name, high in _MAX_NUMBER.items()}
    seeds = (name for name in (SEED, "robot") if getattr(config, name) is not None)
    numbers |= dict.fromkeys(seeds, (0, MAX_COUNT))
    check_ranges(config, numbers, _PREFIX)
