"""Begins runs of training, and goes on with them, by the kind of training of their learner."""

from __future__ import annotations

from collections.abc import Sequence

from cadenza.errors import CadenzaError, extra_packages
from cadenza.learning.config import TrainingConfig
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import Training
from cadenza.music.score import Score


def begin(config: TrainingConfig, scores: Sequence[Score], folder: RunFolder) -> Training:
    """Begins a run in a folder, which holds none if it cannot be made.

    Raises:
        CadenzaError: see `Training`, or the folder holds a run already.
    """
    folder.begin(config, scores)
    try:
        return resume(config, scores, folder)
    except CadenzaError:
        folder.forget()
        raise


def resume(config: TrainingConfig, scores: Sequence[Score], folder: RunFolder) -> Training:
    """Goes on with the run in a folder, as `begin` has begun it.

    Raises:
        CadenzaError: see `Training`.
    """
    if not config.learner.on_policy:
        return Training(config, scores, folder)
    with extra_packages("train", "training"):
        from cadenza.learning.on_policy import OnPolicyTraining
    return OnPolicyTraining(config, scores, folder)
