"""The hyperparameters of PPO. This module imports nothing heavy: the command line shows them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from cadenza.configs import check_positive, check_ranges
from cadenza.learning.learner import LearnerConfig, check_hidden_sizes
from cadenza.learning.policy import Activation


@dataclass(frozen=True)
class PPOConfig(LearnerConfig):
    """Hyperparameters of PPO (Schulman et al., Proximal Policy Optimization Algorithms, 2017).

    A rollout has `train_freq` control steps of `num_envs` environments, and is learnt from in
    `gradient_steps` updates of `batch_size` transitions, in random order.
    """

    learner: ClassVar[str] = "cadenza.learning.algorithms.ppo.learner:PPO"
    on_policy: ClassVar[bool] = True
    training: ClassVar[Mapping[str, Any]] = {
        "num_steps": 3_000_000,
        "num_envs": 32,
        "learning_starts": 0,
        "train_freq": 32,
        "gradient_steps": 40,  # ten passes over a rollout
        "parallel": False,
        "eval_interval": 50_000,
        "log_interval": 10_000,
    }
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Hidden layer widths of the policy and of the value function."""
    activation: Activation = "relu"
    """Activation function of the hidden layers."""
    initial_std: float = 0.5
    """Initial standard deviation of actions, before tanh. It is learnt, the same everywhere."""
    learning_rate: float = 3e-4
    """Initial learning rate (Adam)."""
    target_kl: float = 0.01
    """Divergence of the new policy from the old one that the learning rate is adapted to."""
    discount: float = 0.9
    """Discount factor per control step."""
    gae_lambda: float = 0.9
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """How far the ratio of new to old probabilities may move from 1."""
    value_coefficient: float = 0.5
    """Weight of the value function's squared error."""
    entropy_coefficient: float = 0.0
    """Weight of the entropy of actions."""
    max_gradient_norm: float = 0.5
    """Gradients are scaled down to this norm."""

    def check(self) -> None:
        """Check the hyperparameters; raises a CadenzaError if one makes no sense."""
        super().check()
        check_ranges(self, dict.fromkeys(("discount", "gae_lambda"), (0, 1)))
        weights = ("value_coefficient", "entropy_coefficient")
        check_ranges(self, dict.fromkeys(weights, (0, 1e6)))
        check_hidden_sizes(self.hidden_sizes)
        positive = ("initial_std", "learning_rate", "target_kl", "clip", "max_gradient_norm")
        check_positive(self, positive)
