"""Beats and bars of music without a metre, estimated from its onsets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import Bar, Note, chords

_FRAME = 0.01  # [s] of the onset strength
_PERIODS = 0.3, 1.2  # [s] of a beat: 50 to 200 a minute
_USUAL_PERIOD = 0.6  # [s]; people tap at 100 a minute most readily (Parncutt 1994)
_OCTAVES = 0.7  # standard deviation of that preference, in octaves
_TIGHTNESS = 100.0  # weight of even beats against beats on onsets (Ellis 2007: 100 to 400)
_ANCHOR = 0.06  # [s] within which a beat is moved to an onset
_METRES = 2, 3, 4  # beats in a bar
_BASS = 0.5  # accent of the lowest pitch against the highest
_LONG = 2.0  # accent of a note that lasts as long as a beat; longer ones have no more


def estimated_bars(notes: Sequence[Note]) -> tuple[Bar, ...]:
    """Bars of 2, 3 or 4 quarters that fit the accents of `notes`, which are by start.

    Beats are tracked by dynamic programming (Ellis 2007, Beat Tracking by Dynamic Programming).
    Accents are where many, long or low notes begin.
    """
    groups = list(chords(notes))
    onsets = np.array([group[0].start for group in groups])
    accents = _accents(groups, onsets)
    period = _period(onsets, accents)
    beats = _beats(onsets, accents, period)
    per_bar, phase = _metre(beats, onsets, accents)
    first = phase - per_bar if phase else 0  # a bar before the first downbeat
    step = beats[1] - beats[0]
    before = beats[0] + step * np.arange(min(first, 0), 0)
    beats = np.concatenate([before, beats])
    return tuple(
        Bar(float(beats[i]), number, tuple(beats[i : i + per_bar].tolist()))
        for number, i in enumerate(range(0, len(beats), per_bar), start=1)
    )


def _accents(groups: list[list[Note]], onsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """How accented each chord is, (O,): by number, length and depth of its notes."""
    gaps = np.append(np.diff(onsets), _USUAL_PERIOD)
    lengths = np.array([max(note.end - note.start for note in group) for group in groups])
    lowest = np.array([min(note.pitch for note in group) for group in groups])
    size = np.sqrt([len(group) for group in groups])
    depth = (lowest.max() - lowest) / max(np.ptp(lowest), 1)
    length = np.minimum(np.maximum(lengths, gaps) / _USUAL_PERIOD, 1)
    return np.asarray(size + _LONG * length + _BASS * depth)


def _period(onsets: NDArray[np.float64], accents: NDArray[np.float64]) -> float:
    """The period of the beat [s]: where the autocorrelation of the onset strength is largest."""
    strength = _strength(onsets, accents)
    size = 1 << (2 * len(strength) - 1).bit_length()
    spectrum = np.fft.rfft(strength - strength.mean(), size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)
    least, most = (round(period / _FRAME) for period in _PERIODS)
    lags = np.arange(least, most + 1)
    octaves = np.log2(lags * _FRAME / _USUAL_PERIOD)
    # A beat that is one in a bar of two or three, too.
    multiples = sum(correlation[np.minimum(k * lags, size - 1)] / k for k in (1, 2, 3, 4))
    return float(lags[np.argmax(multiples * np.exp(-0.5 * (octaves / _OCTAVES) ** 2))] * _FRAME)


def _strength(onsets: NDArray[np.float64], accents: NDArray[np.float64]) -> NDArray[np.float64]:
    """The onset strength of frames, with onsets smeared over a few of them."""
    frames = np.rint((onsets - onsets[0]) / _FRAME).astype(int)
    strength = np.zeros(frames[-1] + 1)
    np.add.at(strength, frames, accents)
    return np.convolve(strength, [0.3, 0.7, 1.0, 0.7, 0.3], "same")[: len(strength)]


def _beats(
    onsets: NDArray[np.float64], accents: NDArray[np.float64], period: float
) -> NDArray[np.float64]:
    """The times of at least two beats [s]."""
    strength = _strength(onsets, accents) / accents.std() if accents.std() else None
    if strength is None:
        strength = _strength(onsets, accents) / accents.mean()
    steps = period / _FRAME
    lags = np.arange(round(steps / 2), round(2 * steps) + 1)
    cost = -_TIGHTNESS * np.log(lags / steps) ** 2
    best, previous = strength.copy(), np.full(len(strength), -1)
    for frame in range(lags[0], len(strength)):
        reach = lags[: np.searchsorted(lags, frame, "right")]
        ahead = best[frame - reach] + cost[: len(reach)]
        k = int(np.argmax(ahead))
        best[frame] += ahead[k]
        previous[frame] = frame - reach[k]
    tail = max(0, len(best) - round(steps))
    frame = tail + int(np.argmax(best[tail:]))
    frames = [frame]
    while (frame := previous[frame]) >= 0:
        frames.append(frame)
    return _anchored(onsets[0] + _FRAME * np.array(frames[::-1]), onsets, period)


def _anchored(
    beats: NDArray[np.float64], onsets: NDArray[np.float64], period: float
) -> NDArray[np.float64]:
    """The beats, on onsets that are near, and else evenly between those; up to the first onset."""
    nearest = (
        onsets[np.argmin(np.abs(onsets[:, None] - beats), axis=0)]
        if len(beats) < 2
        else (_nearest(onsets, beats))
    )
    held = np.abs(nearest - beats) <= _ANCHOR
    if held.any():
        index = np.arange(len(beats))
        beats = np.interp(index, index[held], nearest[held]) + np.where(
            index < index[held][0],
            (index - index[held][0]) * period,
            np.where(index > index[held][-1], (index - index[held][-1]) * period, 0.0),
        )
    missing = round((beats[0] - onsets[0]) / period)
    before = beats[0] + period * np.arange(-max(missing, 0), 0)
    after = beats[-1] + period * np.arange(1, 2 if len(before) + len(beats) < 2 else 1)
    return np.concatenate([before, beats, after])


def _nearest(onsets: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    after = np.searchsorted(onsets, times).clip(1, len(onsets) - 1) if len(onsets) > 1 else None
    if after is None:
        return np.full(len(times), onsets[0])
    before = after - 1
    return np.where(times - onsets[before] < onsets[after] - times, onsets[before], onsets[after])


def _metre(
    beats: NDArray[np.float64], onsets: NDArray[np.float64], accents: NDArray[np.float64]
) -> tuple[int, int]:
    """The number of beats in a bar, and how many precede the first downbeat."""
    nearest = np.zeros(len(beats))
    for onset, accent in zip(onsets, accents, strict=True):
        k = (
            int(np.argmin(np.abs(beats - onset)))
            if len(beats) < 8
            else int(np.searchsorted(beats, onset - _ANCHOR))
        )
        if k < len(beats) and abs(beats[k] - onset) <= _ANCHOR:
            nearest[k] = max(nearest[k], accent)
    best, chosen = -np.inf, (_METRES[-1], 0)
    for per_bar in _METRES:
        for phase in range(per_bar):
            down = nearest[phase::per_bar]
            if not len(down):
                continue
            contrast = (down.mean() - nearest.mean()) * np.sqrt(per_bar)
            if contrast > best + 1e-6:
                best, chosen = contrast, (per_bar, phase)
    return chosen
