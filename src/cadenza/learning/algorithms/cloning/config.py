"""The hyperparameters of behaviour cloning. This module imports nothing heavy."""

from dataclasses import dataclass
from typing import ClassVar

from cadenza.configs import check_positive, check_ranges
from cadenza.learning.learner import LearnerConfig, check_hidden_sizes
from cadenza.learning.policy import Activation


@dataclass(frozen=True)
class CloningConfig(LearnerConfig):
    """Hyperparameters of behaviour cloning.

    The network is as wide and as deep as the actor of RoboPianist (Zakka et al., CoRL 2023).
    """

    learner: ClassVar[str] = "cadenza.learning.algorithms.cloning.learner:Cloning"
    hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Hidden layer widths."""
    activation: Activation = "relu"
    """Activation function of the hidden layers."""
    learning_rate: float = 1e-3
    """Learning rate (Adam)."""
    final_learning_rate_fraction: float = 0.01
    """Fraction of the learning rate that is left at the end. It decays linearly."""

    def check(self) -> None:
        """Check the hyperparameters; raises a CadenzaError if one makes no sense."""
        super().check()
        check_ranges(self, {"final_learning_rate_fraction": (0, 1)})
        check_hidden_sizes(self.hidden_sizes)
        check_positive(self, ("learning_rate",))
