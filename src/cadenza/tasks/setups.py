"""Setups by name: which hands sit at which keyboard, and who plays there.

A setup is a set of options under one name, such as `--setup allegro`. What is given beside it wins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.registry import Entry, Registry
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

SETUPS = Registry(
    "setup",
    "cadenza.setups",
    {
        "shadow": Entry("cadenza.tasks.setups:SHADOW", "two Shadow Hands at a piano"),
        "allegro": Entry("cadenza.tasks.setups:ALLEGRO", "two Allegro Hands at a piano"),
        "mini-allegro": Entry(
            "cadenza.tasks.setups:MINI_ALLEGRO", "an Allegro Hand with touch at 25 mini keys"
        ),
        "arm-allegro": Entry(
            "cadenza.tasks.setups:ARM_ALLEGRO",
            "two arms with Allegro Hands, each at a piano of its own; what they play is combined",
        ),
    },
    otherwise="module:NAME",
)


@dataclass(frozen=True, eq=False)
class NamedSetup:
    """What the name of a setup stands for."""

    options: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `SceneConfig` and `TaskConfig`; the others keep their defaults."""
    agent: str | None = None
    """Who plays unless another agent is chosen; None for the usual one."""
    training: Mapping[str, Any] = field(default_factory=dict)
    """What the preset fast has otherwise here: fields of `TrainingConfig` and of its learner."""

    def __post_init__(self) -> None:
        """Raises: CadenzaError: no configuration has such an option."""
        known = {*self.of(SceneConfig), *self.of(TaskConfig)}
        if unknown := sorted(self.options.keys() - known):
            raise CadenzaError(f"setup: there is no option {unknown[0]!r} of a scene or a task")

    def of(self, kind: type) -> dict[str, Any]:
        """The options that are fields of `kind`."""
        return {f.name: self.options[f.name] for f in fields(kind) if f.name in self.options}


SHADOW = NamedSetup({"hand": "shadow"})
ALLEGRO = NamedSetup({"hand": "allegro"})
MINI_ALLEGRO = NamedSetup(
    {
        "keyboard": "mini",
        "hand": "allegro-narrow",
        "hands": "right",
        "hand_spacing": 0.0,
        "touch": True,
        "fingering_margin": 0.04,
        "key_press": "graded",
        "energy_coefficient": 0.001,
    },
    training={
        "num_steps": 160_000,
        "learning_starts": 2_000,
        "gradient_steps": 30,
        "hidden_sizes": (128, 128),
        "initial_temperature": 0.003,
        "final_learning_rate_fraction": 0.1,
        "actor_ema": 0.001,
    },
)
ARM_ALLEGRO = NamedSetup(
    {"hand": "arm-allegro", "hands": "apart", "initial_buffer_time": 1.0}, "icp"
)


def setup_named(name: str) -> NamedSetup:
    """Raises: CadenzaError: there is no such setup."""
    return SETUPS.load(name, NamedSetup)
