"""Expressive performance of a score by rules of the KTH rule system.

The rules are described by Friberg, Bresin and Sundberg, "Overview of the KTH rule system for
musical performance" (Advances in Cognitive Psychology 2, 2006, 145-161). Formulas and quantities
are those of Director Musices, the program of its authors (github.com/docfry/Director-Musices).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, replace
from heapq import heappop, heappush
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.music.expression_rules import ExpressionRules
from cadenza.music.score import CHORD_TOLERANCE, RELEASE_TIME, Bar, Note, Score, chords

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Slope at medium loudness of the Disklavier of Goebl and Bresin (J. Acoust. Soc. Am. 114, 2003,
# 2273-2283), from which Director Musices computes velocities.
VELOCITY_PER_DECIBEL = 2.8

_SAME_LENGTH = 1e-3  # [s] to which Director Musices rounds durations that it compares
_MIN_INTERVAL = 0.2  # shortest interval after all rules, as a share of the written one

# A gap in the melody counts as a rest, and not as staccato, if it is this long.
_REST = 0.2  # [s]
_REST_SHARE = 0.5  # share of the interval between the onsets

_SEMITONES_PER_DECIBEL = 4.0  # high loud: 3 dB an octave

# Duration contrast: how much notes of these durations [s] are shortened before scaling [ms]
_CONTRAST_DURATIONS = (0.03, 0.2, 0.4, 0.6)
_CONTRAST = (0.0, -11.0, -7.0, 0.0)
_CONTRAST_SECONDS = 1.5e-3  # [s] for each
_CONTRAST_DECIBELS = 0.075  # [dB] for each

_DOUBLE_SHARE = 0.12  # share of the shorter note that the longer one gives it
_DOUBLE_LONGEST = 1.0  # [s]
_UPHILL = 0.002  # [s]
_INEGALITY = 0.22  # share of a note off the beat that it gives to the one before
_INEGAL_LONGEST = 0.5  # [s] of notes, which are taken for beats if they are longer
_INEGAL_SHORTEST = 0.05  # [s] of what is left of a note

# Phrase arch: lengthening and softening at both ends of a phrase, and where it is fastest
_ARCH_START, _ARCH_END = 0.1, 0.2  # of the interval
_ARCH_START_DECIBELS, _ARCH_END_DECIBELS = 0.5, 1.0  # [dB], before the factor
_ARCH_LOUDNESS = 2.0  # this factor, and the turn, are those of the default rule palette
_ARCH_TURN = 0.3  # share of the time from the first onset of the phrase to the last
_PHRASE_LONG = 2.0  # medians of all intervals, at which a note may end a phrase; a choice
_PHRASE_TIME = 4.0  # [s] that a phrase lasts at least; a choice, about three bars
_PHRASE_MOST = 10.0  # [s] that a phrase lasts at most, if it can be divided; a choice

# Punctuation: the micropause [s] after notes of these durations [s]
_PAUSED_DURATIONS = (0.16, 0.64)
_PAUSES = (0.02, 0.06)
_PAUSE_LENGTHENS = 0.45  # share of the pause by which the interval gets longer
_PUNCTUATED_SHARE = 0.6  # share of the mean interval below which notes are not set apart
# Semitones, an octave less a fifth, of leaps between groups; smaller ones hardly weigh
_LEAP = 12 - 7
_FIGURE, _FIGURE_LEAPS = 6, 2  # more than 2 such leaps within 6 notes are of a figure, as arpeggios
_MAX_LEAP = 1.5  # factor by which a leap between groups exceeds both neighbours

# Final ritard: Friberg and Sundberg (J. Acoust. Soc. Am. 105, 1999, 1469-1484)
_RITARD_CURVATURE = 3.0  # q, of runners who stop
_RITARD_TIME = 1.3  # [s] before the last onset at which it begins
_RITARD_TEMPO = 3.0  # the last tempo is 1 / (1 + 3 k) of the written one
_RITARD_LAST_NOTE = 1.25  # of the interval before it, which the last note lasts at least; one that
# is written shorter lasts as much less, so that it stays short

# Melody lead: 20 to 30 ms in Goebl (J. Acoust. Soc. Am. 110, 2001, 563-572). The loudness is a
# choice; Goebl explains the lead by the melody's larger velocity.
_LEAD = 0.025  # [s]
_LEAD_DECIBELS = 3.0  # [dB]
_LEAD_SHARE = 0.5  # share of a note by which it begins later at most

_DEFAULT = ExpressionRules()


class _Melody(NamedTuple):
    """The M notes of the melody, and when they begin and how long they take; see `_melody`."""

    notes: list[Note]
    onset: Floats  # (M,) [s]
    interval: Floats  # (M,) [s] to the next onset; the duration of the last note
    duration: Floats  # (M,) [s] the interval, without a rest in it
    pitch: Floats  # (M,)
    rest: Mask  # (M,) whether a rest follows

    @property
    def inner(self) -> Mask:
        """(M,) whether a note has notes before and after it, without rests between them."""
        inner = ~self.rest
        inner[1:] &= ~self.rest[:-1]
        inner[:1] = inner[-1:] = False
        return inner


def performed(score: Score, dose: float = 1.0, rules: ExpressionRules = _DEFAULT) -> Score:
    """`score` as the rules perform it: other onsets, durations and velocities.

    Pitches, fingers and the order of notes on a key stay as they are, and notes overlap on a key
    only where they did. Pedal and bars move by the same map of time as the notes. As in Director
    Musices, the mean tempo before the final ritard and the mean velocity stay as they are.

    The rules of timing apply to the melody, and everything else follows it; only the final ritard
    applies to all chords. A note is of the melody if it is the highest of its chord and no higher
    note sounds on (the skyline). Its duration is the time to the next note of the melody. The
    interval between the two is stretched evenly, whatever is played within it. All other notes
    begin later by the same lead, so that their rhythm stays even, and are played as much louder or
    softer as the melody above them. Only high loud counts for each note by itself, by its distance
    from the mean pitch of the melody or, if it is not of the melody, of all other notes. Harmonic
    and melodic charge are left out: they need harmonies, which a score does not have.

    A phrase ends before a rest of the melody, or with a note whose interval is at least twice the
    median, but only once it has lasted 4 s. If it lasts over 10 s, it is divided after its longest
    notes. Punctuation uses the two of its published subrules that weigh most: the end of the
    longest of five notes, and leaps against the direction of both neighbours, unless there are so
    many that they are of a figure. Notes that are short for the piece are not set apart. Inegales
    needs bars.

    Args:
        score: what is written.
        dose: multiplies the quantities of all rules; 0 is as written.
        rules: how much each rule does; `Arrangement` checks them and the dose.
    """
    return performed_with_times(score, dose, rules)[0]


def performed_with_times(
    score: Score, dose: float = 1.0, rules: ExpressionRules = _DEFAULT
) -> tuple[Score, Callable[[float], float]]:
    """The performed score, see `performed`, and the map from written to played times [s]."""
    quantity = ExpressionRules(*(dose * k for k in astuple(rules)))
    if not score.notes:
        return score, lambda time: time
    groups = [sorted(chord, key=lambda note: note.pitch) for chord in chords(score.notes)]
    melody = _melody(groups)
    pauses = quantity.punctuation * _micropauses(melody)
    moved = _time_map(
        melody,
        _added_time(melody, pauses, quantity, score.bars),
        np.array([*(min(note.start for note in group) for group in groups), score.total_time]),
        quantity.final_ritard,
    )
    times = _note_times(groups, melody, pauses, moved, quantity.melody_lead * _LEAD)
    velocities = _velocities(score, melody, quantity).tolist()
    notes = (
        replace(note, start=start, end=end, velocity=velocity)
        for note, (start, end), velocity in zip(
            score.notes, map(times, score.notes), velocities, strict=True
        )
    )
    performance = replace(
        score,
        notes=tuple(notes),
        pedal=tuple(replace(event, time=moved(event.time)) for event in score.pedal),
        bars=tuple(bar.moved(moved) for bar in score.bars),
    )
    return performance, moved


def _melody(groups: Sequence[Sequence[Note]]) -> _Melody:
    """The melody of chords by time, each with its notes by pitch; see `performed`."""
    sounding_notes: list[tuple[int, float]] = []  # (-pitch, end [s]), the highest first
    notes: list[Note] = []
    starts: list[float] = []
    for group in groups:
        start, highest = min(note.start for note in group), group[-1]
        while sounding_notes and sounding_notes[0][1] <= start + RELEASE_TIME:
            heappop(sounding_notes)
        if not sounding_notes or -sounding_notes[0][0] <= highest.pitch:
            notes.append(highest)
            starts.append(start)
        for note in group:
            heappush(sounding_notes, (-note.pitch, note.end))
    onset = np.array(starts)
    length = np.array([note.end for note in notes]) - onset
    interval = np.append(np.diff(onset), length[-1])
    rest = interval - length >= np.maximum(_REST, _REST_SHARE * interval)
    pitch = np.array([note.pitch for note in notes], np.float64)
    return _Melody(notes, onset, interval, np.where(rest, length, interval), pitch, rest)


def _added_time(
    melody: _Melody, pauses: Floats, quantity: ExpressionRules, bars: Sequence[Bar]
) -> Floats:
    """(M,) by how much the rules make each interval of the melody longer [s]; 0 in all."""
    interval = melody.interval
    double = np.where(_doubles(melody), _DOUBLE_SHARE * interval, 0.0)
    inequality = _inequality(melody, bars, quantity.inegales)
    added = (
        quantity.duration_contrast * _CONTRAST_SECONDS * _contrast(melody)
        + quantity.double_duration * (double - _of_next(double))
        - quantity.faster_uphill * _UPHILL * _uphill(melody)
        + quantity.phrase_arch * _arch(melody, _ARCH_START, _ARCH_END) * interval
        + _PAUSE_LENGTHENS * pauses
        + _of_next(inequality)
        - inequality
    )
    added = np.maximum(added, (_MIN_INTERVAL - 1) * interval)
    longer = interval + added
    return added - longer * (added.sum() / longer.sum())


def _time_map(
    melody: _Melody, added: Floats, knots: Floats, ritard: float
) -> Callable[[float], float]:
    """The map from written to played time [s], which is linear between `knots`.

    These (N + 1,) are the onsets of all chords and the end of the music [s]. Intervals of the
    melody get longer by `added` (M,) [s]; a final `ritard` slows down all chords.
    """
    melody_knots = np.append(melody.onset, melody.onset[-1] + melody.interval[-1])
    shifts = np.interp(knots, melody_knots, np.append(0.0, np.cumsum(added)))
    if ritard and len(knots) > 2:
        interval = np.diff(knots + shifts)
        slowed = interval * _ritard(knots[:-1], ritard)
        share = min(1.0, interval[-1] / interval[-2])
        slowed[-1] = max(slowed[-1], _RITARD_LAST_NOTE * slowed[-2] * share)
        shifts[1:] += np.cumsum(slowed - interval)
    # A shift of 0 leaves a time as it is to the bit.
    return lambda time: time + float(np.interp(time, knots, shifts))


def _note_times(
    groups: Sequence[Sequence[Note]],
    melody: _Melody,
    pauses: Floats,
    moved: Callable[[float], float],
    lead: float,
) -> Callable[[Note], tuple[float, float]]:
    """The function from a note to when it is played, from its start to its end [s].

    `groups` are the chords by pitch, `pauses` (M,) the micropauses after notes of the melody [s],
    `moved` the map from written to played time, and `lead` how much later other notes begin [s].
    """
    sung = {id(note): index for index, note in enumerate(melody.notes)}
    next_onset = dict[int, float]()
    pause_after = dict[int, int]()  # the melody note with which a note ends
    for group, later in zip(groups, [*groups[1:], []], strict=True):
        index = sung.get(id(group[-1]), -1)
        gap_begin = -inf if index < 0 else melody.onset[index] + melody.interval[index]
        for note in group:
            next_onset[id(note)] = min((other.start for other in later), default=inf)
            if note.end <= gap_begin + CHORD_TOLERANCE:
                pause_after[id(note)] = index

    def times(note: Note) -> tuple[float, float]:
        start, end = moved(note.start), moved(note.end)
        if id(note) not in sung:
            start += min(lead, _LEAD_SHARE * (min(end, moved(next_onset[id(note)])) - start))
        if pause := float(pauses[pause_after[id(note)]]) if id(note) in pause_after else 0.0:
            latest = moved(float(melody.onset[pause_after[id(note)] + 1])) - pause
            end = min(end, max(latest, (start + end) / 2))
        return start, end

    return times


def _velocities(score: Score, melody: _Melody, quantity: ExpressionRules) -> NDArray[np.intp]:
    """(N,) the MIDI velocities at which the notes of `score` are played."""
    arch = _arch(melody, _ARCH_START_DECIBELS, _ARCH_END_DECIBELS)
    level = (
        quantity.duration_contrast * _CONTRAST_DECIBELS * _contrast(melody)
        - quantity.phrase_arch * _ARCH_LOUDNESS * arch
    )
    starts = np.array([note.start for note in score.notes])
    above = np.searchsorted(melody.onset, starts, side="right") - 1
    pitch = np.array([note.pitch for note in score.notes], np.float64)
    sung = {id(note) for note in melody.notes}
    leads = np.array([id(note) in sung for note in score.notes])
    height = pitch - pitch[leads].mean()
    height[~leads] = pitch[~leads] - pitch[~leads].mean() if not leads.all() else 0.0
    decibels = (
        level[above]
        + quantity.high_loud / _SEMITONES_PER_DECIBEL * height
        + quantity.melody_lead * _LEAD_DECIBELS * leads
    )
    decibels -= decibels.mean()
    written = np.array([note.velocity for note in score.notes])
    played = written + VELOCITY_PER_DECIBEL * decibels
    return np.rint(played).astype(np.intp).clip(1, 127)


def _of_next(values: NDArray[np.generic]) -> Floats:
    """(M,) for each note the value of the next one, and 0 for the last."""
    return np.append(values[1:], 0.0)


def _contrast(melody: _Melody) -> Floats:
    """(M,) the duration contrast of notes [ms], without those of the double duration rule."""
    contrast = np.interp(melody.duration, _CONTRAST_DURATIONS, _CONTRAST)
    double = _doubles(melody)
    return np.where(double | (_of_next(double) > 0), 0.0, contrast)


def _doubles(melody: _Melody) -> Mask:
    """(M,) whether a note is half as long as the one before it and shorter than the next."""
    double, length = melody.inner, melody.duration
    middle = length[1:-1]
    double[1:-1] &= np.abs(2 * middle - length[:-2]) < _SAME_LENGTH
    double[1:-1] &= (length[2:] > middle + _SAME_LENGTH) & (middle < _DOUBLE_LONGEST)
    return double


def _uphill(melody: _Melody) -> Floats:
    """(M,) 1 for notes that ascend to the next within an ascent of three or more, else 0."""
    rising = melody.inner
    steps = np.diff(melody.pitch)
    rising[1:-1] &= (steps[:-1] > 0) & (steps[1:] > 0)
    return np.maximum(rising, _of_next(rising))


def _inequality(melody: _Melody, bars: Sequence[Bar], quantity: float) -> Floats:
    """(M,) what notes off the beat give to the equally long notes before them [s]."""
    interval = melody.interval
    if not bars or not quantity:
        return np.zeros(len(interval))
    begins = np.array([bar.time for bar in bars])
    bar = np.searchsorted(begins, melody.onset + _SAME_LENGTH, side="right") - 1
    count = (melody.onset - begins[np.maximum(bar, 0)]) / interval
    off_beat = np.rint(count) % 2 == 1
    off_beat &= np.abs(count - np.rint(count)) * interval < _SAME_LENGTH
    off_beat[1:] &= (np.abs(np.diff(interval)) < _SAME_LENGTH) & ~melody.rest[:-1]
    off_beat[0] = False
    lengthening = quantity * _INEGALITY * interval
    off_beat &= (interval < _INEGAL_LONGEST) & (interval - lengthening > _INEGAL_SHORTEST)
    return np.where(off_beat, lengthening, 0.0)


def _arch(melody: _Melody, start: float, end: float) -> Floats:
    """(M,) parabolas from `start` down to 0 at the turn of each phrase, and up to `end`."""
    arch = np.zeros(len(melody.onset))
    for first, last in _phrases(melody):
        onset = melody.onset[first : last + 1]
        place = (onset - onset[0]) / (onset[-1] - onset[0]) - _ARCH_TURN
        before, after = -place / _ARCH_TURN, place / (1 - _ARCH_TURN)
        arch[first : last + 1] = start * before.clip(0) ** 2 + end * after.clip(0) ** 2
    return arch


def _phrases(melody: _Melody) -> Iterator[tuple[int, int]]:
    """Yield the first and the last note of each phrase of two notes or more; see `performed`."""
    offset = melody.onset + melody.interval
    ends = melody.rest | (melody.interval >= _PHRASE_LONG * np.median(melody.interval))
    ends[-1] = True
    first, count = 0, len(ends)
    for index in np.flatnonzero(ends).tolist():
        if index == count - 1 or offset[index] - melody.onset[first] >= _PHRASE_TIME:
            yield from _divided(melody, first, index)
            first = index + 1


def _divided(melody: _Melody, first: int, last: int) -> Iterator[tuple[int, int]]:
    """Yield a phrase from its first note to its last, or the parts of a long one."""
    undivided = [(first, last)]
    while undivided:
        first, last = undivided.pop()
        onset, interval = melody.onset[first : last + 1], melody.interval[first : last + 1]
        offset, end = onset + interval, onset[-1] + interval[-1]
        left = np.minimum(offset - onset[0], end - offset)  # of the shorter part [s]
        length = np.where(left >= _PHRASE_TIME, interval, 0.0)
        if end - onset[0] > _PHRASE_MOST and length.max() > np.median(interval) + _SAME_LENGTH:
            longest = length > length.max() - _SAME_LENGTH
            cut = first + int(np.argmax(np.where(longest, left, 0.0)))  # nearest to the middle
            undivided += [(first, cut), (cut + 1, last)]
        elif last > first:
            yield first, last


def _micropauses(melody: _Melody) -> Floats:
    """(M,) the pauses [s] after notes that end a small group, 0 after others."""
    length, steps = melody.duration, np.diff(melody.pitch)
    ends = np.zeros(len(length), bool)
    here = length[2:-2]
    ends[2:-2] = (here >= length[:-4]) & (here >= length[1:-3])
    ends[2:-2] &= (here > length[3:-1]) & (here > length[4:])

    before, leap, after = steps[:-2], steps[1:-1], steps[2:]
    size = np.abs(leap)
    leaps = np.zeros(len(length), bool)
    leaps[1:-2] = (
        (size >= _LEAP)
        & (before * leap < 0)
        & (leap * after < 0)
        & (size > _MAX_LEAP * np.maximum(np.abs(before), np.abs(after)))
    )
    near = np.convolve(leaps, np.ones(2 * _FIGURE + 1))[_FIGURE:-_FIGURE]
    ends |= leaps & (near <= _FIGURE_LEAPS)
    ends &= melody.inner & (length >= _PUNCTUATED_SHARE * length.mean())
    return np.where(ends, np.interp(length, _PAUSED_DURATIONS, _PAUSES), 0.0)


def _ritard(onset: Floats, quantity: float) -> Floats:
    """(N,) how much longer the intervals after `onset` (N,) get by the ritard; 1 for the last.

    The tempo at the share x of the written time of the ritard is `(1 + (w^q - 1) x)^(1/q)`, where w
    is the last tempo. The time that passes until x is its reciprocal's integral.
    """
    begin = int(np.searchsorted(onset, onset[-1] - _RITARD_TIME * quantity, "right")) - 1
    begin = min(max(begin, 0), len(onset) - 2)  # at least the last interval, at most all
    share = (onset[begin:] - onset[begin]) / (onset[-1] - onset[begin])
    q = _RITARD_CURVATURE
    drop = np.expm1(-q * np.log1p(_RITARD_TEMPO * quantity))  # exact for small quantities, too
    passed = q / ((q - 1) * drop) * np.expm1((q - 1) / q * np.log1p(drop * share))
    factor = np.ones(len(onset))
    factor[begin:-1] = np.diff(passed) / np.diff(share)
    return factor
