"""The hyperparameters of DroQ. This module imports nothing heavy: the command line shows them."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from cadenza.configs import MAX_COUNT, check_positive, check_ranges
from cadenza.errors import CadenzaError
from cadenza.learning.learner import LearnerConfig, Preset, check_hidden_sizes
from cadenza.learning.policy import Activation


@dataclass(frozen=True)
class DroQConfig(LearnerConfig):
    """Hyperparameters of DroQ (Hiraoka et al., ICLR 2022) on SAC (Haarnoja et al., 2018).

    The defaults are those of RoboPianist (Zakka et al., CoRL 2023).
    """

    learner: ClassVar[str] = "cadenza.learning.algorithms.droq.learner:DroQ"
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
    initial_mean: float = 1.0
    """Scale of the actor's last weights at the beginning. With 0, the mean action is 0, so that a
    residual policy corrects nothing."""
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
    final_learning_rate_fraction: float = 1.0
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
    policy_delay: int = 1
    """Critic updates per update of the actor and the temperature."""
    actor_ema: float = 1.0
    """Update rate of the exponential moving average of the actor, which is evaluated and saved.
    With 1 it is the latest actor."""

    @classmethod
    def preset(cls, name: Preset, residual: bool) -> Self:
        """The hyperparameters of a preset.

        The preset fast has a low initial temperature, as one of 1 takes tens of thousands of
        updates to fall. A `residual` policy is nearly right from the start: it gets smaller steps
        and larger batches.
        """
        if name == "paper":
            return cls()
        if name == "published":
            return cls(discount=0.8, activation="gelu")
        fast = cls(
            actor_learning_rate=1e-3,
            critic_learning_rate=1e-3,
            temperature_learning_rate=1e-3,
            initial_temperature=0.05,
            final_learning_rate_fraction=0.1,
            discount=0.84,
            actor_ema=0.01,
            batch_size=128,
        )
        if not residual:
            return fast
        return replace(
            fast,
            actor_learning_rate=3e-4,
            critic_learning_rate=3e-4,
            initial_mean=0.0,
            initial_temperature=0.01,
            batch_size=256,
        )

    def check(self) -> None:
        """Check the hyperparameters; raises a CadenzaError if one makes no sense."""
        super().check()
        rates = ("discount", "tau", "actor_ema", "initial_mean", "final_learning_rate_fraction")
        check_ranges(
            self,
            {
                **dict.fromkeys(("num_critics", "policy_delay"), (1, MAX_COUNT)),
                **dict.fromkeys(rates, (0, 1)),
            },
        )
        check_hidden_sizes(self.hidden_sizes)
        for name in ("dropout", "adam_beta1", "adam_beta2"):
            if not 0 <= (value := getattr(self, name)) < 1:
                raise CadenzaError(f"{name} {value}: choose 0 or more and less than 1")
        learning_rates = (f"{what}_learning_rate" for what in ("actor", "critic", "temperature"))
        check_positive(self, ("initial_temperature", *learning_rates))
