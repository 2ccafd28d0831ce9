"""Metrics of the timing and the loudness of a performance, note by note."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.music.metrics import ONSET_TOLERANCE, Pair, matched_notes
from cadenza.music.performance import SAME_NOTE
from cadenza.music.score import LOUDEST, Note, Score

_VELOCITY_TOLERANCE = 0.1  # of the range of the written velocities; the default of mir_eval
_TAIL = 90  # percentile that says how large errors become, beside the median


def expressive_metrics(played: Score, written: Score) -> dict[str, float | None]:
    """Metrics of timing [s] and loudness; each is None where no note can tell it.

    A written and a played note of the same pitch are a pair if they begin within 0.05 s of each
    other. Notes that are left over are paired if they begin within 0.2 s. Each time, as many pairs
    are made as can be, the first note with the first. A written note without a pair was missed.

    - `onset_delay` [s]: the median of played minus written onset; positive is late.
    - `onset_error_median`, `onset_error_90` [s]: median and 90th percentile of the absolute onset
      error that remains after subtracting `onset_delay`.
    - `ioi_error_median`, `ioi_error_90` [s]: absolute error of the inter-onset intervals between
      successive written onsets that have pairs. A chord is played at the mean of its onsets.
    - `chord_spread_median`, `chord_spread_90` [s]: latest minus earliest onset of paired notes that
      are written at exactly the same time.
    - `duration_error_median` [s]: absolute error of the time for which a key is held.
    - `velocity_error`: mean absolute error of the MIDI velocities of pairs.
    - `velocity_error_with_misses`: mean over all written notes, where a missed note counts its
      whole velocity, as if it had been played with velocity 0.
    - `velocity_correlation`: Pearson's correlation of the velocities of pairs; None where either
      side is constant.
    - `note_onset_f1`: F1 of the pairs that begin within 0.05 s, as in `mir_eval.transcription`
      without offsets (Raffel et al., ISMIR 2014).
    - `note_onset_velocity_f1`: the same of those pairs whose velocities also agree, as in
      `mir_eval.transcription_velocity` (Hawthorne et al., ISMIR 2018): the played velocities are
      fitted to the written ones by linear regression, and may then be off by less than a tenth of
      the range of the written velocities. Where repeated notes allow several largest matchings,
      mir_eval may choose another.
    - `onset_f1_times_velocity_accuracy`: `note_onset_f1` times one minus the mean absolute velocity
      error of the pairs within 0.05 s divided by 127.

    Where nothing was written and nothing was played, the last three are 1.

    Args:
        played: what sounded, at the resolution of the physics.
        written: what was to be played, on the same clock.
    """
    close = matched_notes(written.notes, played.notes, ONSET_TOLERANCE)
    pairs = close + matched_notes(
        _without(written.notes, (pair[0] for pair in close)),
        _without(played.notes, (pair[1] for pair in close)),
        SAME_NOTE,
    )
    return {
        **_timing(sorted(pairs, key=lambda pair: pair[0].start)),
        **_loudness(pairs, written),
        **_note_f1(close, written, played),
    }


def _without(notes: Iterable[Note], others: Iterable[Note]) -> list[Note]:
    """The notes that are not among the `others`, which are told apart by identity."""
    left_out = {id(note) for note in others}
    return [note for note in notes if id(note) not in left_out]


def _timing(pairs: Sequence[Pair]) -> dict[str, float | None]:
    """Metrics of the times of `pairs`, which are in the order in which they are written."""
    late = np.array([mine.start - note.start for note, mine in pairs])
    delay = _percentile(late, 50)
    errors = np.abs(late - (delay or 0.0))
    durations = np.array([mine.end - mine.start - (note.end - note.start) for note, mine in pairs])

    onsets: dict[float, list[float]] = defaultdict(list)
    for note, mine in pairs:
        onsets[note.start].append(mine.start)
    intervals = np.diff(list(onsets))
    played_intervals = np.diff([float(np.mean(starts)) for starts in onsets.values()])
    ioi = np.abs(played_intervals - intervals)
    spread = np.array([max(chord) - min(chord) for chord in onsets.values() if len(chord) > 1])
    return {
        "onset_delay": delay,
        "onset_error_median": _percentile(errors, 50),
        "onset_error_90": _percentile(errors, _TAIL),
        "ioi_error_median": _percentile(ioi, 50),
        "ioi_error_90": _percentile(ioi, _TAIL),
        "chord_spread_median": _percentile(spread, 50),
        "chord_spread_90": _percentile(spread, _TAIL),
        "duration_error_median": _percentile(np.abs(durations), 50),
    }


def _loudness(pairs: Sequence[Pair], written: Score) -> dict[str, float | None]:
    """Metrics of the velocities of `pairs`, and of all notes that are `written`."""
    wanted, heard = _velocities(pairs)
    errors = np.abs(heard - wanted)
    missed = sum(note.velocity for note in written.notes) - wanted.sum()
    varies = len(pairs) > 1 and np.ptp(wanted) > 0 and np.ptp(heard) > 0
    return {
        "velocity_error": float(errors.mean()) if pairs else None,
        "velocity_error_with_misses": (
            float(errors.sum() + missed) / len(written.notes) if written.notes else None
        ),
        "velocity_correlation": float(np.corrcoef(wanted, heard)[0, 1]) if varies else None,
    }


def _note_f1(close: Sequence[Pair], written: Score, played: Score) -> dict[str, float | None]:
    """F1 of whole notes; the `close` pairs begin together."""
    notes = len(written.notes) + len(played.notes)
    wanted, heard = _velocities(close)
    accuracy = 1 - float(np.abs(heard - wanted).mean()) / LOUDEST if close else 1.0

    def f1(hits: int) -> float:
        return 2 * hits / notes if notes else 1.0

    return {
        "note_onset_f1": f1(len(close)),
        "note_onset_velocity_f1": f1(_equally_loud(wanted, heard, written)),
        "onset_f1_times_velocity_accuracy": f1(len(close)) * accuracy,
    }


def _equally_loud(wanted: NDArray[np.float64], heard: NDArray[np.float64], written: Score) -> int:
    """The number of pairs whose velocities agree after the linear regression of mir_eval."""
    if not len(wanted):
        return 0
    velocities = [note.velocity for note in written.notes]
    lowest = min(velocities)
    wanted = (wanted - lowest) / max(1, max(velocities) - lowest)
    design = np.stack([heard, np.ones(len(heard))], axis=1)
    fitted = design @ np.linalg.lstsq(design, wanted, rcond=None)[0]
    return int((np.abs(fitted - wanted) < _VELOCITY_TOLERANCE).sum())


def _velocities(pairs: Sequence[Pair]) -> NDArray[np.float64]:
    """(2, P) the written and the played velocities of P pairs."""
    velocities = [(note.velocity, mine.velocity) for note, mine in pairs]
    return np.array(velocities, np.float64).reshape(-1, 2).T


def _percentile(values: NDArray[np.float64], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None
