"""Onsets between physics steps, as an array library compiles them and as NumPy finds them."""

import numpy as np
from numpy.testing import assert_array_equal

from cadenza.sim.key_crossings import dense_key_events, last_key_events


def test_dense_events_are_the_last_ones():
    """Keys that rest, that cross once, and that cross many times in a step."""
    rng = np.random.default_rng(0)
    paths = rng.uniform(0.0, 1.0, (50, 11, 3)) * [0.0, 1.0, 0.52]
    sounds_from = np.array([0.5, 0.5, 0.5])
    sparse = last_key_events(paths, sounds_from, 0.005)
    for ours, theirs in zip(dense_key_events(paths, sounds_from, 0.005), sparse, strict=True):
        assert_array_equal(ours, theirs)
        assert 0 < np.isnan(theirs[:, 2]).sum() < 50
