"""Episodes: recordings of how the hands played a score.

`episode.npz` holds the arrays below under their own names, which are those of the recordings of the
published system. There are T control steps, A actuators (right hand's, left hand's, pedal), J hand
joints, B moving hand bodies, K keys, and F fingers of two hands, the right one's first.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, quoted
from cadenza.files import (
    FLAGS,
    INTEGERS,
    NUMBERS,
    TEXT,
    ArrayOf,
    checked,
    parsed_json,
    read_arrays,
    write_atomically,
)
from cadenza.fingers import SIDES

_LOWEST_PITCH = 21  # A0, for older recordings, which are all of pianos
_NUM_PITCHES = 128  # MIDI's
_MAX_SECONDS = 4 * 3600.0
_MAX_BYTES = 2 * 2**30  # an hour at 20 steps a second takes a sixth of it


class _DrawnGeom(TypedDict):
    body: int
    finger: int | None
    palm: NotRequired[bool]
    type: str
    size: list[float]
    pos: list[float]
    quat: list[float]
    rgba: list[float]


class _DrawnKey(TypedDict):
    pos: list[float]
    size: list[float]
    hinge: list[float]
    axis: list[float]
    travel: Annotated[float, Meta(gt=0)]
    black: bool


class _DrawnJoint(TypedDict):
    type: str
    axis: list[float]
    index: int


class _DrawnBody(TypedDict):
    parent: int
    pos: list[float]
    quat: list[float]
    joints: list[_DrawnJoint]


_SCENE: dict[str, Any] = {  # types of what `cadenza.scene.drawing` makes
    "bodies": list[str],
    "skeleton": list[_DrawnBody],
    "geoms": list[_DrawnGeom],
    "keys": list[_DrawnKey],
}

KEY_EVENTS = ("key_onset", "key_offset", "key_velocity")
"""The arrays that say when in a step keys began and ceased to sound [s], and how loud."""

_ARRAYS = {
    "song": ArrayOf(TEXT, needed=True),
    "dt": ArrayOf(NUMBERS, needed=True, finite=True),
    "scene": ArrayOf(TEXT),
    "action": ArrayOf(NUMBERS, ("T", "A"), needed=True),
    "lowest_pitch": ArrayOf(INTEGERS),
    "goal_keys": ArrayOf(FLAGS, ("T", "K")),
    "goal_fingers": ArrayOf(INTEGERS, ("T", "K")),
    "goal_sustain": ArrayOf(FLAGS, ("T",)),
    "key_qpos": ArrayOf(NUMBERS, ("T", "K")),
    "key_activation": ArrayOf(FLAGS, ("T", "K")),
    **{name: ArrayOf(NUMBERS, ("T", "K")) for name in KEY_EVENTS},
    **{
        f"{side}_{name}": ArrayOf(NUMBERS, ("T", "K"))
        for side in SIDES
        for name in ("key_qpos", *KEY_EVENTS)
    },
    "sustain_activation": ArrayOf(FLAGS, ("T",)),
    "hand_qpos": ArrayOf(NUMBERS, ("T", "J")),
    "hand_qvel": ArrayOf(NUMBERS, ("T", "J")),
    "fingertip_xpos": ArrayOf(NUMBERS, ("T", "F", 3)),
    "touch": ArrayOf(NUMBERS, ("T", "F")),
    "body_xpos": ArrayOf(NUMBERS, ("T", "B", 3)),
    "body_xquat": ArrayOf(NUMBERS, ("T", "B", 4)),
    "reward_*": ArrayOf(NUMBERS, ("T",)),
    "*": ArrayOf(NUMBERS + TEXT, None),
}


@dataclass(frozen=True)
class Episode:
    """A recorded episode of T control steps. A row of an array is the state *after* a step."""

    song: str
    """The title of the song."""
    dt: float
    """The time of a control step [s]."""
    arrays: Mapping[str, NDArray[Any]]
    """Arrays by name, among them:

    - `action` (T, A), in actuator units, the pedal last, 0..1
    - `lowest_pitch` () int, MIDI number of the first key
    - `goal_keys` (T, K) bool, the keys that should sound after the step
    - `goal_fingers` (T, K) int8, which of the F fingers should press them, -1 for none
    - `goal_sustain` (T,) bool, whether the pedal should be down
    - `key_qpos` (T, K) [rad]
    - `key_activation` (T, K) bool, the keys that sound
    - `key_onset`, `key_offset` (T, K), when keys began or ceased to sound in the step, from its
      beginning on [s], NaN where they did not; float32
    - `key_velocity` (T, K), the MIDI velocity of keys at their onsets, else NaN; float32
    - `right_key_qpos`, `left_key_qpos` (T, K) [rad], of hands that play apart: what each does with
      the keys; `key_qpos` is the larger of the two; likewise ``right_key_onset`` and the others
    - `sustain_activation` (T,) bool, whether the pedal is down
    - `hand_qpos`, `hand_qvel` (T, J) [m, rad] and [m/s, rad/s]
    - `fingertip_xpos` (T, F, 3) [m]
    - `touch` (T, F) normal forces on the fingertips [N], where there are sensors
    - `body_xpos` (T, B, 3) [m] and `body_xquat` (T, B, 4), w x y z, of the hands' bodies, float32
    - `reward_total` and ``reward_<term>`` (T,)
    - ``randomization_<name>`` (...) the draws for the episode, if any, see
      `cadenza.tasks.randomization.Randomization`; `DomainRandomization` with this
      `randomization_seed` as its seed draws the same
    """
    scene: Mapping[str, Any]
    """The shapes with which a page draws it, see `cadenza.scene.drawing`."""

    def __repr__(self) -> str:
        return f"Episode({self.song!r}, {self.num_steps} steps of {self.dt:g} s)"

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The array of this name; raises CadenzaError if there is none."""
        if name not in self.arrays:
            raise CadenzaError(f"the episode of {quoted(self.song)} holds no array named {name}")
        return self.arrays[name]

    @property
    def num_steps(self) -> int:
        """T, the number of control steps."""
        return len(self.arrays["action"])

    @property
    def lowest_pitch(self) -> int:
        """MIDI number of the first key; A0 where the recording has none."""
        return int(self.arrays.get("lowest_pitch", _LOWEST_PITCH))

    @property
    def key_depth(self) -> NDArray[np.float64] | None:
        """(T, K) depth of each key, from 0 at rest to 1 at its stop; None if scene has no keys."""
        travel = [key["travel"] for key in self.scene.get("keys", ())]
        return np.clip(self["key_qpos"] / travel, 0.0, 1.0) if travel else None

    def save(self, path: Path) -> None:
        """Write the episode to `path` (.npz), atomically."""
        with write_atomically(path) as file:
            np.savez_compressed(
                file,
                allow_pickle=False,
                song=np.str_(self.song),
                dt=np.float64(self.dt),
                scene=np.str_(json.dumps(self.scene)),
                **self.arrays,
            )


def load_episode(path: Path) -> Episode:
    """Read an episode that was saved; raises CadenzaError if it is missing, or something else."""
    arrays = read_arrays(path, _ARRAYS, _MAX_BYTES)
    song, dt = str(arrays.pop("song")), float(arrays.pop("dt"))
    scene = parsed_json(str(arrays.pop("scene", "{}")), dict[str, Any], f"{path}, scene")
    for name in scene.keys() & _SCENE.keys():
        checked(scene[name], _SCENE[name], f"{path}, {name} of scene")
    steps, bodies = len(arrays["action"]), len(scene.get("bodies", ()))
    if not (dt > 0 and 0 < steps * dt <= _MAX_SECONDS):
        raise CadenzaError(f"{path}: {steps} steps of {dt:g} s; an episode lasts at most 4 hours")
    keys = arrays.get("key_qpos", np.empty((0, len(scene.get("keys", ()))))).shape[1]
    lowest = int(arrays.get("lowest_pitch", _LOWEST_PITCH))
    if not 0 <= lowest <= lowest + keys <= _NUM_PITCHES:
        raise CadenzaError(f"{path}: {keys} keys from pitch {lowest} on; MIDI has {_NUM_PITCHES}")
    if len(scene.get("keys", ())) not in (0, keys):
        raise CadenzaError(f"{path}: key_qpos does not match the keys in scene")
    if bodies != arrays.get("body_xpos", np.empty((0, bodies))).shape[1]:
        raise CadenzaError(f"{path}: body_xpos does not match the {bodies} bodies in scene")
    return Episode(song, dt, arrays, scene)
