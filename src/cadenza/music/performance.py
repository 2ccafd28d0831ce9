"""The performed score: notes and pedal from the keys that sounded."""

from __future__ import annotations

from bisect import bisect
from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.episode import Episode
from cadenza.music.score import LOWEST_PITCH, Note, PedalEvent, Score

SOFTEST, LOUDEST = 30, 120  # MIDI velocities of keys let down slowly, and within `STRIKE_TIME`
SAME_NOTE = 0.2  # [s] within which a note played and one written on the same key are the same
STRIKE_TIME = 0.1  # [s] two steps of 0.05 s, the least that tell loud from soft
_USUAL = 80  # MIDI velocity of keys whose depth is not known
_DECIMALS, _TIME_DECIMALS = 4, 9  # of differences, and of times [s]


def key_runs(roll: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The runs of steps over which a key of `roll` (T, K) is on without a break.

    Returns:
        first step, step after the last, key; each (number of runs,), by key and then time.
    """
    silence = np.zeros((1, roll.shape[1]), np.int8)
    change = np.diff(roll.astype(bool), axis=0, prepend=silence, append=silence).T
    key, first = np.nonzero(change == 1)
    return first, np.nonzero(change == -1)[1], key


def performed_score(
    key_activation: NDArray[Any],
    sustain: NDArray[Any],
    dt: float,
    depth: NDArray[Any] | None = None,
    lowest_pitch: int = LOWEST_PITCH,
) -> Score:
    """The notes that sounded over T control steps of `dt` [s].

    A key that sounds from step i up to, not including, step j is a note from `i * dt` to `j * dt`,
    just as `score_to_goals` places it at the default of 0.05 s. Its velocity is 80, or where
    `depth` is known `30 + 90 * travel`: how far the key went down within 0.1 s to where it is on
    the step on which it begins to sound, from the highest that it stood in that time. A key pushed
    down within 0.1 s gives 120, one let down slowly 30, one that comes up halfway before it is
    struck again 75.

    Args:
        key_activation: (T, K), whether each key sounds after the step.
        sustain: (T,), whether the pedal is down after the step.
        depth: (T, K), how far each key is down after the step, from 0, at rest as before the first
            step, to 1, at its stop.
        lowest_pitch: MIDI number of the first key.
    """
    first, last, key = key_runs(key_activation)
    velocity = np.full(len(first), _USUAL) if depth is None else _velocity(depth, first, key, dt)
    notes = (
        Note(_time(i, dt), _time(j, dt), int(k) + lowest_pitch, int(v))
        for i, j, k, v in zip(first, last, key, velocity, strict=True)
    )
    moved = np.flatnonzero(np.diff(sustain.astype(np.int8), prepend=0))
    pedal = (PedalEvent(_time(i, dt), 127 if sustain[i] else 0) for i in moved)
    return Score(tuple(notes), tuple(pedal))


def _time(step: np.intp, dt: float) -> float:
    """The beginning of a step [s], rounded, so that goals place it on the same step again."""
    return round(float(step * dt), _TIME_DECIMALS)


def played_in(episode: Episode) -> Score:
    """The notes and the pedal that sounded in an episode."""
    return performed_score(
        episode["key_activation"],
        episode["sustain_activation"],
        episode.dt,
        episode.key_depth,
        episode.lowest_pitch,
    )


def with_velocities_of(played: Score, score: Score) -> Score:
    """`played` with the velocities that `score` writes, on the same clock.

    A note has that of the nearest note of its key that begins within 0.2 s of it, and where there
    is none, because it is wrong, that of a key let down slowly.
    """
    written: dict[int, list[Note]] = defaultdict(list)
    for note in score.notes:
        written[note.pitch].append(note)
    starts = {pitch: [note.start for note in notes] for pitch, notes in written.items()}

    def velocity(note: Note) -> int:
        after = bisect(starts.get(note.pitch, ()), note.start)
        near = written[note.pitch][max(0, after - 1) : after + 1]
        nearest = min(near, key=lambda other: abs(other.start - note.start), default=None)
        if nearest is None or round(abs(nearest.start - note.start), _DECIMALS) > SAME_NOTE:
            return SOFTEST
        return nearest.velocity

    return replace(
        played, notes=tuple(replace(note, velocity=velocity(note)) for note in played.notes)
    )


def _velocity(
    depth: NDArray[Any], first: NDArray[np.intp], key: NDArray[np.intp], dt: float
) -> NDArray[np.intp]:
    """MIDI velocities of keys (N,) that begin to sound on steps `first` (N,)."""
    steps = max(1, round(STRIKE_TIME / dt))
    depth = np.vstack([np.zeros((steps, depth.shape[1])), depth])  # at rest before the first step
    return strike_velocity(depth[first[:, None] + np.arange(steps + 1), key[:, None]])


def strike_velocity(depth: NDArray[Any]) -> NDArray[np.intp]:
    """MIDI velocities (N,) of keys that begin to sound at the end of `depth` (N, n).

    It holds how far each was down over the last `STRIKE_TIME`; see `performed_score`.
    """
    travel = depth[:, -1] - depth.min(axis=1)
    return np.rint(SOFTEST + (LOUDEST - SOFTEST) * travel).astype(np.intp)
