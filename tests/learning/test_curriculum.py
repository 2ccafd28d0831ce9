"""Tests of the songs that a curriculum draws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.learning.curriculum import Curriculum

grades = st.lists(st.floats(1, 10), min_size=1, max_size=30).map(tuple)
shares = st.floats(0, 1)


@given(grades, shares, st.floats(0.01, 5), shares)
def test_probabilities_are_such(grades, progress: float, width: float, review: float) -> None:
    drawn = Curriculum(grades, width, review).probabilities(progress)
    assert drawn.sum() == pytest.approx(1)
    assert (drawn >= review / len(grades) - 1e-12).all()


@given(grades, shares, shares)
def test_songs_get_harder_with_progress(grades, one: float, other: float) -> None:
    curriculum = Curriculum(grades)
    early, late = (curriculum.probabilities(p) @ grades for p in sorted((one, other)))
    assert early <= late + 1e-9


def test_it_begins_with_the_easiest_and_ends_with_the_hardest() -> None:
    curriculum = Curriculum(tuple(np.linspace(1, 10, 40)), review=0.0)
    assert curriculum.probabilities(0.0).argmax() == 0
    assert curriculum.probabilities(1.0).argmax() == 39
    assert curriculum.probabilities(0.5)[:10].sum() < 0.02


def test_songs_are_drawn_as_often_as_they_should_be() -> None:
    curriculum = Curriculum((1.0, 2.0, 5.0, 9.0))
    rng = np.random.default_rng(0)
    counts = np.bincount([curriculum.draw(rng, 0.4) for _ in range(4000)], minlength=4)
    np.testing.assert_allclose(counts / 4000, curriculum.probabilities(0.4), atol=0.03)


def test_the_same_generator_draws_the_same() -> None:
    curriculum = Curriculum((1.0, 2.0, 5.0, 9.0))
    one, two = (
        [curriculum.draw(rng, 0.5) for _ in range(20)]
        for rng in (np.random.default_rng(7), np.random.default_rng(7))
    )
    assert one == two


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (((),), "needs songs"),
        (((1.0, float("nan")),), "each with a grade"),
        (((1.0,), 0.0), "choose a width above 0"),
        (((1.0,), 1.0, 2.0), "review from 0 to 1"),
    ],
)
def test_what_makes_no_curriculum_is_said(arguments, said: str) -> None:
    with pytest.raises(CadenzaError, match=said):
        Curriculum(*arguments)


def test_progress_is_a_share() -> None:
    with pytest.raises(CadenzaError, match=r"progress 1\.5: choose 0 to 1"):
        Curriculum((1.0,)).probabilities(1.5)
