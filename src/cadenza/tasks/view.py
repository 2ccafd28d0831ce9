"""The view of an agent: the constants of a task, and values that it must not change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.keyboards.keyboard import Keyboard
from cadenza.keyboards.loudness import VELOCITIES
from cadenza.music.score import Score
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import Simulation, State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack, UpcomingOnsets

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ids = NDArray[np.intp]


def to_range(action: NDArray[Any], low: Array, high: Array) -> Array:
    """Map [-1, 1] to [low, high], `(..., A)`; values outside are clipped."""
    value: Array = action * ((high - low) / 2) + (low + high) / 2
    return value.clip(low, high)


def from_range(ctrl: NDArray[Any], low: Array, high: Array) -> Array:
    """Map [low, high] to [-1, 1], `(..., A)`: the inverse of `to_range`."""
    action: Array = (ctrl - (low + high) / 2) / ((high - low) / 2)
    return action.clip(-1.0, 1.0)


TOUCH_RANGE = 5.0  # greatest force that is observed [N]; a key is held down with about one


def observed_touch(force: NDArray[Any]) -> NDArray[Any]:
    """The observation of forces on fingertips (...) [N]: 0 to 1, from `TOUCH_RANGE` on."""
    return force.__array_namespace__().minimum(force / TOUCH_RANGE, 1.0)


def observed_onsets(
    time: NDArray[Any], velocity: NDArray[Any], control_timestep: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The observation of onsets (...): times as fractions of a step, velocities of 127, or 0."""
    xp = time.__array_namespace__()
    share = xp.clip(time / control_timestep, 0.0, 1.0)  # which rounding may leave
    return share.astype(xp.float32), (velocity / VELOCITIES[1]).astype(xp.float32)


def onset_parts(
    due: UpcomingOnsets, state: State, keyboard: Keyboard, config: TaskConfig
) -> dict[str, NDArray[np.float32]]:
    """The parts of an observation that `TaskConfig.onset_goals` adds, by their names.

    `due` are the notes around, `state` is that after the last step.
    """
    dt, shown = config.control_timestep, config.lookahead_steps + 2
    notes = observed_onsets(due.time[:, :shown], due.velocity[:, :shown], dt)
    keys = observed_key_onsets(state, keyboard, dt)
    names = "goal_onset", "goal_velocity", "key_onset", "key_velocity"
    return dict(zip(names, notes + keys, strict=True))


def observed_key_onsets(
    state: State, keyboard: Keyboard, control_timestep: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The observation of keys that began to sound in the last step, (N, K): when, and how loud.

    See `observed_onsets`; 0 for the others.
    """
    xp = state.key_onset.__array_namespace__()
    began = ~xp.isnan(state.key_onset)
    velocity = keyboard.velocity(xp.where(began, state.key_speed, 0.0))
    return observed_onsets(
        xp.where(began, state.key_onset, 0.0), xp.where(began, velocity, 0.0), control_timestep
    )


@dataclass(frozen=True, eq=False)
class TaskSpec:
    """The constants of a task: the same in all environments and episodes."""

    config: TaskConfig
    scene: Scene
    """The nominal hands and keys, without the draws of `TaskConfig.randomization`."""
    action_low: Array
    """(A,) the least action in actuator units [m, rad], the pedal last."""
    action_high: Array
    """(A,) the greatest action in actuator units [m, rad], the pedal last."""
    observation_layout: dict[str, slice]
    """Name -> slice of an observation."""

    def __repr__(self) -> str:
        sizes = f"{self.action_size} actions, {self.observation_size} observations"
        return f"TaskSpec({self.scene!r}, {sizes})"

    @property
    def action_size(self) -> int:
        """A, the number of actuators and the pedal."""
        return len(self.action_low)

    @property
    def observation_size(self) -> int:
        """D, the number of values in an observation."""
        return max(part.stop for part in self.observation_layout.values())

    def observation(
        self, goal: Any, fingering: Any, keys: Any, pedal: Any, state: State, due: Any
    ) -> NDArray[np.float32]:
        """(N, D) observations, see `PianoTask.observation`.

        `keys` (N, K) are measured key states, `due` the notes around, if onsets are observed.
        The arrays are NumPy's or those of a library like it, which can compile this.
        """
        parts = {"goal": goal, "fingering": fingering, "key_state": keys, "pedal": pedal}
        parts |= {"joints": state.hand_qpos, "joint_velocities": state.hand_qvel}
        parts["touch"] = observed_touch(state.touch[:, self.scene.present_fingers])
        if due is not None:
            parts |= onset_parts(due, state, self.scene.keyboard, self.config)
        xp = keys.__array_namespace__()
        flat = [
            parts[name].reshape(-1, part.stop - part.start).astype(xp.float32)
            for name, part in self.observation_layout.items()
        ]
        return xp.concat(flat, axis=1)

    def scale_action(self, action: NDArray[Any]) -> Array:
        """Actions in actuator units from [-1, 1], `(..., A)`; values outside are clipped."""
        return to_range(action, self.action_low, self.action_high)

    def unscale_action(self, ctrl: NDArray[Any]) -> Array:
        """Actions in [-1, 1] from actuator units, `(..., A)`: the inverse of `scale_action`."""
        return from_range(ctrl, self.action_low, self.action_high)


def task_spec(config: TaskConfig, scene: Scene) -> TaskSpec:
    """The constants of a task in a scene."""
    keys = scene.keyboard.num_keys
    sizes = {"goal": (config.lookahead_steps + 1) * (keys + 1)}
    if config.fingering != "off" and scene.sides:
        sizes["fingering"] = scene.fingers.count
    if config.onset_goals:
        steps = config.lookahead_steps + 2
        sizes |= {"goal_onset": steps * keys, "goal_velocity": steps * keys}
    sizes |= {"key_state": keys, "pedal": 1}
    if scene.sides:
        sizes["joints"] = len(scene.hand_joint_names)
        if config.joint_velocities:
            sizes["joint_velocities"] = sizes["joints"]
    if scene.sides and scene.config.touch:
        sizes["touch"] = len(scene.fingertip_sites)
    if config.onset_goals:
        sizes |= {"key_onset": keys, "key_velocity": keys}
    return TaskSpec(config, scene, scene.action_low, scene.action_high, layout_of(sizes))


def layout_of(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Name -> slice of the parts of a vector that follow each other and have these sizes."""
    ends = np.cumsum(list(sizes.values())).tolist()
    return {
        name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)
    }


@dataclass(frozen=True, eq=False)
class View:
    """N environments before their next control step. The arrays must not be changed."""

    task: TaskSpec
    env_ids: Ids
    """(N,) numbers of the environments."""
    tracks: tuple[GoalTrack, ...]
    """(N,) tracks that they play: score, fingers, and goals of every control step."""
    num_steps: Ids
    """(N,) control steps of the episode."""
    steps: Ids
    """(N,) control steps since the beginning of the song."""
    playing: Mask
    """(N,) whether each takes the next step; the actions of the others are ignored."""
    state: State
    """Positions and speeds of hands and keys, fingertips, forces, all (N, ...), as sensors measure
    them."""
    observation: NDArray[np.float32]
    """(N, D) observations, with noise if there is any, see `TaskSpec.observation_layout`."""
    fingers: NDArray[np.int8]
    """(N, K) the fingers for the keys of the next step, -1 for none."""
    reward: Array
    """(N,) reward of the last step, 0 before the first."""
    simulation: Simulation
    """The physics of all environments of the task, for planners that copy it. Not to be stepped."""

    def __repr__(self) -> str:
        return f"View({len(self.env_ids)} environments, {self.task!r})"

    @property
    def scores(self) -> tuple[Score, ...]:
        """(N,) the score of each, as the task has changed it."""
        return tuple(track.score for track in self.tracks)

    @property
    def goal(self) -> Mask:
        """(N, L + 1, K + 1) keys and pedal of the next step and of the L that are looked ahead."""
        ahead = self.observation[:, self.task.observation_layout["goal"]]
        return ahead.reshape(len(ahead), -1, self.task.scene.keyboard.num_keys + 1) > 0

    def of(self, row: int) -> View:
        """The view of the environment in `row` alone: N is 1."""
        only = slice(row, row + 1)
        same = ("task", "state", "simulation")
        rows = {f.name: getattr(self, f.name)[only] for f in fields(self) if f.name not in same}
        return replace(self, state=State._make(values[only] for values in self.state), **rows)
