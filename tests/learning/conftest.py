"""Compiled learners that the runs of a module share."""

import functools

import pytest

from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.ppo.config import PPOConfig


@pytest.fixture(scope="module")
def compiled_once():
    """A learner keeps nothing of a run, and the runs of a module may share it."""
    with pytest.MonkeyPatch.context() as patch:
        for kind in DroQConfig, PPOConfig:
            patch.setattr(kind, "make", functools.cache(kind.make))
        yield
