"""Beats and bars of music without a metre, estimated from its onsets."""

from __future__ import annotations

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
_METRES = 4, 3, 2  # beats in a bar; of equally good ones the first is taken
_BETTER = 1e-6  # by which a later one has to be better
_BASS = 0.5  # accent of the lowest pitch against the highest
_LONG = 2.0  # accent of a note that lasts as long as the usual beat; longer ones have no more


def estimated_bars(notes: Sequence[Note]) -> tuple[Bar, ...]:
    """Bars of 2, 3 or 4 quarters that fit the accents of `notes`, which are by start.

    Beats are tracked by dynamic programming (Ellis 2007, Beat Tracking by Dynamic Programming).
    Accents are where many, long or low notes begin.
    """
    groups = list(chords(notes))
    onsets = np.array([group[0].start for group in groups])
    accents = _accents(groups, onsets)
    strength = _strength(onsets, accents)
    period = _period(strength)
    beats = _anchored(onsets[0] + _FRAME * _tracked(strength, period), onsets, period)
    per_bar, phase = _metre(beats, onsets, accents)
    before = per_bar - phase if phase else 0  # beats of a bar before the first downbeat
    after = -(before + len(beats)) % per_bar  # beats that complete the last bar
    beats = np.concatenate(
        [
            beats[0] - period * np.arange(before, 0, -1),
            beats,
            beats[-1] + period * np.arange(1, after + 1),
        ]
    )
    return tuple(
        Bar(float(beats[i]), number, tuple(beats[i : i + per_bar].tolist()))
        for number, i in enumerate(range(0, len(beats), per_bar), start=1)
    )


def _accents(groups: list[list[Note]], onsets: Floats) -> Floats:
    """How accented each chord is, (O,): by number, length and depth of its notes."""
    gaps = np.append(np.diff(onsets), _USUAL_PERIOD)
    lengths = np.array([max(note.end - note.start for note in group) for group in groups])
    lowest = np.array([min(note.pitch for note in group) for group in groups])
    size = np.sqrt([len(group) for group in groups])
    depth = (lowest.max() - lowest) / max(np.ptp(lowest), 1)
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
    """The period of the beat [s], where the autocorrelation of the onset strength is large.

    It is to be so at twice, three times and four times the period, too, which may be bars.
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
    """The frames of beats that are as even and on as strong onsets as can be."""
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
    """The beats from the first onset on, moved to onsets that are near, and evenly between them."""
    nearest = onsets[_nearest(onsets, beats)]
    held = np.flatnonzero(np.abs(nearest - beats) <= _ANCHOR)
    if len(held):
        index = np.arange(len(beats))
        beyond = np.minimum(index - held[0], 0) + np.maximum(index - held[-1], 0)
        beats = np.interp(index, held, nearest[held]) + period * beyond
    missing = max(0, round((beats[0] - onsets[0]) / period))
    return np.concatenate([beats[0] - period * np.arange(missing, 0, -1), beats])


def _nearest(onsets: Floats, times: Floats) -> NDArray[np.int64]:
    """The indices of the onsets that are nearest to `times`."""
    middles = (onsets[1:] + onsets[:-1]) / 2
    return np.searchsorted(middles, times)


def _metre(beats: Floats, onsets: Floats, accents: Floats) -> tuple[int, int]:
    """The number of beats in a bar, and how many precede the first downbeat."""
    nearest = _nearest(onsets, beats)
    accent = np.where(np.abs(onsets[nearest] - beats) <= _ANCHOR, accents[nearest], 0.0)
    best, chosen = -np.inf, (_METRES[0], 0)
    for per_bar in _METRES:
        for phase in range(min(per_bar, len(beats))):
            # More beats in a bar leave fewer downbeats, whose mean varies more.
            contrast = (accent[phase::per_bar].mean() - accent.mean()) * np.sqrt(12 / per_bar)
            if contrast > best + _BETTER:
                best, chosen = contrast, (per_bar, phase)
    return chosen
