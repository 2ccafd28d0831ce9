"""Titles of films."""

from __future__ import annotations

import numpy as np

from cadenza.performing.titles import draw_titles


def drawn(*lines: str, time: float = 2.0, size: tuple[int, int] = (360, 640)) -> np.ndarray:
    """Which pixels a title changes."""
    picture = np.full((*size, 3), 200, np.uint8)
    draw_titles(picture, lines, time)
    return (picture != 200).any(axis=2)


def test_lines_stand_one_below_the_other_in_the_upper_left() -> None:
    one, two = drawn("Für Elise"), drawn("Für Elise", "Ludwig van Beethoven")
    assert one.any()
    assert not one[120:].any()
    assert not one[:, 320:].any()
    below = two & ~one
    assert below.any()
    assert np.flatnonzero(below.any(axis=1)).min() > 30
    assert (two & one == one).all()


def test_they_come_and_go() -> None:
    assert not drawn("Joy", time=0.0).any()
    assert not drawn("Joy", time=5.0).any()


def test_accents_are_drawn_however_they_are_written() -> None:
    assert (drawn("F\u00fcr") == drawn("Fu\u0308r")).all()
    assert (drawn("Fur") != drawn("F\u00fcr")).any()


def test_letters_without_a_shape_are_left_out() -> None:
    assert (drawn("\u7acb Joy") == drawn(" Joy")).all()
    assert not drawn("\u7acb").any()
    assert not drawn().any()


def test_long_titles_fit() -> None:
    long = drawn("A title that does not end before it has passed every side of the picture " * 3)
    assert long.any()
    assert not long[:, -16:].any()
