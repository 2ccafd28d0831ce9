"""An episode: everything that was recorded while the hands played a score.

`episode.npz` holds the arrays below under their own names, the same names that the recordings of
the published system use. T control steps, A actuators (right hand's, left hand's, pedal), J hand
joints, B moving hand bodies.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import read_arrays, write_atomically


@dataclass(frozen=True)
class Episode:
    """T control steps of `dt` [s]; every row is what held *after* that step's action.

    arrays: name -> array, among them
        action (T, A)                 actuator units, the pedal last, 0..1
        goal_keys (T, 88) bool        keys that should sound after the step
        goal_fingers (T, 88) int8     which finger should press them, -1 none or unknown
        goal_sustain (T,) bool        pedal that should be down
        key_qpos (T, 88)              [rad], key_activation (T, 88) bool
        sustain_activation (T,) bool
        hand_qpos, hand_qvel (T, J)   [m, rad] and [m/s, rad/s]
        fingertip_xpos (T, 10, 3)     [m]
        body_xpos (T, B, 3), body_xquat (T, B, 4)   float32 poses of the hand bodies, w x y z
        reward_total (T,), reward_<term> (T,)
    scene: what is needed to draw it, see `cadenza.model.drawing`.
    """

    song: str
    dt: float
    arrays: Mapping[str, NDArray[Any]]
    scene: Mapping[str, Any]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.arrays[name]

    @property
    def num_steps(self) -> int:
        return len(self.arrays["action"])

    def save(self, path: Path) -> None:
        """Writes the episode to `path` (.npz); a reader sees the old file or the whole new one."""
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
    """Reads what `Episode.save` wrote.

    Raises:
        CadenzaError: the file is not there or is not an episode.
    """
    arrays = read_arrays(path)
    try:
        song, dt = str(arrays.pop("song")), float(arrays.pop("dt"))
        scene = json.loads(str(arrays.pop("scene", "{}")))
    except (ValueError, TypeError, KeyError) as error:
        raise CadenzaError(f"{path}: not an episode recorded by cadenza ({error})") from error
    return Episode(song, dt, arrays, scene)
