"""Synthesis of one note of a piano.

A note is a sum of damped sinusoids, `sum_k a_k exp(-s_k t) sin(2 pi f_k t)`, with the stretched
partials of a stiff string, `f_k ~ k f_1 sqrt(1 + B k^2)` (Fletcher, Blackham and Stratton, "Quality
of piano tones", JASA 34, 1962). Each partial is two strings that differ slightly in pitch and in
decay, which gives the piano's fast first and slow second decay (Weinreich, "Coupled piano strings",
JASA 62, 1977). The levels were set by ear and by common measurements of pianos.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Tone = Callable[[int, float, float, int], NDArray[np.float32]]
"""Makes notes from pitch, hardness, length and sample rate, as `tone` does."""

LOUDER = 1.6  # power of the velocity that the amplitude grows with
LAST_DAMPER = 88  # MIDI pitch; strings above have no damper and ring on
DAMPING = 0.06  # [s] in which a damper reduces the sound to 1/e


def tone(pitch: int, hardness: float, seconds: float, rate: int) -> NDArray[np.float32]:
    """An undamped note (n,) of loudness 1, struck with a `hardness` of 0 to 1.

    It decays at first as the strings of C2, C4 and C7 that Bensa et al. fitted to a grand piano
    ("The simulation of piano string vibration", JASA 114, 2003, table I): by 2, 10 and 80 dB a
    second and more the higher the partial. A quarter of the amplitude decays at a quarter of that
    rate, as in Weinreich's record of E flat 4, 8 dB a second and then less than a quarter of it
    ("The coupled motions of piano strings", in Five Lectures on the Acoustics of the Piano, 1990).
    """
    fundamental = 440.0 * 2 ** ((pitch - 69) / 12)
    stiffness = 3.5e-4 * 2 ** (max(pitch - 45, 0) / 9 - 15 / 9)
    order = np.arange(1, 61)
    frequency = fundamental * order * np.sqrt((1 + stiffness * order**2) / (1 + stiffness))
    brightness = 200 + 2800 * hardness**1.5 + 0.6 * fundamental  # [Hz]
    level = np.abs(np.sin(np.pi * order / 8.3)) / order  # struck at about an eighth of the string
    level *= np.exp(-(frequency - fundamental) / brightness)
    audible = (frequency < 0.45 * rate) & (level > 1e-4 * level.max())
    frequency, level = frequency[audible], level[audible] / np.linalg.norm(level[audible])
    prompt = 1.1 * (fundamental / 262) ** 1.03 + 1e-7 * frequency**2  # [1/s]

    # The soundboard's knock: modes that die at once, irregular so that they have no pitch.
    modes = np.arange(24)
    knock = 70 * 1.19**modes * (1 + 0.1 * np.sin(7.0 * modes))
    knock_level = 0.10 * (0.4 + hardness) * np.exp(-knock / (600 + 1500 * hardness))
    length = int(seconds * rate) + 1
    sound = _ring(
        np.concatenate([frequency, frequency * 1.0004, knock]),
        np.concatenate([prompt, prompt / 4, 45 + 0.05 * knock]),
        np.concatenate([0.75 * level, 0.25 * level, knock_level]),
        length,
        rate,
    )
    rise = min(length, int((0.0015 + 0.003 * (1 - hardness)) * rate))
    sound[:rise] *= 0.5 - 0.5 * np.cos(np.pi * np.arange(rise, dtype=np.float32) / rise)
    return sound


def _ring(
    frequency: NDArray[np.floating],
    decay: NDArray[np.floating],
    level: NDArray[np.floating],
    length: int,
    rate: int,
) -> NDArray[np.float32]:
    """Return `length` samples of `sum_k level_k exp(-decay_k t) sin(2 pi frequency_k t)`.

    Sample i * block + j of a damped sinusoid is the product of a factor of i and a factor of j, so
    the sum over k is one matrix product, and few exponentials are computed.
    """
    step = (-decay + 2j * np.pi * frequency) / rate
    block = int(np.sqrt(length)) + 1
    coarse = _powers(block * step, length // block + 1) * level[:, None]
    fine = _powers(step, block)
    # The imaginary part of coarse.T @ fine, in single precision.
    left = np.vstack([np.real(coarse), np.imag(coarse)]).astype(np.float32)
    left[np.abs(left) < 1e-12] = 0  # long inaudible; products of denormal numbers take ages
    right = np.vstack([np.imag(fine), np.real(fine)]).astype(np.float32)
    return (left.T @ right).ravel()[:length]


def _powers(step: NDArray[Any], count: int) -> NDArray[Any]:
    """Return `exp(step_k * i)` (K, count) for i below `count`, by few exponentials."""
    few = int(np.sqrt(count)) + 1
    coarse = np.exp(np.multiply.outer(few * step, np.arange(few)))
    fine = np.exp(np.multiply.outer(step, np.arange(few)))
    return (coarse[:, :, None] * fine[:, None, :]).reshape(len(step), -1)[:, :count]
