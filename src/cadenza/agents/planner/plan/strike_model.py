"""Inverse model of a strike: the fingertip heights for a time and a speed of the key."""

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

_DELAY = 0.003  # [s] of all onsets: minimises errors at the beginning and the end of steps
_AFTER_BEGINNING, _BEFORE_END = 0.008, 0.003  # [s] of a control step, which timed strikes avoid
_MAX_TIME_CONSTANT = 0.07  # [s] of fingers with timed strikes: with 0.1 s, these make them worse
_RISE_TIME = 0.02  # [s] in which a key reaches its speed, a usual time from rest to sounding


class StrikeModel(NamedTuple):
    """A fingertip without load whose servos are first-order lags.

    A constant control during a step takes it from one height towards another:
    z(t) = z_0 + (z_1 - z_0) g(t), with g(t) = (1 - exp(-t / tau)) / (1 - exp(-dt / tau)). Heights
    count from the fingertip on a key at rest, upwards [m].
    """

    time_constant: float  # tau [s]
    dt: float  # control step [s]

    def heights(self, time: Array, speed: Array, depth: Array) -> tuple[Array, Array]:
        """Heights (N,) before and after a step in which a fingertip passes a depth at a time.

        Args:
            time: (N,) from the beginning of the step on [s].
            speed: (N,) of the fingertips at that time, downwards [m/s].
            depth: (N,) below a key at rest [m].
        """
        tau = self.time_constant
        decay, share = np.exp(-time / tau), 1 - np.exp(-self.dt / tau)
        fall = speed * tau * (1 - decay) / decay
        rest = speed * tau * (decay - 1 + share) / decay
        return fall - depth, -rest - depth

    def response(self, time: Array, speed: Array, depth: Array) -> Array:
        """(N, 2, 2) derivatives of time and log2(speed) by both heights, downwards."""
        tau, share = self.time_constant, 1 - np.exp(-self.dt / self.time_constant)
        growth = np.exp(time / tau)
        before = np.stack([-speed * growth, -np.log(2) * speed * tau * (growth - 1)], axis=1)
        after = np.stack(
            [
                speed * (share - 1) * growth,
                np.log(2) * speed * tau * (1 + (share - 1) * growth),
            ],
            axis=1,
        )
        return np.linalg.inv(np.stack([before, after], axis=1))


class PlannedStrikes(NamedTuple):
    """Targets of N timed strikes, by step and then by key, (N,) each."""

    step: NDArray[np.intp]
    key: NDArray[np.intp]
    time: Array  # the time from the beginning of the step on [s]
    speed: Array  # the angular speed of the key then [rad/s]

    def by_place(self, first: int, last: int) -> dict[tuple[int, int], Strike]:
        """Strikes in the steps from `first` to before `last`, by step and key."""
        rows = slice(*np.searchsorted(self.step, [first, last]))
        step, key, time, speed = (values[rows].tolist() for values in self)
        strikes = map(Strike, time, speed)
        return dict(zip(zip(step, key, strict=True), strikes, strict=True))


NO_STRIKES = PlannedStrikes(NO_ONSETS.step, NO_ONSETS.key, NO_ONSETS.time, NO_ONSETS.time)


def planned_strikes(onsets: Onsets, scene: Scene, dt: float) -> PlannedStrikes:
    """Timed strikes for onsets in control steps of `dt` [s], all a little late.

    They keep clear of the beginning and the end of a step: they might fall into the step before or
    after. Fingers that are too slow have no timed strikes, only presses in the right steps.
    """
    if strike_model(scene, dt).time_constant > _MAX_TIME_CONSTANT:
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

    It acts against the spring, the damping, and the inertia of key and hinge, which reach their
    speed in a usual time.
    """
    spring = keyboard.spring
    mass = np.where(keyboard.is_black[key], keyboard.black.mass, keyboard.white.mass)
    inertia = spring.armature + mass * (2 * keyboard.half_size[key, 0]) ** 2 / 3
    angle = keyboard.sounds_from[key] - spring.reference
    return spring.stiffness * angle + (spring.damping + inertia / _RISE_TIME) * speed
