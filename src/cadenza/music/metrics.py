"""Metrics of a performance, from the keys that sounded and those that should have."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.music.performance import SAME_NOTE, key_runs
from cadenza.music.score import LOWEST_PITCH, Score

# The defaults of mir_eval
ONSET_TOLERANCE = 0.05  # [s]
_OFFSET_RATIO = 0.2  # of a note's length by which its end may be off
_DECIMALS = 4  # to which differences in time [s] are rounded


def step_metrics(
    played: NDArray[Any], goal: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Precision, recall and F1 of each step, each (T,), of `played` (T, n) against `goal` (T, n).

    A ratio 0/0 counts as 1: a step on which nothing should sound and nothing does is perfect. The
    arrays are NumPy's or those of a library like it, which can compile this.
    """
    played, goal = played.astype(bool), goal.astype(bool)
    hits, sounding, wanted = (x.sum(axis=1) for x in (played & goal, played, goal))
    return _ratio(hits, sounding), _ratio(hits, wanted), _ratio(2 * hits, sounding + wanted)


def _pooled(played: NDArray[Any], goal: NDArray[Any]) -> dict[str, float]:
    """Precision, recall and F1 of the hits of all steps together."""
    pooled = step_metrics(played.reshape(1, -1), goal.reshape(1, -1))
    names = ("pooled_precision", "pooled_recall", "pooled_f1")
    return {name: float(value[0]) for name, value in zip(names, pooled, strict=True)}


def playing_metrics(
    key_activation: NDArray[Any],
    sustain_activation: NDArray[Any],
    goal_keys: NDArray[Any],
    goal_sustain: NDArray[Any],
    dt: float,
    score: Score,
    lowest_pitch: int = LOWEST_PITCH,
    played: Score | None = None,
) -> dict[str, float]:
    """Metrics of T control steps of `dt` [s], 0..1 but for the last.

    `precision`, `recall`, `f1` of the keys (T, K) and `sustain_*` of the pedal (T,): of each step
    as in `step_metrics`, then the mean over steps, as the published RoboPianist computes them.

    `pooled_precision`, `pooled_recall`, `pooled_f1` of the keys: of the hits of all steps together,
    so that silence counts for nothing.

    `note_onset_f1`, `note_onset_offset_f1`: whole notes compared as mir_eval's transcription
    metrics do (Raffel et al., ISMIR 2014) at their defaults, but in a time and a memory that grow
    with the music and not with its square. A note of the score is
    found if one of the same key starts within 0.05 s, and for the second also ends within 0.05 s
    or a fifth of the wanted note's length, whichever is more (times are compared to 0.1 ms).

    `timing_error` [s]: how far, on average, the beginnings of notes are from where the score has
    them, of as many pairs of notes of the same key as can be made that begin within 0.2 s of each
    other, the first with the first; NaN where there is none.

    Args:
        key_activation, goal_keys: (T, K), which keys sound and should sound after each step.
        sustain_activation, goal_sustain: (T,), the same of the pedal.
        dt: [s].
        score: what was to be played, on the clock of the steps; notes that begin later than they
            end are left out. The goals cannot tell when a note that is struck again begins, because
            they leave out its first step.
        lowest_pitch: MIDI number of the first key.
        played: the notes that sounded, where it is known when. Otherwise a run of steps over which
            a key is on is a note, from the beginning of its first step to the end of its last: at
            steps of 0.05 s, one that begins a step late is then found, and two steps late is not.
    """
    precision, recall, f1 = step_metrics(key_activation, goal_keys)
    pedal = step_metrics(sustain_activation[:, None], goal_sustain[:, None])
    return {
        "precision": float(precision.mean()),
        "recall": float(recall.mean()),
        "f1": float(f1.mean()),
        **_pooled(key_activation, goal_keys),
        "sustain_precision": float(pedal[0].mean()),
        "sustain_recall": float(pedal[1].mean()),
        "sustain_f1": float(pedal[2].mean()),
        **_note_metrics(
            _Notes.of_score(score, seconds := len(key_activation) * dt, lowest_pitch),
            _Notes.of_roll(key_activation, dt)
            if played is None
            else _Notes.of_score(played, seconds, lowest_pitch),
        ),
    }


def _note_metrics(reference: _Notes, estimated: _Notes) -> dict[str, float]:
    """Metrics of whole notes: those of the score are the reference, those played the estimate."""
    if not len(reference.key) or not len(estimated.key):
        # Silence where nothing was to sound is right, though mir_eval gives it a score of 0.
        f1 = float(len(reference.key) == len(estimated.key))
        return {"note_onset_f1": f1, "note_onset_offset_f1": f1, "timing_error": math.nan}
    near = reference.near(estimated, ONSET_TOLERANCE)
    ends = near[:, reference.ends_with(estimated, near)]
    pairs = _matched_in_order(reference.near(estimated, SAME_NOTE))
    errors = [abs(reference.start[i] - estimated.start[j]) for i, j in pairs]
    return {
        "note_onset_f1": _f1(len(_matched_in_order(near)), reference, estimated),
        "note_onset_offset_f1": _f1(_matching_size(ends), reference, estimated),
        "timing_error": float(np.mean(errors)) if errors else math.nan,
    }


class _Notes(NamedTuple):
    """N notes by key and then time: starts (N,), ends (N,) [s], and keys (N,)."""

    start: NDArray[np.floating[Any]]
    end: NDArray[np.floating[Any]]
    key: NDArray[np.intp]

    @classmethod
    def of_score(cls, score: Score, seconds: float, lowest_pitch: int) -> _Notes:
        """The notes of `score` that begin in its first `seconds`, cut off there."""
        latest = round(seconds, 9)
        notes = [
            (n.pitch - lowest_pitch, n.start, min(n.end, latest))
            for n in score.notes
            if n.start < latest
        ]
        key, start, end = np.array(sorted(notes)).reshape(-1, 3).T
        return cls(start, end, key.astype(np.intp))

    @classmethod
    def of_roll(cls, roll: NDArray[Any], dt: float) -> _Notes:
        """The notes of a roll (T, K) of steps of `dt` [s]."""
        first, last, key = key_runs(roll)
        return cls(first * dt, last * dt, key)

    def near(self, others: _Notes, tolerance: float) -> NDArray[np.intp]:
        """(2, P) indices of pairs, of these notes and `others`, with one key and near starts.

        `tolerance` is how far apart they may start [s].
        """
        # All keys share one axis, on which they are further apart than notes that are near.
        apart = max(self.start.max(), others.start.max()) + 1.0 + 2 * tolerance
        mine, theirs = self.key * apart + self.start, others.key * apart + others.start
        room = tolerance + 10.0**-_DECIMALS
        low, high = (np.searchsorted(mine, theirs + side) for side in (-room, room))
        count = high - low
        j = np.repeat(np.arange(len(theirs)), count)
        i = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - low, count)
        return np.stack([i, j])[:, _is_within(self.start[i] - others.start[j], tolerance)]

    def ends_with(self, others: _Notes, pairs: NDArray[np.intp]) -> NDArray[np.bool_]:
        """(P,) whether the notes of each of `pairs` (2, P) also end together."""
        i, j = pairs
        tolerance = np.maximum(_OFFSET_RATIO * (self.end[i] - self.start[i]), ONSET_TOLERANCE)
        return _is_within(self.end[i] - others.end[j], tolerance)


def _is_within(difference: NDArray[Any], tolerance: Any) -> NDArray[np.bool_]:
    return np.asarray(np.around(np.abs(difference), _DECIMALS) <= tolerance)


def _matched_in_order(near: NDArray[np.intp]) -> list[tuple[int, int]]:
    """A largest matching among the pairs `near` (2, P), the first note with the first."""
    taken: dict[int, int] = {}
    done = -1
    for i, j in near.T.tolist():
        if j > done and i not in taken:
            taken[i] = done = j
    return sorted(taken.items())


def _matching_size(edges: NDArray[np.intp]) -> int:
    """The size of a largest matching in the bipartite graph of `edges` (2, P)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    if not edges.size:
        return 0
    graph = coo_array((np.ones(edges.shape[1]), tuple(edges))).tocsr()
    return int((maximum_bipartite_matching(graph) >= 0).sum())


def _f1(pairs: int, reference: _Notes, estimated: _Notes) -> float:
    precision, recall = pairs / len(estimated.key), pairs / len(reference.key)
    return 2 * precision * recall / (precision + recall) if pairs else 0.0


def _ratio(part: NDArray[Any], whole: NDArray[Any]) -> NDArray[np.float64]:
    """`part` / `whole`, and 1 where both are 0."""
    xp = whole.__array_namespace__()
    ratio: NDArray[np.float64] = xp.where(whole > 0, part / xp.maximum(whole, 1), 1.0)
    return ratio
