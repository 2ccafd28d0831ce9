"""Setups by name, such as `--setup allegro`: hands, keyboard, task, agent and training.

Options that are given beside a setup take precedence.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from typing import Any, TypeVar

from cadenza.configs import as_config
from cadenza.errors import CadenzaError, quoted
from cadenza.registry import Entry, Registry
from cadenza.scene.config import SceneConfig
from cadenza.tasks import robots
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.published import hint

T = TypeVar("T", bound=Any)

SETUPS = Registry(
    "setup",
    "cadenza.setups",
    {
        "published": Entry(
            "cadenza.tasks.setups:PUBLISHED", "the task of RoboPianist to the letter, as it is run"
        ),
        "paper": Entry(
            "cadenza.tasks.setups:PAPER", "the same without rewards for the pedal and forearms"
        ),
        "shadow": Entry("cadenza.tasks.setups:SHADOW", "two Shadow Hands at a piano"),
        "allegro": Entry("cadenza.tasks.setups:ALLEGRO", "two Allegro Hands at a piano"),
        "mini-allegro": Entry(
            "cadenza.tasks.setups:MINI_ALLEGRO", "an Allegro Hand with touch at 25 mini keys"
        ),
        "arm-allegro": Entry(
            "cadenza.tasks.setups:ARM_ALLEGRO",
            "two arms with Allegro Hands, each at a piano of its own; what they play is combined",
        ),
        "gentle": Entry("cadenza.tasks.setups:GENTLE_ROBOT", "hands and a piano that differ a bit"),
        "realistic": Entry(
            "cadenza.tasks.setups:REALISTIC_ROBOT", "hands and a piano that differ as real ones do"
        ),
        "harsh": Entry("cadenza.tasks.setups:HARSH_ROBOT", "cheap or worn hands, far off"),
    },
    otherwise="module:NAME",
)


def _options_of(kind: type, options: Mapping[str, Any]) -> dict[str, Any]:
    """The options that are fields of `kind`."""
    return {field.name: options[field.name] for field in fields(kind) if field.name in options}


@dataclass(frozen=True, eq=False)
class NamedSetup:
    """A setup: options of scene, task, agent and training."""

    options: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `SceneConfig` and `TaskConfig`; the others keep their defaults."""
    agent: str | None = None
    """The name of the agent; None for the default one."""
    training: Mapping[str, Any] = field(default_factory=dict)
    """Changes to the preset "fast": fields of `TrainingConfig` and of its learner."""

    def __post_init__(self) -> None:
        """Check the names of options; raises CadenzaError if no configuration has one."""
        names = {*self.of(SceneConfig), *self.of(TaskConfig)}
        if unknown := sorted(self.options.keys() - names):
            raise CadenzaError(
                f"setup: there is no option {quoted(unknown[0])} of a scene or a task"
            )

    def of(self, kind: type) -> dict[str, Any]:
        """The options that are fields of `kind`."""
        return _options_of(kind, self.options)

    def applied_to(self, config: T) -> T:
        """`config`, a dataclass with a `task` and a `scene`, with this setup's options."""
        task = replace(config.task, **self.of(TaskConfig))
        scene = replace(config.scene, **self.of(SceneConfig))
        return replace(config, task=task, scene=scene)


_AS_PUBLISHED = {
    "initial_buffer_time": 0.0,
    "repeats": "published",
    "onset_goals": False,
    "onset_timing_coefficient": 0.0,
    "loudness_coefficient": 0.0,
    "sleeping_keys": False,
    "key_press": "published",
    "fingering_margin": TaskConfig.fingering_margin,
    "energy_coefficient": TaskConfig.energy_coefficient,
}
PAPER = NamedSetup(_AS_PUBLISHED)
PUBLISHED = NamedSetup(_AS_PUBLISHED | {"sustain_term": True, "forearm_term": True})
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
        "actor_ema": 0.001,
    },
)
GENTLE_ROBOT = NamedSetup({"randomization": robots.GENTLE})
REALISTIC_ROBOT = NamedSetup({"randomization": robots.REALISTIC})
HARSH_ROBOT = NamedSetup({"randomization": robots.HARSH})
ARM_ALLEGRO = NamedSetup(
    {"hand": "arm-allegro", "hands": "apart", "initial_buffer_time": 1.0}, "icp"
)


def setup_named(name: str) -> NamedSetup:
    """The setup of a name or of `module:NAME`. Raises CadenzaError if there is no such setup."""
    return SETUPS.load(name, NamedSetup)


def configure(
    options: dict[str, Any], task: TaskConfig | None = None, scene: SceneConfig | None = None
) -> tuple[TaskConfig, SceneConfig]:
    """Sort keyword options into the configurations that have them as fields.

    Raises CadenzaError if no configuration has such an option, or there is no such setup.

    Args:
        options: fields of `task` and `scene` to change; "setup" names a setup, whose options give
            way to the others.
        task: the task's configuration, by default `TaskConfig()`.
        scene: the scene's configuration, by default `SceneConfig()`.
    """
    if (setup := options.get("setup")) is not None:
        options = {**setup_named(setup).options, **options}
    options = {name: value for name, value in options.items() if name != "setup"}
    names = {field.name for kind in (TaskConfig, SceneConfig) for field in fields(kind)}
    if unknown := sorted(options.keys() - names):
        if published := hint(unknown[0], options[unknown[0]]):
            raise CadenzaError(f"unknown option {unknown[0]}: {published}")
        close = get_close_matches(unknown[0], [*names, "setup", "song"], 1)
        guess = f"did you mean {close[0]}? " if close else ""
        raise CadenzaError(
            f"unknown option {', '.join(unknown)}: {guess}choose from "
            f"{', '.join(sorted({*names, 'setup'}))}"
        )

    if (profile := options.get("randomization")) in tuple(robots.PROFILES):
        raise CadenzaError(f"randomization {quoted(profile)}: a profile is a setup={profile!r}")
    task = replace(as_config(task, TaskConfig), **_options_of(TaskConfig, options))
    return task, replace(as_config(scene, SceneConfig), **_options_of(SceneConfig, options))
