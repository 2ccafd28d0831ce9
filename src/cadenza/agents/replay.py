"""Plays actions that were recorded or planned before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.errors import CadenzaError
from cadenza.files import read_arrays
from cadenza.tasks.piano_task import PianoTask


class ReplayAgent:
    """Plays `plan` (T, A), actions in actuator units, the pedal last."""

    def __init__(self, plan: Array) -> None:
        self._plan = plan

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        """Raises:
        CadenzaError: the plan is not as wide as the actions or not as long as the episode.
        """
        steps, width = self._plan.shape
        if width != task.action_size:
            raise CadenzaError(
                f"the plan has {width} actions a step and this task {task.action_size}: "
                f"{_other_space(task)}"
            )
        if steps != task.sheets.num_steps[0]:
            raise CadenzaError(
                f"the plan has {steps} steps and the song {task.sheets.num_steps[0]}: "
                "was it made for another song, tempo or initial silence?"
            )
        self._step = 0

    def act(self) -> Array:
        action = self._plan[self._step]
        self._step += 1
        return action


def _other_space(task: PianoTask) -> str:
    flag = "no-reduced" if task.scene.config.reduced_action_space else "reduced"
    return f"was it made for other hands or the other action space (--{flag}-action-space)?"


def physics_of(path: Path) -> dict[str, Any]:
    """The fields of `SceneConfig` that say in which physics a plan was made.

    A plan is played in the physics it was made in, since a micrometre can decide whether a finger
    catches on a key. Recordings of the published system do not say; there, keys never sleep.
    """
    arrays = read_arrays(path)
    return {
        "physics": str(arrays.get("physics", "published")),
        "sleeping_keys": bool(arrays.get("sleeping_keys", False)),
    }


def load_plan(path: Path) -> NDArray[np.float64]:
    """The array `action` (T, A) of a plan or of a recorded episode.

    Raises:
        CadenzaError: the file is not there or holds no such array.
    """
    arrays = read_arrays(path)
    if "action" not in arrays:
        raise CadenzaError(f"{path}: holds no array named action, so it is not a plan")
    plan = arrays["action"]
    if plan.ndim != 2 or plan.dtype.kind not in "fiub" or not np.isfinite(plan).all():
        raise CadenzaError(
            f"{path}: action is {plan.dtype} of shape {plan.shape}; give finite numbers of shape "
            "(steps, actions)"
        )
    return plan.astype(np.float64)
