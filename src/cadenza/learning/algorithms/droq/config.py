"""The configuration of DroQ, by which the learner is named. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cadenza.errors import extra_packages
from cadenza.learning.algorithms.droq.hyperparameters import Hyperparameters
from cadenza.learning.learner import Ends

if TYPE_CHECKING:
    from cadenza.learning.algorithms.droq.learner import DroQ
    from cadenza.learning.observation import Inputs


@dataclass(frozen=True)
class DroQConfig(Hyperparameters):
    """The defaults are those of the paper (Zakka et al., CoRL 2023)."""

    def make(self, inputs: Inputs, action_size: int, ends: Ends = ((0, 1),)) -> DroQ:
        """See `LearnerConfig.make`."""
        with extra_packages("train", "training"):
            from cadenza.learning.algorithms.droq.learner import DroQ
        return DroQ(self, inputs, action_size, ends)
