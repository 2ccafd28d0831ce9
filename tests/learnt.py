"""Policies with random weights."""

from itertools import pairwise
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


def random_policy(
    inputs: int, actions: int, *hidden: int, activation: str = "relu", size: float = 0.1
) -> Perceptron:
    """A perceptron of these sizes."""
    rng, ends = np.random.default_rng(0), (inputs, *hidden)
    layers = {f"hidden_{i}": sizes for i, sizes in enumerate(pairwise(ends))}
    layers |= dict.fromkeys(("mean", "log_std"), (ends[-1], actions))
    weights = {
        f"{name}/{part}": rng.normal(0, size, shape).astype(np.float32)
        for name, sizes in layers.items()
        for part, shape in (("kernel", sizes), ("bias", sizes[1:]))
    }
    return Perceptron(weights, activation, (-20.0, 2.0))


def from_nothing(
    score: Score, task: dict[str, Any] | None = None, scene: dict[str, Any] | None = None
) -> LearntPolicy:
    """A policy with random weights, which plays any song at once, and badly."""
    config, hands = TaskConfig(**task or {}), SceneConfig(**scene or {})
    shown = PianoTask([score], config, hands)
    spec = ObservationSpec.of(shown.spec)
    policy = random_policy(spec.size, shown.spec.action_size, 8)
    return LearntPolicy(policy, spec, spec.inputs, None, ranges_of(shown), config, hands, score)
