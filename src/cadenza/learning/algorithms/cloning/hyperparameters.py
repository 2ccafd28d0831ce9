"""The hyperparameters of behaviour cloning. Imports nothing heavy."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cadenza.configs import check_ranges
from cadenza.errors import CadenzaError
from cadenza.learning.learner import LearnerConfig
from cadenza.learning.policy import Activation


@dataclass(frozen=True)
class Hyperparameters(LearnerConfig):
    """The hyperparameters of behaviour cloning."""

    hidden_sizes: tuple[int, ...] = (256, 256, 256)
    """Hidden layer widths."""
    activation: Activation = "relu"
    """Activation function of the hidden layers."""
    learning_rate: float = 1e-3
    """Learning rate (Adam)."""
    final_learning_rate_fraction: float = 0.01
    """Fraction of the learning rate that is left at the end. It decays linearly."""

    def check(self) -> None:
        """Raises: CadenzaError: an option makes no sense."""
        super().check()
        check_ranges(self, {"final_learning_rate_fraction": (0, 1)})
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise CadenzaError(f"hidden_sizes {self.hidden_sizes}: give one width per layer")
        if not 0 < self.learning_rate < math.inf:
            raise CadenzaError(f"learning_rate {self.learning_rate}: choose more than 0")
