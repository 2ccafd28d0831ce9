"""The update rules of sampling-based control."""

from __future__ import annotations

import numpy as np
import pytest

from cadenza.agents.planner.search.sampling import UPDATES, SamplingDistribution


@pytest.mark.parametrize("method", UPDATES)
def test_every_update_finds_the_minimum_of_a_bowl(method: str) -> None:
    rng = np.random.default_rng(0)
    minimum = np.array([[0.3, -0.2]])
    distribution = SamplingDistribution(np.zeros((1, 2)), np.full((1, 2), 0.3))
    for _ in range(8):
        mean, sigma = distribution
        candidates = mean + sigma * rng.standard_normal((16, 1, 2))
        candidates[0] = mean
        cost = ((candidates - minimum) ** 2).sum(axis=(1, 2))
        distribution = UPDATES[method](candidates, cost, distribution)  # type: ignore[index]
    np.testing.assert_allclose(distribution.mean, minimum, atol=0.1)


@pytest.mark.parametrize("method", UPDATES)
def test_nothing_changes_where_all_diverged(method: str) -> None:
    distribution = SamplingDistribution(np.zeros((1, 2)), np.ones((1, 2)))
    candidates, cost = np.ones((8, 1, 2)), np.full(8, np.inf)
    updated = UPDATES[method](candidates, cost, distribution)  # type: ignore[index]
    assert updated is distribution


def test_mppi_takes_no_notice_of_what_diverged() -> None:
    candidates = np.array([[[0.0]], [[1.0]], [[9.0]]])
    before = SamplingDistribution(candidates[0], candidates[0])
    updated = UPDATES["mppi"](candidates, np.array([1.0, 1.0, np.inf]), before)
    assert updated.mean == pytest.approx(0.5)
