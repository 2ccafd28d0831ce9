"""Policies as folders that can be copied to another machine and played there."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import FLOATS, ArrayOf, checked
from cadenza.learning.observation import Inputs, inputs_of
from cadenza.learning.old_formats import warn_of_old_policy
from cadenza.learning.policy import Activation, Policy
from cadenza.learning.policy_agent import PolicyAgent
from cadenza.learning.ranges import Ranges
from cadenza.learning.residual import Plan
from cadenza.learning.sealed_folder import read_sealed, write_sealed
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

_KIND = "policy"
_FORMAT = 2
_READ = (1, _FORMAT)  # the first had no ranges
_PLAN, _RANGES = "plan/", "ranges/"  # what names of their arrays begin with
_CHANGE_THE_PLAN = (
    "control_timestep",
    "trim_silence",
    "stretch",
    "transpose",
    "initial_buffer_time",
    "random_hand_position",
    "random_stretch",
    "random_pitch_shift",
    "random_octave_shift",
    "hands",
    "reduced_action_space",
    "forearm_dofs",
    "hand_spacing",
    "attachment_yaw",
)
_CHANGE_WHAT_IS_OBSERVED = (
    "n_steps_lookahead",
    "n_seconds_lookahead",
    "control_timestep",
    "fingering",
    "hands",
    "reduced_action_space",
    "forearm_dofs",
)
_EXPECTED = {
    "plan/ctrl": ArrayOf(FLOATS, ("steps", "servos"), finite=True),
    "plan/gain": ArrayOf(FLOATS, ("steps", "servos", 2), finite=True),
    "plan/expected": ArrayOf(FLOATS, ("steps + 1", "servos", 2), finite=True),
    "plan/pedal": ArrayOf(FLOATS, ("steps",), finite=True),
    "plan/reach": ArrayOf(FLOATS, ("servos",), finite=True),
    "ranges/joints": ArrayOf(FLOATS, (2, "joints"), finite=True),
    "ranges/actions": ArrayOf(FLOATS, (2, "actions"), finite=True),
    "mean/kernel": ArrayOf(FLOATS, ("features", "actions"), needed=True, finite=True),
    "mean/bias": ArrayOf(FLOATS, ("actions",), needed=True, finite=True),
    "log_std/kernel": ArrayOf(FLOATS, ("features", "actions"), needed=True, finite=True),
    "log_std/bias": ArrayOf(FLOATS, ("actions",), needed=True, finite=True),
    "hidden_*/kernel": ArrayOf(FLOATS, ("*", "*"), finite=True),
    "hidden_*/bias": ArrayOf(FLOATS, ("*",), finite=True),
}


@dataclass(frozen=True)
class _Facts:
    """What is written beside the arrays."""

    format: int
    activation: Activation
    log_std_range: tuple[float, float]
    inputs: Inputs
    residual: bool
    task: TaskConfig
    scene: SceneConfig
    score: Score
    about: dict[str, Any]


@dataclass(frozen=True)
class LearntPolicy:
    """A policy and all that is needed to play with it."""

    policy: Policy
    inputs: Inputs
    plan: Plan | None
    """What it corrects, if it does."""
    ranges: Ranges | None
    """On whose scale it sees and acts, if not on the task's."""
    task: TaskConfig
    scene: SceneConfig
    score: Score
    """What it was trained to play."""

    @property
    def agent(self) -> PolicyAgent:
        """For one that is played."""
        return PolicyAgent(self.policy, self.inputs, self.plan, self.ranges)

    def has_learnt(self, score: Score) -> bool:
        """Whether it was trained to play the notes and the pedal of `score`."""
        notes = score.without_fingers().notes
        return (notes, score.pedal) == (self.score.without_fingers().notes, self.score.pedal)

    def check(self, name: str, task: PianoTask) -> None:
        """Raises:
        CadenzaError: `name`, as it is known, corrects another plan than is needed for `task`, or
            observes other things than that shows.
        """
        options: tuple[str, ...] = () if self.plan is None else _CHANGE_THE_PLAN
        if self.inputs.total != inputs_of(task, None, self.plan is not None).total:
            options += _CHANGE_WHAT_IS_OBSERVED
        learnt, here = (
            vars(self.task) | vars(self.scene),
            vars(task.config) | vars(task.scene.config),
        )
        for option in options:
            if here[option] != learnt[option]:
                raise CadenzaError(
                    f"{name}: was trained with {option} {learnt[option]}, but here it is "
                    f"{here[option]}; leave out that option, or train a new policy"
                )


def save_policy(folder: Path, learnt: LearntPolicy, about: dict[str, Any]) -> None:
    """Writes `learnt` to `folder`, and with it what else there is to know `about` it.

    Raises:
        CadenzaError: there is no room; what the folder held is still there.
    """
    facts = {
        "format": _FORMAT,
        "about": about,
        "activation": learnt.policy.activation,
        "log_std_range": learnt.policy.log_std_range,
        "inputs": asdict(learnt.inputs),
        "residual": learnt.plan is not None,
        "task": asdict(learnt.task),
        "scene": asdict(learnt.scene),
        "score": asdict(learnt.score),
    }
    try:
        parts = _named(_PLAN, learnt.plan) | _named(_RANGES, learnt.ranges)
        write_sealed(folder, _KIND, facts, learnt.policy.weights | parts)
    except OSError as error:
        raise CadenzaError(
            f"{folder}: could not be written ({error.strerror}); make room there"
        ) from error


def load_policy(folder: Path) -> LearntPolicy:
    """Raises:
    CadenzaError: there is no policy, or not one that this version wrote, unchanged.
    """
    if (folder / "best").is_dir():
        raise CadenzaError(
            f"{folder}: is the folder of a training run; its best policy is {folder / 'best'}"
        )
    plain, arrays = read_sealed(folder, _KIND, _EXPECTED)
    warn_of_old_policy(folder)
    if (number := plain.get("format")) not in _READ:
        raise CadenzaError(
            f"{folder}: this policy has format {number!r}, but this version reads only up to "
            f"{_FORMAT}; install the version of Cadenza that wrote it"
        )
    learnt = _learnt(checked(plain, _Facts, folder / "facts.json"), arrays, folder)
    try:
        learnt.policy.best(np.zeros((1, len(learnt.inputs.kept)), np.float32))  # layers that fit
    except (KeyError, ValueError) as error:
        raise CadenzaError(
            f"{folder}: not a policy that this version can read ({error!r}); use another copy"
        ) from error
    return learnt


def _named(prefix: str, part: Plan | Ranges | None) -> dict[str, NDArray[Any]]:
    return {} if part is None else {prefix + name: a for name, a in part._asdict().items()}


def _with(prefix: str, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)}


def _learnt(facts: _Facts, arrays: dict[str, NDArray[Any]], folder: Path) -> LearntPolicy:
    plan, ranges = _with(_PLAN, arrays), _with(_RANGES, arrays)
    for names, kind, wanted in ((plan, Plan, facts.residual), (ranges, Ranges, bool(ranges))):
        if names.keys() != set(kind._fields if wanted else ()):
            raise CadenzaError(
                f"{folder}: not a policy that this version can read (arrays of its plan or its "
                "ranges are missing, or too many); use another copy"
            )
    weights = {n: a for n, a in arrays.items() if not n.startswith((_PLAN, _RANGES))}
    return LearntPolicy(
        policy=Policy(weights, facts.activation, facts.log_std_range),
        inputs=facts.inputs,
        plan=Plan(**plan) if facts.residual else None,
        ranges=Ranges(**ranges) if ranges else None,
        task=facts.task,
        scene=facts.scene,
        score=facts.score,
    )
