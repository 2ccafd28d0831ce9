"""The sensors of robots: late, biased, drifting and noisy."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.scene.kinematics import TIP, Kinematics
from cadenza.sim.protocol import Path, State
from cadenza.tasks.draw_ranges import BIAS, MINUTE, OBSERVATION, OBSERVATION_LATENCY, DrawRanges

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


def sensed_state(
    ranges: DrawRanges, state: State, offset: Any, late: tuple[Any, Path, Any] | None
) -> State:
    """The state as sensors measure it, with true fingertips, of NumPy or JAX.

    Args:
        ranges: the ranges of the sensors.
        state: the true state.
        offset: (N, J + K + F) errors of joints [m, rad], key states and touch [N].
        late: None without delay; else the physics steps (N,) by which sensors are late, the past
            states, the newest last, and (N, W, 3, K) onsets, offsets and speeds of keys that the
            next W steps observe.
    """
    if late is not None:
        steps, past, events = late
        now = np.arange(len(steps)), -1 - steps
        qpos, qvel, key_qpos, touch = (values[now] for values in past)
        onset, end, speed = events[:, 0].swapaxes(0, 1)
        state = state._replace(hand_qpos=qpos, hand_qvel=qvel, key_qpos=key_qpos, touch=touch)
        state = state._replace(key_onset=onset, key_offset=end, key_speed=speed)
    joints, travel = state.hand_qpos.shape[1], ranges.scene.keyboard.travel
    of_joints, of_keys = offset[:, :joints], offset[:, joints : joints + len(travel)]
    of_touch = offset[:, joints + len(travel) :]
    touch = (state.touch + of_touch).clip(0.0)
    state = state._replace(hand_qpos=state.hand_qpos + of_joints, touch=touch)
    if not ranges.config.key_noise:
        return state
    pressed = (state.key_qpos / travel + of_keys).clip(0.0, 1.0)
    return state._replace(key_qpos=pressed * travel)


class Senses:
    """The sensors of N environments.

    Attributes:
        path: receives the simulation's path through each step; None if nothing is late.
    """

    def __init__(self, ranges: DrawRanges, num_envs: int) -> None:
        """Take the ranges that episodes draw from."""
        self._ranges, config = ranges, ranges.config
        self._has_errors = bool(ranges.observation_noise.any() or ranges.bias.any())
        self._offset = np.zeros((num_envs, len(ranges.bias)))
        self._bias, self._wandered = np.zeros_like(self._offset), np.zeros_like(self._offset)
        self._rngs = [np.random.default_rng(0)] * num_envs  # until episodes begin
        self._late = np.zeros(num_envs, np.intp)  # in physics steps
        self.path: Path | None = None
        self._history, self._events = Path(*[np.zeros((num_envs, 0))] * 4), np.zeros((num_envs, 0))
        if max_late := ranges.steps_of(config.observation_latency[1]):
            at_rest = State.at_rest(ranges.scene, num_envs)
            self.path = Path.still(at_rest, ranges.substeps + 1)
            self._history = Path.still(at_rest, max_late + 1)
            slots = max_late // ranges.substeps + 2
            self._events = np.full((num_envs, slots, 3, ranges.scene.keyboard.num_keys), np.nan)
        self._kinematics: Kinematics | None = None

    @property
    def per_env(self) -> list[Any]:
        """Arrays and lists of what each environment has of its own."""
        arrays = [self._offset, self._bias, self._wandered, self._rngs, self._late, self._events]
        return [*arrays, *self._history]

    def begin(self, env: int, seed: int, drawn: Mapping[str, Array]) -> None:
        """Begin an episode with its draws `drawn`; noise and drift follow from `seed`."""
        self._rngs[env] = self._ranges.generator(seed, OBSERVATION)
        self._bias[env], self._wandered[env] = drawn.get(BIAS, 0.0), 0.0
        self._late[env] = self._ranges.steps_of(drawn.get(OBSERVATION_LATENCY, 0.0))

    def start(self, env_ids: Ids, state: State) -> None:
        """Sense environments that have been reset."""
        if self.path is not None:
            still = Path.still(state, self._history.key_qpos.shape[1])
            for past, now in zip(self._history, still, strict=True):
                past[env_ids] = now[env_ids]
            self._events[env_ids] = np.nan
        self._draw(env_ids)

    def step(self, state: State, moving: slice | Ids) -> None:
        """Sense environments that have taken a step, to `state`."""
        if self.path is not None:
            for past, way in zip(self._history, self.path, strict=True):
                length = past.shape[1]
                past[moving] = np.concatenate([past[moving], way[moving, 1:]], axis=1)[:, -length:]
            self._events[moving, :-1] = self._events[moving, 1:]
            self._events[moving, -1] = np.nan
            for env in np.arange(len(self._late))[moving].tolist():
                self._delay_events(env, state)
        self._draw(np.arange(len(self._late))[moving])

    def _delay_events(self, env: int, state: State) -> None:
        """Keep the events of keys of the last step for the steps that observe them."""
        onset, offset, speed = (values[env] for values in state.key_events)
        dt, late = self._ranges.control_timestep, self._late[env] * self._ranges.physics_timestep
        for row, times in enumerate((onset, offset)):
            keys = np.flatnonzero(~np.isnan(times))
            slots, within = np.divmod(times[keys] + late, dt)
            self._events[env, slots.astype(int), row, keys] = within
            if not row:
                self._events[env, slots.astype(int), 2, keys] = speed[keys]

    def _draw(self, env_ids: Ids) -> None:
        """Draw the errors of the next observations."""
        if not self._has_errors:
            return
        ranges, drift = self._ranges, self._ranges.config.drift
        for env in env_ids.tolist():
            rng, noise = self._rngs[env], ranges.observation_noise
            self._offset[env] = noise * rng.standard_normal(len(noise))
            if ranges.bias.any():
                wander = drift * ranges.bias * np.sqrt(ranges.control_timestep / MINUTE)
                self._wandered[env] += wander * rng.standard_normal(len(noise))
                self._offset[env] += self._bias[env] + self._wandered[env]

    def sensed(self, state: State) -> State:
        """The state as sensors measure it; the true one if they are perfect.

        Joints, keys and touch are late and have errors. Velocities of joints are late, and
        fingertips follow from the measured joints. Onsets and offsets of keys are observed late,
        with the times at which they are. The rest is true.
        """
        if not self._has_errors and self.path is None:
            return state
        late = None if self.path is None else (self._late, self._history, self._events)
        state = sensed_state(self._ranges, state, self._offset, late)
        return state._replace(fingertip_xpos=self._fingertips(state))

    def _fingertips(self, state: State) -> Array:
        """(N, F, 3) where fingertips would be on the nominal robot with these joints [m]."""
        tips, scene = state.fingertip_xpos.copy(), self._ranges.scene
        if scene.sides:
            self._kinematics = kinematics = self._kinematics or Kinematics(scene)
            postures = state.hand_qpos @ kinematics.servos.of_joints
            tips[:, scene.present_fingers] = kinematics.points(postures)[:, :, TIP]
        return tips

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_kinematics": None}
