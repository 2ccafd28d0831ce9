"""Beats and bars of music without a metre, estimated from its onsets."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import Bar, Note, chords

Floats = NDArray[np.float64]

_FRAME = 0.01  # [s] of the onset strength
_SMEAR = 0.3, 0.7, 1.0, 0.7, 0.3  # an onset in the frames about it
_PERIODS = 0.3, 1.2  # [s] of a beat: 50 to 200 a minute
_USUAL_PERIOD = 0.6  # [s]; people tap at 100 a minute most readily (Parncutt 1994)
_OCTAVES = 0.7  # standard deviation of that preference, in octaves
_TERNARY = 0.6  # weight of a beat that has rather three parts than two
_TIGHTNESS = 100.0  # weight of even beats against beats on onsets (Ellis 2007: 100 to 400)
_ANCHOR = 0.06  # [s] within which a beat is moved to an onset
_TRIPLE = 0.15  # by which accents have to recur rather after three beats than after two or four
_QUADRUPLE = 0.2  # standard deviations by which downbeats of four beats have to be stronger
_LEAST = 1e-9  # standard deviation of accents
_BASS = 2.0  # accent of a chord that is lower than all about it
_ABOUT = 6  # chords before and after
_LONG = 2.0  # accent of a note that lasts as long as the usual beat; longer ones have no more


def estimated_bars(notes: Sequence[Note]) -> tuple[Bar, ...]:
    """Bars of 2, 3 or 4 quarters that fit the accents of `notes`, which are by start.

    Beats are tracked by dynamic programming (Ellis 2007, Beat Tracking by Dynamic Programming).
    Accents are where many, long or low notes begin.
    """
    groups = list(chords(notes))
    onsets = np.array([group[0].start for group in groups])
    accents = accents_of(groups)
    strength = _strength(onsets, accents)
    period = _period(strength)
    beats = _anchored(onsets[0] + _FRAME * _tracked(strength, period), onsets, period)
    per_bar, phase = _metre(beats, onsets, accents)
    num_before = per_bar - phase if phase else 0  # beats of a bar before the first downbeat
    num_after = -(num_before + len(beats)) % per_bar  # beats that complete the last bar
    beats = np.concatenate(
        [
            beats[0] - period * np.arange(num_before, 0, -1),
            beats,
            beats[-1] + period * np.arange(1, num_after + 1),
        ]
    )
    return tuple(
        Bar(float(beats[i]), number, tuple(beats[i : i + per_bar].tolist()))
        for number, i in enumerate(range(0, len(beats), per_bar), start=1)
    )


def accents_of(groups: list[list[Note]]) -> Floats:
    """How accented each chord is, (O,): by number, length and depth of its notes."""
    onsets = np.array([group[0].start for group in groups])
    gaps = np.append(np.diff(onsets), _USUAL_PERIOD)
    lengths = np.array([max(note.end - note.start for note in group) for group in groups])
    lowest = np.array([min(note.pitch for note in group) for group in groups])
    size = np.sqrt([len(group) for group in groups])
    around = np.pad(lowest, _ABOUT, "edge")
    neighbours = np.lib.stride_tricks.sliding_window_view(around, 2 * _ABOUT + 1)
    depth = (neighbours > lowest[:, None]).mean(axis=1)
    length = np.minimum(np.maximum(lengths, gaps) / _USUAL_PERIOD, 1)
    return np.asarray(size + _LONG * length + _BASS * depth)


def _strength(onsets: Floats, accents: Floats) -> Floats:
    """The onset strength of frames from the first onset on, in standard deviations."""
    frames = np.rint((onsets - onsets[0]) / _FRAME).astype(int)
    strength = np.zeros(frames[-1] + len(_SMEAR))
    np.add.at(strength, frames, accents)
    strength = np.convolve(strength, _SMEAR, "same")
    return np.asarray(strength / strength.std())


def _period(strength: Floats) -> float:
    """The period of the beat [s]: the lag of a large autocorrelation of the onset strength.

    Twice, three and four times the period, which may be bars, count, too.
    """
    size = max(2 * len(strength), round(8 * _PERIODS[1] / _FRAME))
    spectrum = np.fft.rfft(strength - strength.mean(), size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)
    lags = np.arange(*(round(period / _FRAME) for period in _PERIODS))
    together = sum(correlation[k * lags] / k for k in (1, 2, 3, 4))
    octaves = np.log2(lags * _FRAME / _USUAL_PERIOD)
    parts = [np.interp(lags / k, np.arange(len(correlation)), correlation) for k in (2, 3)]
    weight = np.exp(-0.5 * (octaves / _OCTAVES) ** 2) * np.where(parts[0] < parts[1], _TERNARY, 1)
    return float(lags[np.argmax(together * weight)] * _FRAME)


def _tracked(strength: Floats, period: float) -> NDArray[np.int64]:
    """The frames of the beats: the best compromise of even beats and strong onsets."""
    steps = period / _FRAME
    lags = np.arange(round(steps / 2), round(2 * steps) + 1)
    evenness = -_TIGHTNESS * np.log(lags / steps) ** 2
    best, previous = strength.copy(), np.full(len(strength), -1)
    for frame in range(lags[0], len(strength)):
        reach = lags[: frame - lags[0] + 1]
        earlier = best[frame - reach] + evenness[: len(reach)]
        k = int(np.argmax(earlier))
        best[frame] += earlier[k]
        previous[frame] = frame - reach[k]
    last = max(0, len(best) - round(steps))
    frames = [last + int(np.argmax(best[last:]))]
    while (frame := previous[frames[-1]]) >= 0:
        frames.append(int(frame))
    return np.array(frames[::-1])


def _anchored(beats: Floats, onsets: Floats, period: float) -> Floats:
    """The beats from the first onset on: at near onsets, and even between these."""
    nearest = onsets[_nearest(onsets, beats)]
    anchors = np.flatnonzero(np.abs(nearest - beats) <= _ANCHOR)
    if len(anchors):
        index = np.arange(len(beats))
        beyond = np.minimum(index - anchors[0], 0) + np.maximum(index - anchors[-1], 0)
        beats = np.interp(index, anchors, nearest[anchors]) + period * beyond
    missing = max(0, round((beats[0] - onsets[0]) / period))
    return np.concatenate([beats[0] - period * np.arange(missing, 0, -1), beats])


def _nearest(onsets: Floats, times: Floats) -> NDArray[np.int64]:
    """The indices of the onsets that are nearest to `times`."""
    middles = (onsets[1:] + onsets[:-1]) / 2
    return np.searchsorted(middles, times)


def _metre(beats: Floats, onsets: Floats, accents: Floats) -> tuple[int, int]:
    """The number of beats in a bar, and the number of beats before the first downbeat."""
    nearest = _nearest(onsets, beats)
    accent = np.where(np.abs(onsets[nearest] - beats) <= _ANCHOR, accents[nearest], 0.0)
    recurs = {per_bar: _recurrence(accent, per_bar) for per_bar in (2, 3, 4)}
    if recurs[3] > max(recurs[2], recurs[4]) + _TRIPLE:
        return 3, _downbeat(accent, 3)[1]
    (two, phase_of_two), (four, phase_of_four) = _downbeat(accent, 2), _downbeat(accent, 4)
    return (4, phase_of_four) if four > two + _QUADRUPLE else (2, phase_of_two)


def _recurrence(accent: Floats, per_bar: int) -> float:
    """The autocorrelation of the accents of beats at a bar."""
    centred = accent - accent.mean()
    if len(accent) <= per_bar or not centred.any():
        return 0.0
    return float((centred[per_bar:] * centred[:-per_bar]).mean() / centred.var())


def _downbeat(accent: Floats, per_bar: int) -> tuple[float, int]:
    """The greatest accent of downbeats over others [standard deviations], and its phase."""
    phases = range(min(per_bar, len(accent)))
    means = [float(accent[phase::per_bar].mean() - accent.mean()) for phase in phases]
    best = int(np.argmax(means))
    return means[best] / max(float(accent.std()), _LEAST), best
