"""How well the keys that sounded match the keys that should have."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.music.performance import key_runs
from cadenza.music.score import LOWEST_PITCH

ONSET_TOLERANCE = 0.05  # [s], the default of mir_eval
LATENESS_TOLERANCE = 0.2  # [s] within which a note counts as played, if at the wrong time


def step_metrics(
    played: NDArray[Any], goal: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Precision, recall and F1 of each step, each (T,), of `played` (T, n) against `goal` (T, n).

    A ratio 0/0 counts as 1: a step on which nothing should sound and nothing does is perfect.
    """
    played, goal = played.astype(bool), goal.astype(bool)
    hits, sounding, wanted = (x.sum(axis=1) for x in (played & goal, played, goal))
    return _ratio(hits, sounding), _ratio(hits, wanted), _ratio(2 * hits, sounding + wanted)


def playing_metrics(
    key_activation: NDArray[Any],
    sustain_activation: NDArray[Any],
    goal_keys: NDArray[Any],
    goal_sustain: NDArray[Any],
    dt: float,
) -> dict[str, float]:
    """Figures of merit, 0..1 but for the last, of T control steps of `dt` [s].

    `precision`, `recall`, `f1` of the keys (T, 88) and `sustain_*` of the pedal (T,): of each step
    as in `step_metrics`, then the mean over steps, as the published RoboPianist computes them.

    `note_onset_f1`, `note_onset_offset_f1`: whole notes compared with mir_eval's transcription
    metrics (Raffel et al., ISMIR 2014) at its defaults. A run of steps over which a key is on is a
    note; it is found if one of the same key starts within 0.05 s, and for the second also ends
    within 0.05 s or a fifth of the wanted note's length, whichever is more. At steps of 0.05 s a
    key one step late still counts, two steps late does not.

    `timing_error` [s]: how far, on average, the beginnings of notes are from where they should be,
    of as many pairs of notes of the same key as can be made that begin within 0.2 s of each other
    (mir_eval's matching); NaN where there is none. Notes begin on steps, so that a hand which is
    late by less than `dt` is not late.
    """
    precision, recall, f1 = step_metrics(key_activation, goal_keys)
    pedal = step_metrics(sustain_activation[:, None], goal_sustain[:, None])
    return {
        "precision": float(precision.mean()),
        "recall": float(recall.mean()),
        "f1": float(f1.mean()),
        "sustain_precision": float(pedal[0].mean()),
        "sustain_recall": float(pedal[1].mean()),
        "sustain_f1": float(pedal[2].mean()),
        **_note_metrics(key_activation, goal_keys, dt),
    }


def _note_metrics(played: NDArray[Any], goal: NDArray[Any], dt: float) -> dict[str, float]:
    import mir_eval.transcription  # takes a third of a second, and few callers get here

    wanted, wanted_pitch = _intervals(goal, dt)
    sounded, sounded_pitch = _intervals(played, dt)
    if not len(wanted) or not len(sounded):  # mir_eval calls two empty lists a score of 0
        f1 = float(len(wanted) == len(sounded))
        return {"note_onset_f1": f1, "note_onset_offset_f1": f1, "timing_error": math.nan}
    notes = (wanted, wanted_pitch, sounded, sounded_pitch)

    def f1_of(**options: Any) -> float:
        compare = mir_eval.transcription.precision_recall_f1_overlap
        return float(compare(*notes, onset_tolerance=ONSET_TOLERANCE, **options)[2])

    pairs = mir_eval.transcription.match_notes(
        *notes, onset_tolerance=LATENESS_TOLERANCE, offset_ratio=None
    )
    errors = [abs(wanted[i, 0] - sounded[j, 0]) for i, j in pairs]
    return {
        "note_onset_f1": f1_of(offset_ratio=None),
        "note_onset_offset_f1": f1_of(),
        "timing_error": float(np.mean(errors)) if errors else math.nan,
    }


def _intervals(
    roll: NDArray[Any], dt: float
) -> tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]]:
    """Start and end (N, 2) [s] and frequency (N,) [Hz] of the notes of a roll (T, 88)."""
    first, last, key = key_runs(roll)
    hertz = 440.0 * np.exp2((key + LOWEST_PITCH - 69) / 12)
    return np.stack([first, last], axis=1) * dt, hertz


def _ratio(part: NDArray[Any], whole: NDArray[Any]) -> NDArray[np.float64]:
    return np.divide(part, whole, out=np.ones(len(part)), where=whole > 0)
