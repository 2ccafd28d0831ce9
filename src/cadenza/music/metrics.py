"""Metrics of a performance: of the keys in each step, and of notes, their timing and loudness."""

import math
from bisect import bisect_left, bisect_right
from collections import defaultdict, deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.music.performance import SAME_NOTE, performed_score
from cadenza.music.score import LOUDEST, LOWEST_PITCH, Note, Score

Pair = tuple[Note, Note]  # a note that was written, and the note played for it

# The defaults of mir_eval
ONSET_TOLERANCE = 0.05  # [s]
_OFFSET_RATIO = 0.2  # share of a note's length by which its end may be off
_DECIMALS = 4  # decimals of differences in time [s]

STEP_METRICS = "precision", "recall", "f1"


def step_metrics(
    played: NDArray[Any], goal: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Precision, recall and F1 of each step, each (T,), of `played` (T, n) against `goal` (T, n).

    A ratio 0/0 counts as 1: a step on which nothing should sound and nothing does is perfect. The
    arrays are NumPy's or those of a library like it, which can compile this.
    """
    played, goal = played.astype(bool), goal.astype(bool)
    hits, sounding, due = (x.sum(axis=1) for x in (played & goal, played, goal))
    return _ratio(hits, sounding), _ratio(hits, due), _ratio(2 * hits, sounding + due)


def _pooled(played: NDArray[Any], goal: NDArray[Any]) -> dict[str, float]:
    """Precision, recall and F1 of the hits of all steps together."""
    pooled = step_metrics(played.reshape(1, -1), goal.reshape(1, -1))
    return {
        f"pooled_{name}": float(value[0]) for name, value in zip(STEP_METRICS, pooled, strict=True)
    }


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
    or a fifth of the written note's length, whichever is more (times are compared to 0.1 ms).

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
    if played is None:
        played = performed_score(key_activation, sustain_activation, dt, None, lowest_pitch)
    seconds = len(key_activation) * dt
    return {
        "precision": float(precision.mean()),
        "recall": float(recall.mean()),
        "f1": float(f1.mean()),
        **_pooled(key_activation, goal_keys),
        "sustain_precision": float(pedal[0].mean()),
        "sustain_recall": float(pedal[1].mean()),
        "sustain_f1": float(pedal[2].mean()),
        **_note_metrics(_beginning(score, seconds), _beginning(played, seconds)),
    }


def _note_metrics(written: list[Note], played: list[Note]) -> dict[str, float]:
    """Metrics of whole notes, which are by pitch and then time."""
    if not written or not played:
        # Silence where nothing was to sound is right, though mir_eval gives it a score of 0.
        right = float(len(written) == len(played))
        return {"note_onset_f1": right, "note_onset_offset_f1": right, "timing_error": math.nan}

    def f1(pairs: int) -> float:
        precision, recall = pairs / len(played), pairs / len(written)
        return 2 * precision * recall / (precision + recall) if pairs else 0.0

    pairs = matched_notes(written, played, SAME_NOTE)
    errors = [abs(note.start - own.start) for note, own in pairs]
    return {
        "note_onset_f1": f1(len(matched_notes(written, played, ONSET_TOLERANCE))),
        "note_onset_offset_f1": f1(_matching_size(_alike(written, played))),
        "timing_error": float(np.mean(errors)) if errors else math.nan,
    }


def _beginning(score: Score, seconds: float) -> list[Note]:
    """The notes that begin in the first `seconds`, by pitch and then time, cut off there."""
    latest = round(seconds, 9)
    notes = (
        note if note.end <= latest else replace(note, end=latest)
        for note in score.notes
        if note.start < latest
    )
    return sorted(notes, key=attrgetter("pitch", "start", "end"))


def matched_notes(written: Iterable[Note], played: Iterable[Note], tolerance: float) -> list[Pair]:
    """A largest matching of notes of one pitch that begin within `tolerance` [s] of each other.

    Those of a pitch are in order of time, and the first is matched with the first. It takes a time
    that grows with the number of notes.
    """
    unmatched: dict[int, deque[Note]] = defaultdict(deque)
    for note in played:
        unmatched[note.pitch].append(note)
    pairs: list[Pair] = []
    for note in written:
        waiting = unmatched[note.pitch]
        # What begins too early for this note is too early for all later ones.
        while waiting and round(note.start - waiting[0].start, _DECIMALS) > tolerance:
            waiting.popleft()
        if waiting and round(waiting[0].start - note.start, _DECIMALS) <= tolerance:
            pairs.append((note, waiting.popleft()))
    return pairs


def _alike(written: Sequence[Note], played: Sequence[Note]) -> list[tuple[int, int]]:
    """Pairs of indices of notes of one pitch that begin and end together; both are in order."""
    pairs: list[tuple[int, int]] = []
    order, room = attrgetter("pitch", "start"), ONSET_TOLERANCE + 10.0**-_DECIMALS
    for i, note in enumerate(written):
        first = bisect_left(played, (note.pitch, note.start - room), key=order)
        end = bisect_right(played, (note.pitch, note.start + room), key=order)
        tolerance = max(_OFFSET_RATIO * (note.end - note.start), ONSET_TOLERANCE)
        pairs += [
            (i, j)
            for j in range(first, end)
            if round(abs(note.start - played[j].start), _DECIMALS) <= ONSET_TOLERANCE
            and round(abs(note.end - played[j].end), _DECIMALS) <= tolerance
        ]
    return pairs


def _matching_size(edges: Sequence[tuple[int, int]]) -> int:
    """The size of a largest matching in the bipartite graph of these edges."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    if not edges:
        return 0
    graph = coo_array((np.ones(len(edges)), tuple(np.array(edges).T))).tocsr()
    return int((maximum_bipartite_matching(graph) >= 0).sum())


def _ratio(part: NDArray[Any], total: NDArray[Any]) -> NDArray[np.float64]:
    """`part` / `total`, and 1 where both are 0."""
    xp = total.__array_namespace__()
    ratio: NDArray[np.float64] = xp.where(total > 0, part / xp.maximum(total, 1), 1.0)
    return ratio


_VELOCITY_TOLERANCE = 0.1  # share of the range of written velocities; the default of mir_eval
_TAIL = 90  # percentile that says how large errors become, beside the median


def expressive_metrics(played: Score, written: Score) -> dict[str, float | None]:
    """Metrics of timing [s] and loudness; each is None where no note can tell it.

    A written and a played note of the same pitch are a pair if they begin within 0.05 s of each
    other. Notes that are left over are paired if they begin within 0.2 s. Each time, as many pairs
    are made as can be, the first note with the first. A written note without a pair was missed.

    The page on results says what each metric is. A chord is played at the mean of its onsets, and
    spreads if its notes are written at exactly the same time. In `velocity_error_with_misses`, a
    missed note counts its whole velocity; `velocity_correlation` is None where either side is
    constant. `note_onset_f1` is that of `mir_eval.transcription` without offsets (Raffel et al.,
    ISMIR 2014), `note_onset_velocity_f1` that of `mir_eval.transcription_velocity` (Hawthorne et
    al., ISMIR 2018): the played velocities are fitted to the written ones by linear regression, and
    may then be off by less than a tenth of the range of the written velocities. Where repeated
    notes allow several largest matchings, mir_eval may choose another.

    Where nothing was written and nothing was played, the three F1 are 1.

    Args:
        played: what sounded, at the resolution of the physics.
        written: what was to be played, on the same clock.
    """
    errors = note_errors(written.notes, played.notes)
    close = errors.pairs
    pairs = close + list(zip(errors.missed.off_time, errors.extra.off_time, strict=True))
    return {
        **_timing(sorted(pairs, key=lambda pair: pair[0].start)),
        **_loudness(pairs, written),
        **_note_f1(close, written, played),
        **{f"{name}_per_100": _per_100(number, written) for name, number in errors.counts.items()},
    }


def _without_pairs(
    written: Iterable[Note], played: Iterable[Note], pairs: Sequence[Pair]
) -> tuple[list[Note], list[Note]]:
    """The written and the played notes that are in no pair; notes are told apart by identity."""
    paired_written, paired_played = ({id(pair[side]) for pair in pairs} for side in (0, 1))
    return (
        [note for note in written if id(note) not in paired_written],
        [note for note in played if id(note) not in paired_played],
    )


def _timing(pairs: Sequence[Pair]) -> dict[str, float | None]:
    """Metrics of the times of `pairs`, which are in the order in which they are written."""
    late = np.array([own_note.start - note.start for note, own_note in pairs])
    delay = _percentile(late, 50)
    errors = np.abs(late - (delay or 0.0))
    durations = np.array(
        [own_note.end - own_note.start - (note.end - note.start) for note, own_note in pairs]
    )

    onsets: dict[float, list[float]] = defaultdict(list)
    for note, own_note in pairs:
        onsets[note.start].append(own_note.start)
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
    reference, estimate = _velocities(pairs)
    errors = np.abs(estimate - reference)
    missed = sum(note.velocity for note in written.notes) - reference.sum()
    varies = len(pairs) > 1 and np.ptp(reference) > 0 and np.ptp(estimate) > 0
    return {
        "velocity_error": float(errors.mean()) if pairs else None,
        "velocity_error_with_misses": (
            float(errors.sum() + missed) / len(written.notes) if written.notes else None
        ),
        "velocity_correlation": float(np.corrcoef(reference, estimate)[0, 1]) if varies else None,
    }


def _note_f1(close: Sequence[Pair], written: Score, played: Score) -> dict[str, float | None]:
    """F1 of whole notes; the `close` pairs begin together."""
    notes = len(written.notes) + len(played.notes)
    reference, estimate = _velocities(close)
    accuracy = 1 - float(np.abs(estimate - reference).mean()) / LOUDEST if close else 1.0

    def f1(hits: int) -> float:
        return 2 * hits / notes if notes else 1.0

    return {
        "note_onset_f1": f1(len(close)),
        "note_onset_velocity_f1": f1(_equally_loud(reference, estimate, written)),
        "onset_f1_times_velocity_accuracy": f1(len(close)) * accuracy,
    }


def _per_100(number: int, written: Score) -> float | None:
    return 100 * number / len(written.notes) if written.notes else None


def _equally_loud(
    reference: NDArray[np.float64], estimate: NDArray[np.float64], written: Score
) -> int:
    """The number of pairs whose velocities agree after the linear regression of mir_eval."""
    if not len(reference):
        return 0
    velocities = [note.velocity for note in written.notes]
    lowest = min(velocities)
    reference = (reference - lowest) / max(1, max(velocities) - lowest)
    design = np.stack([estimate, np.ones(len(estimate))], axis=1)
    fitted = design @ np.linalg.lstsq(design, reference, rcond=None)[0]
    return int((np.abs(fitted - reference) < _VELOCITY_TOLERANCE).sum())


def _velocities(pairs: Sequence[Pair]) -> NDArray[np.float64]:
    """(2, P) the written and the played velocities of P pairs."""
    velocities = [(note.velocity, own.velocity) for note, own in pairs]
    return np.array(velocities, np.float64).reshape(-1, 2).T


def _percentile(values: NDArray[np.float64], percent: float) -> float | None:
    return float(np.percentile(values, percent)) if len(values) else None


_BESIDE = 2  # semitones from a key up to which others lie beside it
_BRUSHED = 0.06  # [s] than which the note of a key that a finger brushes in passing is shorter
# Of a written note, how much earlier or later than it another key may sound by mistake for it [s].
_BEFORE, _AFTER = 0.15, 0.1


class ExtraNotes(NamedTuple):
    """Notes that were played for no written note, by kind."""

    # They are more than 50 ms late or early, for a written note that is missed
    off_time: list[Note]
    again: list[Note]  # their key should sound then, or just did, and was struck again
    neighbour: list[Note]  # their key lies beside one that should sound
    other: list[Note]


class MissedNotes(NamedTuple):
    """Written notes for which none was played within 50 ms, by kind."""

    off_time: list[Note]  # they were played late or early
    held: list[Note]  # their key was still down from before
    silent: list[Note]  # their key did not begin to sound


class NoteErrors(NamedTuple):
    """The notes of a performance that are right, and those that are not."""

    pairs: list[Pair]  # notes that begin within 50 ms of each other, the written one first
    extra: ExtraNotes
    missed: MissedNotes

    @property
    def counts(self) -> dict[str, int]:
        """The numbers of extra and of missed notes, then by kind, such as `extra_neighbour`.

        `extra_brushed` are those of the neighbours that are shorter than 60 ms.
        """
        counts = dict.fromkeys(("extra_notes", "missed_notes"), 0)
        for name, kinds in (("extra", self.extra._asdict()), ("missed", self.missed._asdict())):
            counts |= {f"{name}_{kind}": len(notes) for kind, notes in kinds.items()}
            counts[f"{name}_notes"] = sum(map(len, kinds.values()))
        brushed = sum(note.end - note.start < _BRUSHED for note in self.extra.neighbour)
        return counts | {"extra_brushed": brushed}


def note_errors(written: Iterable[Note], played: Iterable[Note]) -> NoteErrors:
    """Sort the notes that are extra or missed by kind, each into the first one that it fits.

    Pairs are those of `matched_notes` within 50 ms, and of what is left, those within 200 ms are
    late or early.
    """
    written, played = (sorted(notes, key=attrgetter("start")) for notes in (written, played))
    pairs = matched_notes(written, played, ONSET_TOLERANCE)
    off_time = matched_notes(*_without_pairs(written, played, pairs), SAME_NOTE)
    due_notes, sounding_notes = _by_pitch(written), _by_pitch(played)
    missed = MissedNotes([note for note, _ in off_time], [], [])
    extra = ExtraNotes([note for _, note in off_time], [], [], [])
    written, played = _without_pairs(written, played, pairs + off_time)
    for note in written:
        earlier = (n for n in sounding_notes[note.pitch] if n.start < note.start - ONSET_TOLERANCE)
        (missed.held if _any_at(note.start, earlier) else missed.silent).append(note)
    for note in played:
        beside = range(note.pitch - _BESIDE, note.pitch + _BESIDE + 1)
        if _any_at(note.start, due_notes[note.pitch], SAME_NOTE, SAME_NOTE):
            extra.again.append(note)
        elif any(_any_at(note.start, due_notes[pitch], _BEFORE, _AFTER) for pitch in beside):
            extra.neighbour.append(note)
        else:
            extra.other.append(note)
    return NoteErrors(pairs, extra, missed)


def _by_pitch(notes: Iterable[Note]) -> defaultdict[int, list[Note]]:
    by_pitch = defaultdict[int, list[Note]](list)
    for note in notes:
        by_pitch[note.pitch].append(note)
    return by_pitch


def _any_at(time: float, notes: Iterable[Note], before: float = 0.0, after: float = 0.0) -> bool:
    """Whether any note sounds at a time, or from so long before to so long after it [s]."""
    return any(note.start - before <= time <= note.end + after for note in notes)
