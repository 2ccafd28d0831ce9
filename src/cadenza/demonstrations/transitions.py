"""Recorded episodes as transitions of the Gymnasium environments, for other libraries."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.demonstrations.dataset import LOOKAHEAD, Dataset, Floats, check_values
from cadenza.sim.render import Renderer
from cadenza.tasks.view import TaskSpec, from_range, task_spec

# Options of the environments whose transitions these are
SHOWN: dict[str, Any] = {"n_steps_lookahead": LOOKAHEAD, "n_seconds_lookahead": None}


class Transitions(NamedTuple):
    """The T steps of an episode."""

    # Keys and pedal of the next step and of the L after it (T + 1, (L + 1) * (K + 1)), 0 or 1
    goal: Floats
    # 1 for each finger that has a key to press next (T + 1, F); F is 0 where the task shows no
    # fingers
    fingering: Floats
    # When the notes around begin (T + 1, (L + 2) * K), as a share of their step; as all parts of
    # onsets, (T + 1, 0) where the task does not show them
    goal_onset: Floats
    goal_velocity: Floats  # how loud these notes are (T + 1, (L + 2) * K), 0 to 1
    key_state: Floats  # depth of the keys (T + 1, K), 0 to 1
    pedal: Floats  # depth of the pedal (T + 1, 1), 0 to 1
    joints: Floats  # joint positions (T + 1, J) [m, rad]
    joint_velocities: Floats  # (T + 1, J) [m/s, rad/s], or (T + 1, 0) where the task shows none
    touch: Floats  # forces on fingertips (T + 1, F), 0 to 1, or (T + 1, 0) without sensors
    key_onset: Floats  # when keys began to sound in the step before (T + 1, K), as a share of it
    key_velocity: Floats  # how loud they did (T + 1, K), 0 to 1
    velocities: Floats  # joint velocities (T + 1, J) [m/s, rad/s], whatever the task shows
    chosen: Floats  # actions that the demonstrator chose (T, A + 1), in [-1, 1], without noise
    played: Floats  # actions that were played before each state (T + 1, A + 1); 0 before the first
    reward: NDArray[np.float64]  # reward of each step (T,)

    @property
    def observation(self) -> Floats:
        """The observations (T + 1, D), laid out as in `PianoTask.observation`."""
        return np.concatenate([*self[: Transitions._fields.index("velocities")]], axis=1)

    @property
    def environment(self) -> Floats:
        """The observations (T + 1, D - J) without the hands."""
        return self._replace(joints=self.joints[:, :0]).observation


def shown_by(dataset: Dataset) -> TaskSpec:
    """The constants of the environments, such as the layout of their observations."""
    return task_spec(replace(dataset.episodes[0].facts.task, **SHOWN), dataset.scene)


def transitions(dataset: Dataset, number: int) -> Transitions:
    """The transitions of an episode; raises CadenzaError if a file is not there, or is damaged."""
    scene, steps = dataset.scene, dataset.episodes[number].steps
    check_values(dataset.episodes[number], scene)
    count = len(steps) - 1
    numbers = dataset.first[number] + np.arange(count)
    batch, onsets = dataset.batch(numbers, LOOKAHEAD), dataset.onsets(numbers, LOOKAHEAD)
    limits = scene.action_low, scene.action_high
    # After the last step, environments go on showing its goals.
    here = np.minimum(np.arange(count + 1), count - 1)
    shown = slice(None if dataset.shows_onsets else 0)
    moving = slice(None if dataset.shows_velocities else 0)
    when, how_loud = (values[here].reshape(count + 1, -1)[:, shown] for values in onsets)
    fingering = batch.fingering[here, 0].astype(np.float32)
    return Transitions(
        goal=batch.goal[here].reshape(count + 1, -1).astype(np.float32),
        fingering=fingering if dataset.shows_fingers else fingering[:, :0],
        goal_onset=when,
        goal_velocity=how_loud,
        key_state=steps["key_state"],
        pedal=steps["pedal"][:, None],
        joints=steps["hand_qpos"],
        joint_velocities=steps["hand_qvel"][:, moving],
        touch=steps["touch"] if scene.config.touch else steps["hand_qpos"][:, :0],
        key_onset=steps["key_onset"][:, shown],
        key_velocity=steps["key_velocity"][:, shown],
        velocities=steps["hand_qvel"],
        chosen=from_range(steps["action"][:-1], *limits).astype(np.float32),
        played=steps["played"],
        reward=steps["previous_reward"][1:],
    )


def pictures_of(dataset: Dataset, number: int, renderer: Renderer) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures (height, width, 3) that environments show, T + 1 of an episode."""
    steps, keyboard = dataset.episodes[number].steps, dataset.scene.keyboard
    sounding = np.unpackbits(steps["sounding"], axis=1, count=keyboard.num_keys).view(bool)
    goal = np.pad(dataset.goals(number).keys, [(1, 0), (0, 0)])
    depth = steps["key_state"] * keyboard.travel
    for seen in zip(steps["hand_qpos"], depth, sounding, goal, strict=True):
        yield np.ascontiguousarray(renderer.frame(*seen))
