"""Policies as folders that can be copied to another machine and played there."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.rl.config import Activation, read_config
from cadenza.agents.rl.observation import Inputs
from cadenza.agents.rl.policy import Policy
from cadenza.agents.rl.policy_agent import PolicyAgent
from cadenza.agents.rl.sealed_folder import read_sealed, write_sealed
from cadenza.errors import CadenzaError
from cadenza.model.config import SceneConfig
from cadenza.music.score import Score
from cadenza.tasks.config import TaskConfig

_KIND = "policy"
_FORMAT = 1


@dataclass(frozen=True)
class LearntPolicy:
    """A policy and all that is needed to play with it."""

    weights: dict[str, NDArray[Any]]
    activation: Activation
    log_std_range: tuple[float, float]
    inputs: Inputs
    residual: bool
    """Whether it corrects the plan of the song."""
    task: TaskConfig
    scene: SceneConfig
    score: Score
    """What it was trained to play."""

    @property
    def policy(self) -> Policy:
        """For many environments at once."""
        return Policy(self.weights, self.activation, self.log_std_range)

    @property
    def agent(self) -> PolicyAgent:
        """For one that is played."""
        return PolicyAgent(self.policy, self.inputs, self.residual)


def save_policy(folder: Path, learnt: LearntPolicy, about: dict[str, Any]) -> None:
    """Writes `learnt` to `folder`, and with it what else there is to know `about` it.

    Raises:
        CadenzaError: there is no room; what the folder held is still there.
    """
    facts = {
        "format": _FORMAT,
        "about": about,
        "activation": learnt.activation,
        "log_std_range": learnt.log_std_range,
        "inputs": learnt.inputs._asdict(),
        "residual": learnt.residual,
        "task": asdict(learnt.task),
        "scene": asdict(learnt.scene),
        "score": asdict(learnt.score),
    }
    try:
        write_sealed(folder, _KIND, facts, learnt.weights)
    except OSError as error:
        raise CadenzaError(
            f"{folder}: could not be written ({error.strerror}); make room there"
        ) from error


def load_policy(folder: Path) -> LearntPolicy:
    """Raises:
    CadenzaError: there is no policy, or not one that this version wrote, unchanged.
    """
    facts, weights = read_sealed(folder, _KIND)
    if facts.get("format") != _FORMAT:
        raise CadenzaError(
            f"{folder}: a policy of format {facts.get('format')}, and this version reads "
            f"{_FORMAT}; install the version of Cadenza that wrote it"
        )
    try:
        learnt = _learnt(facts, weights)
        learnt.policy.best(np.zeros((1, len(learnt.inputs.kept)), np.float32))  # layers that fit
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise CadenzaError(
            f"{folder}: not a policy as this version writes it ({error!r}); take another copy"
        ) from error
    if not all(np.isfinite(array).all() for array in weights.values()):
        raise CadenzaError(f"{folder}: holds weights that are not finite")
    return learnt


def _learnt(facts: dict[str, Any], weights: dict[str, NDArray[Any]]) -> LearntPolicy:
    low, high = facts["log_std_range"]
    return LearntPolicy(
        weights=weights,
        activation=facts["activation"],
        log_std_range=(low, high),
        inputs=Inputs(tuple(facts["inputs"]["kept"]), facts["inputs"]["total"]),
        residual=facts["residual"],
        task=read_config(TaskConfig, facts["task"]),
        scene=read_config(SceneConfig, facts["scene"]),
        score=Score.from_plain(facts["score"]),
    )
