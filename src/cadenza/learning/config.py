"""What can be chosen about learning. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from cadenza.errors import CadenzaError
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

Preset = Literal["fast", "paper", "published"]
Activation = Literal["relu", "gelu"]


@dataclass(frozen=True)
class LearnerConfig:
    """The learner: DroQ (Hiraoka et al., ICLR 2022) on SAC. The defaults are the paper's."""

    hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Hidden layer widths of the actor and the critics."""
    activation: Activation = "relu"
    """Activation function of the hidden layers."""
    num_critics: int = 2
    """Critics in the ensemble. The minimum of their Q-values is used."""
    dropout: float = 0.01
    """Dropout rate in the critics."""
    layer_norm: bool = True
    """Use layer normalisation in the critics, after dropout."""
    log_std_min: float = -20.0
    """Minimum log standard deviation of the policy, before tanh."""
    log_std_max: float = 2.0
    """Maximum log standard deviation of the policy, before tanh."""
    initial_temperature: float = 1.0
    """Initial entropy temperature. It is learnt."""
    target_entropy: float | None = None
    """Target entropy. By default minus half the action dimension."""
    actor_learning_rate: float = 3e-4
    """Learning rate of the actor (Adam)."""
    critic_learning_rate: float = 3e-4
    """Learning rate of the critics (Adam)."""
    temperature_learning_rate: float = 3e-4
    """Learning rate of the log temperature (Adam)."""
    final_learning_rates: float = 1.0
    """Fraction of the learning rates that is left at the end of a run. They decay linearly. If a
    resumed run gets another end, they decay from their current values."""
    adam_beta1: float = 0.9
    """Adam's decay rate of the first moment."""
    adam_beta2: float = 0.999
    """Adam's decay rate of the second moment."""
    discount: float = 0.99
    """Discount factor per control step."""
    tau: float = 0.005
    """Soft update rate of the target critics."""
    actor_update_period: int = 1
    """Critic updates per update of the actor and the temperature."""
    actor_average: float = 1.0
    """Update rate of the exponential moving average of the actor, which is evaluated and saved.
    With 1 it is the latest actor."""
    batch_size: int = 256
    """Transitions per update."""


@dataclass(frozen=True)
class TrainingConfig:
    """How a policy for one song is trained."""

    learner: LearnerConfig = field(default_factory=LearnerConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)
    num_steps: int = 5_000_000
    """Environment steps of the run, summed over all environments."""
    num_envs: int = 1
    """Parallel environments."""
    seed_steps: int = 5_000
    """Environment steps with uniformly random actions before the first update."""
    steps_per_round: int = 1
    """Rollout length: control steps per environment between policy updates."""
    updates_per_round: int = 1
    """Gradient updates per rollout."""
    parallel: bool = False
    """Update while the next rollout is collected, with a policy one rollout old."""
    replay_capacity: int = 1_000_000
    """Size of the replay buffer, in transitions."""
    keep_zero_inputs: bool = False
    """Keep observations that are always zero for this song. Slower, with the same result."""
    song_range: bool = False
    """Restrict the forearms to the keys of the song, and normalise joint positions and actions by
    their ranges."""
    residual: bool = False
    """Learn residual actions on top of a plan from inverse kinematics."""
    eval_interval: int = 10_000
    """Environment steps between evaluations, which run in the background."""
    checkpoint_interval: float = 120.0
    """Time between checkpoints [s]."""
    log_interval: int = 1_000
    """Environment steps between logged metrics."""
    seed: int = 0
    """Random seed."""

    def updates_by(self, step: int) -> int:
        """Updates that a run makes until it has done so many steps."""
        rounds = (step - self.seed_steps) / (self.steps_per_round * self.num_envs)
        return max(math.ceil(rounds * self.updates_per_round), 0)


def preset(name: Preset, residual: bool = False) -> TrainingConfig:
    """What a run begins with.

    paper: the table of the paper. published: the same with what the published run script sets
    differently, and the two reward terms of the published code. fast: for few cores. With
    `residual` a run learns corrections to a plan, which are small.
    """
    match name:
        case "paper":
            config = TrainingConfig()
        case "published":
            config = TrainingConfig(
                learner=LearnerConfig(discount=0.8, activation="gelu"),
                task=TaskConfig(sustain_term=True, forearm_term=True),
            )
        case "fast":
            config = _fast_residual() if residual else _fast()
    return replace(config, residual=residual)


def _fast() -> TrainingConfig:
    """Little entropy to begin with: a temperature of 1 takes ten thousands of updates to cool.

    A tune is learnt long before the end; pieces for two hands still improve then.
    """
    return TrainingConfig(
        learner=LearnerConfig(
            actor_learning_rate=1e-3,
            critic_learning_rate=1e-3,
            temperature_learning_rate=1e-3,
            initial_temperature=0.05,
            discount=0.84,
            actor_average=0.01,
            batch_size=128,
        ),
        task=TaskConfig(initial_buffer_time=0.5),
        num_steps=1_000_000,
        num_envs=2,
        steps_per_round=64,
        updates_per_round=20,
        parallel=True,
        song_range=True,
    )


def _fast_residual() -> TrainingConfig:
    """What is nearly right is soon spoilt: smaller changes, and more to found each of them on."""
    fast = _fast()
    learner = replace(
        fast.learner,
        actor_learning_rate=3e-4,
        critic_learning_rate=3e-4,
        initial_temperature=0.01,
        final_learning_rates=0.1,
        batch_size=256,
    )
    return replace(
        fast,
        learner=learner,
        num_steps=500_000,
        num_envs=16,
        seed_steps=2_000,
        steps_per_round=8,
        updates_per_round=10,
        song_range=False,
    )


_AT_LEAST: dict[str, float] = {
    "num_steps": 1,
    "num_envs": 1,
    "seed_steps": 0,
    "steps_per_round": 1,
    "updates_per_round": 1,
    "replay_capacity": 1,
    "eval_interval": 1,
    "checkpoint_interval": 0,
    "log_interval": 1,
    "seed": 0,
    "num_critics": 1,
    "actor_update_period": 1,
    "batch_size": 1,
}
_AT_MOST = {"num_envs": 10_000}
_SHARES = ("discount", "tau", "actor_average", "final_learning_rates")
_BELOW_ONE = ("dropout", "adam_beta1", "adam_beta2")
_ABOVE_ZERO = (
    "initial_temperature",
    "actor_learning_rate",
    "critic_learning_rate",
    "temperature_learning_rate",
)


def check(config: TrainingConfig) -> None:
    """Raises: CadenzaError: an option makes no sense."""
    values = vars(config) | vars(config.learner)
    for name, least in _AT_LEAST.items():
        if not values[name] >= least:
            raise CadenzaError(f"{name} {values[name]}: choose {least:g} or more")
        if isinstance(values[name], int) and values[name] > (most := _AT_MOST.get(name, 2**53)):
            raise CadenzaError(f"{name} {values[name]}: choose {most:g} or less")
    for name in _SHARES:
        if not 0 <= values[name] <= 1:
            raise CadenzaError(f"{name} {values[name]}: choose 0 to 1")
    for name in _ABOVE_ZERO:
        if not 0 < values[name] < math.inf:
            raise CadenzaError(f"{name} {values[name]}: choose more than 0")
    if not values["hidden_sizes"] or min(values["hidden_sizes"]) < 1:
        raise CadenzaError(f"hidden_sizes {values['hidden_sizes']}: give one width per layer")
    for name in _BELOW_ONE:
        if not 0 <= values[name] < 1:
            raise CadenzaError(f"{name} {values[name]}: choose 0 or more and less than 1")
