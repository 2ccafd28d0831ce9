"""Inverse model of a strike: what makes a key sound at a time within a step, and at a speed."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.presses import Strike
from cadenza.keyboards.keyboard import Keyboard
from cadenza.music.goals import NO_ONSETS, Onsets
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of

_DELAY = 0.003  # [s] of all onsets: least in sum for those near the beginning and near the end
_AFTER_BEGINNING, _BEFORE_END = 0.008, 0.003  # [s] of a control step
_SLOWEST = 0.07  # [s] time constant of fingers that strike: with 0.1 s they play worse for it
_RISE_TIME = 0.02  # [s] in which a key reaches its speed, a usual time from rest to sounding


class StrikeModel(NamedTuple):
    """A fingertip without load whose servos are first-order lags.

    A constant control through a step takes it from its height at the beginning towards another one:
    z(t) = z_0 + (z_1 - z_0) g(t), with g(t) = (1 - exp(-t / tau)) / (1 - exp(-dt / tau)). Heights
    count from the fingertip on a key at rest, upwards [m].
    """

    time_constant: float  # tau [s]
    dt: float  # control step [s]

    def heights(self, time: Array, speed: Array, depth: Array) -> tuple[Array, Array]:
        """Heights before and after the step with which a fingertip passes a depth in time.

        Args:
            time: (N,) from the beginning of the step on [s].
            speed: (N,) of the fingertips then, downwards [m/s].
            depth: (N,) below a key at rest [m].
        """
        tau = self.time_constant
        decay, reached = np.exp(-time / tau), 1 - np.exp(-self.dt / tau)
        fallen = speed * tau * (1 - decay) / decay
        left = speed * tau * (decay - 1 + reached) / decay
        return fallen - depth, -left - depth

    def response(self, time: Array, speed: Array, depth: Array) -> Array:
        """(N, 2, 2) the derivatives of time and log2(speed) by both heights, downwards."""
        tau, reached = self.time_constant, 1 - np.exp(-self.dt / self.time_constant)
        growth = np.exp(time / tau)
        before = np.stack([-speed * growth, -np.log(2) * speed * tau * (growth - 1)], axis=1)
        after = np.stack(
            [
                speed * (reached - 1) * growth,
                np.log(2) * speed * tau * (1 + (reached - 1) * growth),
            ],
            axis=1,
        )
        return np.linalg.inv(np.stack([before, after], axis=1))


class PlannedStrikes(NamedTuple):
    """How N keys are to begin to sound, by step and then by key, (N,) each."""

    step: NDArray[np.intp]
    key: NDArray[np.intp]
    time: Array  # when, from the beginning of the step on [s]
    speed: Array  # the angular speed of the key then [rad/s]

    def by_place(self, first: int, last: int) -> dict[tuple[int, int], Strike]:
        """Strikes in the steps from `first` to before `last`, by step and key."""
        rows = slice(*np.searchsorted(self.step, [first, last]))
        step, key, time, speed = (values[rows].tolist() for values in self)
        strikes = map(Strike, time, speed)
        return dict(zip(zip(step, key, strict=True), strikes, strict=True))


NO_STRIKES = PlannedStrikes(NO_ONSETS.step, NO_ONSETS.key, NO_ONSETS.time, NO_ONSETS.time)


def planned_strikes(onsets: Onsets, scene: Scene, dt: float) -> PlannedStrikes:
    """Strikes for onsets in control steps of `dt` [s], all a little late.

    A key that sounds too near the beginning of its step would often sound a step early, and one
    too near the end a step late. Fingers that are too slow strike nothing: keys are only to sound
    in the right steps.
    """
    if strike_model(scene, dt).time_constant > _SLOWEST:
        return NO_STRIKES
    latest = max(dt - _BEFORE_END, _AFTER_BEGINNING)
    time = np.clip(onsets.time + _DELAY, min(_AFTER_BEGINNING, dt), latest)
    speed = scene.keyboard.speed(onsets.velocity)
    return PlannedStrikes(onsets.step, onsets.key, time, speed)


@lru_cache(maxsize=8)
def strike_model(scene: Scene, dt: float) -> StrikeModel:
    """Model of the fingers of a scene, whose lag is the median of their servos."""
    servos = servos_of(scene)
    lag = (servos.damping / servos.stiffness)[servos.finger >= 0]
    return StrikeModel(float(np.median(lag)), dt)


def striking_torque(keyboard: Keyboard, key: NDArray[np.intp], speed: Array) -> Array:
    """Torques (N,) that keys need to sound at angular speeds (N,) [N m].

    Against the spring where they sound, the damping, and the inertia of key and hinge, which reach
    the speed in a usual time.
    """
    spring = keyboard.spring
    mass = np.where(keyboard.is_black[key], keyboard.black.mass, keyboard.white.mass)
    inertia = spring.armature + mass * (2 * keyboard.half_size[key, 0]) ** 2 / 3
    angle = keyboard.sounds_from[key] - spring.reference
    return spring.stiffness * angle + (spring.damping + inertia / _RISE_TIME) * speed
