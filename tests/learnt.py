"""A policy that acts alone, as one that was learnt from nothing."""

from typing import Any

import numpy as np

from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.observation import ObservationSpec
from cadenza.learning.policy import Perceptron
from cadenza.learning.ranges import ranges_of
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask


def from_nothing(
    score: Score, task: dict[str, Any] | None = None, scene: dict[str, Any] | None = None
) -> LearntPolicy:
    """A policy with random weights, which plays any song at once, and badly."""
    config, hands = TaskConfig(**task or {}), SceneConfig(**scene or {})
    shown = PianoTask([score], config, hands)
    spec, rng = ObservationSpec.of(shown.spec), np.random.default_rng(0)
    sizes = {
        "hidden_0": (spec.size, 8),
        "mean": (8, shown.spec.action_size),
        "log_std": (8, shown.spec.action_size),
    }
    weights = {f"{n}/kernel": rng.normal(0, 0.1, s).astype(np.float32) for n, s in sizes.items()}
    weights |= {f"{n}/bias": np.zeros(s[1], np.float32) for n, s in sizes.items()}
    policy = Perceptron(weights, "relu", (-20.0, 2.0))
    return LearntPolicy(policy, spec, spec.inputs, None, ranges_of(shown), config, hands, score)
