"""Titles of films, in letters that come with Cadenza, whatever fonts a machine has."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom

_INK = (28, 32, 40)
_SECONDS, _FADE = 4.0, 0.6  # [s] that titles stay, and in which they come and go
_LARGE, _SMALL = 0.062, 0.034  # heights of the first line and of others, of the shorter side
_MARGIN = 0.05  # of the shorter side


def draw_titles(picture: NDArray[np.uint8], lines: Sequence[str], time: float) -> None:
    """Draw what a film says when it begins into the upper left of a picture (height, width, 3).

    The first line is in large letters. What is too long for the picture is made smaller.

    Args:
        picture: it is drawn on.
        lines: the titles, one below the other.
        time: since the film began [s].
    """
    opacity = np.clip(min(time, _SECONDS - time) / _FADE, 0.0, 1.0)
    if opacity == 0.0:
        return
    side = min(picture.shape[:2])
    top = margin = round(_MARGIN * side)
    for number, line in enumerate(lines):
        height = round((_SMALL if number else _LARGE) * side)
        ink = _ink(line, height, picture.shape[1] - 2 * margin)
        part = picture[top : top + ink.shape[0], margin : margin + ink.shape[1]]
        part[:] = part + opacity * ink[..., None] * (np.array(_INK) - part)
        top += ink.shape[0]


@lru_cache
def _ink(line: str, height: int, most: int) -> NDArray[np.float64]:
    """Where a line (height, up to `most`) has ink, from 0 to 1. It leaves out unknown letters."""
    columns = _columns()
    letters = [letter for letter in unicodedata.normalize("NFC", line) if letter in columns]
    ink = np.concatenate([columns[letter] for letter in letters or " "], axis=1)
    scale = min(height / ink.shape[0], most / ink.shape[1])
    return np.clip(zoom(ink, scale, order=1, grid_mode=True, mode="nearest"), 0.0, 1.0)


@lru_cache
def _columns() -> dict[str, NDArray[np.float64]]:
    """Each letter as columns of ink from 0 to 1, all of one height."""
    with files(__package__).joinpath("lettering.npz").open("rb") as file, np.load(file) as drawn:
        atlas, ends = drawn["atlas"] / 15.0, np.cumsum(drawn["widths"].astype(int))
        parts = np.split(atlas, ends[:-1], axis=1)
        return dict(zip(drawn["letters"].tolist(), parts, strict=True))
