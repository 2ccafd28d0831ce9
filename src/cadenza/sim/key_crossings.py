"""Crossings of the depth at which keys sound, between physics steps."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Crossings(NamedTuple):
    """Crossings of keys in steps, (C,) each, by step, then by time, then by key."""

    place: tuple[NDArray[np.intp], ...]
    """The indices of the steps, if there are several, and of the keys last."""
    time: Array
    """The times from the beginnings of the steps on [s]."""
    speed: Array
    """The speeds of the keys [rad/s], positive where they begin to sound, else negative."""

    def where(self, chosen: NDArray[np.bool_]) -> Crossings:
        """The crossings that are chosen (C,)."""
        place = tuple(indices[chosen] for indices in self.place)
        return Crossings(place, self.time[chosen], self.speed[chosen])

    @property
    def onsets(self) -> Crossings:
        """The crossings at which keys begin to sound."""
        return self.where(self.speed > 0)

    @property
    def offsets(self) -> Crossings:
        """The crossings at which keys cease to sound."""
        return self.where(self.speed < 0)


def key_crossings(key_paths: Array, sounds_from: Array, substep: float) -> Crossings:
    """All crossings on the paths of K keys, which move linearly between physics steps.

    Args:
        key_paths: (..., S + 1, K) angles before each step and after each of its S physics steps
            [rad].
        sounds_from: (K,) angles from which keys sound [rad].
        substep: time of a physics step [s].
    """
    sounding = key_paths >= sounds_from
    *step, at, key = np.nonzero(sounding[..., 1:, :] != sounding[..., :-1, :])
    before, after = key_paths[*step, at, key], key_paths[*step, at + 1, key]
    time = (at + (sounds_from[key] - before) / (after - before)) * substep
    return Crossings((*step, key), time, (after - before) / substep)


def last_key_events(
    key_paths: Array, sounds_from: Array, substep: float
) -> tuple[Array, Array, Array]:
    """The last events of each key in each step, as `State.key_events`, (..., K) each.

    The arguments are those of `key_crossings`. Returns the times of onsets and offsets [s], and the
    speeds of onsets [rad/s]; NaN for keys without any.
    """
    crossings = key_crossings(key_paths, sounds_from, substep)
    onset, offset, speed = np.full((3, *key_paths[..., 0, :].shape), np.nan)
    if crossings.time.size:  # one simulation has none in most steps
        onsets, offsets = crossings.onsets, crossings.offsets
        onset[onsets.place], speed[onsets.place] = onsets.time, onsets.speed  # the last one stays
        offset[offsets.place] = offsets.time
    return onset, offset, speed


def dense_key_events(key_paths: Any, sounds_from: Any, substep: float) -> tuple[Any, Any, Any]:
    """`last_key_events` for arrays of any library like NumPy, in shapes that a compiler knows.

    It takes NumPy two to four times as long.
    """
    xp = key_paths.__array_namespace__()
    before, after = key_paths[..., :-1, :], key_paths[..., 1:, :]
    sounded, sounds = before >= sounds_from, after >= sounds_from
    moved = xp.where(sounded != sounds, after - before, 1.0)  # where it counts, never 0
    steps = xp.arange(before.shape[-2])[:, None]
    time, speed = (steps + (sounds_from - before) / moved) * substep, moved / substep
    begins, ceases = sounds & ~sounded, sounded & ~sounds
    return _last(xp, time, begins), _last(xp, time, ceases), _last(xp, speed, begins)


def _last(xp: Any, values: Any, happened: Any) -> Any:
    """(..., K) the last of the values (..., S, K) that `happened`, NaN if none did."""
    last = happened.shape[-2] - 1 - xp.argmax(xp.flip(happened, -2), -2)
    at_last = xp.take_along_axis(values, last[..., None, :], -2)[..., 0, :]
    return xp.where(happened.any(-2), at_last, xp.nan)
