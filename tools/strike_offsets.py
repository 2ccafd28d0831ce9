"""Lateral accuracy of strikes: how far from the middle of its key a fingertip strikes it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cadenza.episode import Episode
from cadenza.music.score import Note

Array = NDArray[np.float64]


def strike_offsets(episode: Episode, notes: Iterable[Note]) -> Array:
    """Distances (N,) of fingertips across their keys [m] where notes that were played begin.

    A key is struck by the fingertip for which this distance plus its height is least. Between the
    ends of steps, places are those of a cubic spline. The distance is that from the middle of the
    key's free width: of a white key, its own up to the black keys, and what these leave of it where
    the middle of the fingertip is between them.

    Raises:
        CadenzaError: the episode does not hold the places of fingertips.
    """
    tips = episode["fingertip_xpos"]
    in_front, between, black_front = _middles(episode.scene["keys"])
    places = CubicSpline(episode.dt * np.arange(1, episode.num_steps + 1), tips)
    offsets = list[float]()
    for note in notes:
        key, (x, y, z) = note.pitch - episode.lowest_pitch, places(note.start).T
        offset = abs(y - np.where(x > black_front, in_front[key], between[key]))
        offsets.append(offset[np.argmin(offset + z)])
    return np.array(offsets)


def _middles(keys: Sequence[Mapping[str, Any]]) -> tuple[Array, Array, float]:
    """The middles (K,) of keys in front of the black ones and between them, and where these end."""
    centre, half = (np.array([key[name][:2] for key in keys]) for name in ("pos", "size"))
    black = np.array([key["black"] for key in keys])
    left, right = centre[:, 1] - half[:, 1], centre[:, 1] + half[:, 1]
    low, high = left.copy(), right.copy()
    low[1:] = np.where(black[:-1] & ~black[1:], right[:-1], left[1:])
    high[:-1] = np.where(black[1:] & ~black[:-1], left[1:], right[:-1])
    return (left + right) / 2, (low + high) / 2, float((centre + half)[black, 0].max())
