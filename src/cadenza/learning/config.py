"""The options of training. Imports nothing heavy: the command line shows it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from cadenza.agents.planner.config import MAX_EFFORT
from cadenza.configs import MAX_COUNT, check_ranges, in_short
from cadenza.errors import CadenzaError
from cadenza.learning.algorithms.cloning.config import CloningConfig
from cadenza.learning.learner import DROQ, LearnerConfig, Preset, learner_config
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.setups import setup_named


@dataclass(frozen=True)
class TrainingConfig:
    """The options of training a policy for a song, or for several."""

    learner: LearnerConfig = field(default_factory=lambda: learner_config(DROQ)())
    task: TaskConfig = field(default_factory=TaskConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    num_steps: int = 5_000_000
    """Environment steps of the run, summed over all environments."""
    num_envs: int = 1
    """Parallel environments."""
    learning_starts: int = 5_000
    """Environment steps with uniformly random actions before the first update."""
    train_freq: int = 1
    """Rollout length: control steps per environment between policy updates."""
    gradient_steps: int = 1
    """Gradient updates per rollout."""
    parallel: bool = False
    """Update while the next rollout is collected, with a policy one rollout old."""
    buffer_size: int = 1_000_000
    """Size of the replay buffer, in transitions."""
    prune_inputs: bool = True
    """Leave out observations that are always zero for this song. Faster, with the same result.
    Without it, the policy observes the same shape for every song."""
    song_range: bool = False
    """Restrict the forearms to the keys of the song, the other servos to postures near their rest,
    and normalise joint positions and actions by these ranges."""
    residual: bool = False
    """Learn residual actions on top of the planner's."""
    plan_effort: float = 0.0
    """Practise the plan that a residual policy corrects, as "cadenza practice" does."""
    eval_interval: int = 10_000
    """Environment steps between evaluations, which run in the background."""
    checkpoint_interval: float = 120.0
    """Time between checkpoints [s]."""
    log_interval: int = 1_000
    """Environment steps between logged metrics."""
    seed: int = 0
    """Random seed."""

    __repr__ = in_short

    def updates_by(self, step: int) -> int:
        """Updates that a run makes until it has done `step` steps."""
        rounds = (step - self.learning_starts) / (self.train_freq * self.num_envs)
        return max(math.ceil(rounds * self.gradient_steps), 0)


def preset(
    name: Preset,
    residual: bool | None = None,
    learner: str = DROQ,
    otherwise: Mapping[str, Any] | None = None,
) -> TrainingConfig:
    """The options of a preset.

    paper: the table of the paper, in its task. published: the same with what the published run
    script sets differently, and the reward terms for pedal and forearms. Both tasks are those of
    the setups of the same names. fast: for few cores, in the default task, changed by `otherwise`
    (`NamedSetup.training`). With `residual` a run learns small corrections of a plan; by default it
    does so where that was measured to be better: with the preset fast of DroQ, without such
    changes. Raises CadenzaError if there is no `learner` of this name.
    """
    if residual is None:
        residual = name == "fast" and learner == DROQ and not otherwise
    match name:
        case "paper" | "published":
            config = setup_named(name).applied_to(TrainingConfig())
        case "fast":
            config = _fast_residual() if residual else _fast()
    config = replace(
        config, learner=learner_config(learner).preset(name, residual), residual=residual
    )
    if name == "fast" and not residual:
        config = _with(otherwise or {}, config)
    return replace(config, **config.learner.training)


def _with(options: Mapping[str, Any], config: TrainingConfig) -> TrainingConfig:
    """Apply the options that `config` or its learner has."""
    own, learners = (
        {f.name: options[f.name] for f in fields(each) if f.name in options}
        for each in (config, config.learner)
    )
    return replace(config, learner=replace(config.learner, **learners), **own)


def _fast() -> TrainingConfig:
    """The preset fast, which learns tunes for one hand.

    From nothing, every touch of a right key is rewarded, as hovering would earn nearly as much.
    """
    return TrainingConfig(
        task=TaskConfig(key_press="graded", fingering_margin=0.04, energy_coefficient=0.001),
        num_steps=100_000,
        num_envs=2,
        train_freq=64,
        gradient_steps=20,
        parallel=True,
        song_range=True,
        eval_interval=5_000,
    )


def _fast_residual() -> TrainingConfig:
    return replace(
        _fast(),
        task=TaskConfig(),
        num_steps=500_000,
        num_envs=16,
        plan_effort=1.0,
        learning_starts=2_000,
        train_freq=8,
        gradient_steps=10,
        song_range=False,
        eval_interval=TrainingConfig.eval_interval,
    )


_RANGES: dict[str, tuple[float, float]] = {
    "plan_effort": (0, MAX_EFFORT),
    "num_steps": (1, MAX_COUNT),
    "num_envs": (1, 10_000),
    "learning_starts": (0, MAX_COUNT),
    "train_freq": (1, MAX_COUNT),
    "gradient_steps": (1, MAX_COUNT),
    "buffer_size": (1, MAX_COUNT),
    "eval_interval": (1, MAX_COUNT),
    "checkpoint_interval": (0, math.inf),
    "log_interval": (1, MAX_COUNT),
    "seed": (0, MAX_COUNT),
}

_OFF_POLICY = {"learning_starts": 0, "parallel": False, "buffer_size": TrainingConfig.buffer_size}
"""Options that on-policy learners do not use, with the values that they must then have."""


def check(config: TrainingConfig) -> None:
    """Check the options; raises a CadenzaError if one makes no sense."""
    check_ranges(config, _RANGES)
    config.learner.check()
    if config.learner.on_policy:
        for name, unused in _OFF_POLICY.items():
            if (value := getattr(config, name)) != unused:
                raise CadenzaError(
                    f"{name} {value}: this learner learns from rollouts of its own policy only; "
                    "leave that out"
                )
    elif config.scene.engine == "warp":
        raise CadenzaError("engine warp: this learner learns on CPU cores; choose --learner ppo")
    if config.scene.engine == "warp" and config.residual:
        raise CadenzaError("engine warp: plans are corrected on CPU cores; leave out --residual")


@dataclass(frozen=True)
class ImitationConfig:
    """The options of training a policy for many songs on demonstrations."""

    learner: CloningConfig = field(default_factory=CloningConfig)
    songs: tuple[str, ...] = ()
    """Learn from the demonstrations of these songs only; of all by default."""
    num_updates: int = 5_000
    """Updates of the run."""
    held_out: int = 1
    """Demonstrations of each song that are not learnt from, for the error on them."""
    n_steps_lookahead: int = TaskConfig.n_steps_lookahead
    """Lookahead of the goal observation, in control steps."""
    previous_action: bool = False
    """Also observe the previous action and its reward, as in reinforcement learning."""
    checkpoint_interval: float = 60.0
    """Time between checkpoints [s]."""
    log_interval: int = 500
    """Updates between logged metrics."""
    seed: int = 0
    """Random seed."""

    def check(self) -> None:
        """Check the options; raises a CadenzaError if one makes no sense."""
        check_ranges(
            self,
            {
                "num_updates": (1, MAX_COUNT),
                "held_out": (0, MAX_COUNT),
                "n_steps_lookahead": (0, 10_000),
                "checkpoint_interval": (0, math.inf),
                "log_interval": (1, MAX_COUNT),
                "seed": (0, MAX_COUNT),
            },
        )
        self.learner.check()
