"""The configuration of behaviour cloning. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cadenza.errors import extra_packages
from cadenza.learning.algorithms.cloning.hyperparameters import Hyperparameters
from cadenza.learning.learner import Ends

if TYPE_CHECKING:
    from cadenza.learning.algorithms.cloning.learner import Cloning
    from cadenza.learning.observation import Inputs


@dataclass(frozen=True)
class CloningConfig(Hyperparameters):
    """The network is as wide and as deep as the paper's actor (Zakka et al., CoRL 2023)."""

    def make(self, inputs: Inputs, action_size: int, ends: Ends = ((0, 1),)) -> Cloning:
        """See `LearnerConfig.make`."""
        with extra_packages("train", "training"):
            from cadenza.learning.algorithms.cloning.learner import Cloning
        return Cloning(self, inputs, action_size, ends)
