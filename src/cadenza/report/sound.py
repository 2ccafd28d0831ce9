"""A score made audible: additive synthesis of a piano with numpy.

A note is a sum of damped sinusoids, `sum_k a_k exp(-s_k t) sin(2 pi f_k t)`, with the stretched
partials of a stiff string, `f_k ~ k f_1 sqrt(1 + B k^2)` (Fletcher, Blackham and Stratton, "Quality
of piano tones", JASA 34, 1962). Each partial is two strings that differ slightly in pitch and in
decay, which gives the piano's fast first and slow second decay (Weinreich, "Coupled piano strings",
JASA 62, 1977). The levels and decay times were set by ear and by common measurements of pianos.
"""

from __future__ import annotations

import io
import wave
from collections import defaultdict
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal

from cadenza.files import write_atomically
from cadenza.music.score import NUM_KEYS, Note, Score

SAMPLE_RATE = 44100  # [Hz]

_LOUDNESS = 0.22  # amplitude of one note played as hard as possible; ten of them meet the limiter
_CEILING = 0.89  # no sample is larger
_LAST_DAMPER = 88  # MIDI pitch; strings above have no damper and ring on
_DAMPING = 0.06  # [s] in which a damper reduces the sound to 1/e
_VELOCITY_BAND = 8  # velocities that share one timbre
_TAIL = 0.7  # [s] of room after the last note
_ROOM = 0.05  # level of the room against the piano


def synthesize(score: Score, sample_rate: int = SAMPLE_RATE) -> NDArray[np.float32]:
    """The sound of `score`, (n, 2) left and right within -1..1; (0, 2) without notes.

    Louder notes are also brighter; while the pedal is down, notes ring on after their end.
    """
    if not score.notes:
        return np.zeros((0, 2), np.float32)
    releases = _releases(score)
    latest = max(r + _damping(n.pitch) for n, r in zip(score.notes, releases, strict=True))
    mix = np.zeros((int((latest + _TAIL) * sample_rate) + 1, 2), np.float32)
    alike: dict[tuple[int, int], list[tuple[Note, float]]] = defaultdict(list)
    for note, release in zip(score.notes, releases, strict=True):
        band = note.velocity // _VELOCITY_BAND * _VELOCITY_BAND + _VELOCITY_BAND // 2
        alike[note.pitch, band].append((note, release))
    for (pitch, band), notes in alike.items():
        seconds = max(release - note.start for note, release in notes) + _damping(pitch)
        tone = _tone(pitch, band / 127, seconds, sample_rate)
        for note, release in notes:
            sound = _damped(tone, release - note.start, pitch, sample_rate)
            first = round(note.start * sample_rate)
            gain = _LOUDNESS * (note.velocity / 127) ** 1.6
            mix[first : first + len(sound)] += sound[:, None] * (gain * _pan(note.key))
    return _limited(_in_room(mix, sample_rate), sample_rate)


def write_wav(path: Path, audio: NDArray[np.floating], sample_rate: int = SAMPLE_RATE) -> None:
    """Writes `audio`, (n,) or (n, 2) within -1..1, as 16 bit PCM."""
    samples = np.round(np.clip(audio, -1, 1) * 32767).astype("<i2")
    with write_atomically(path) as raw, wave.open(raw, "wb") as file:
        file.setnchannels(1 if samples.ndim == 1 else samples.shape[1])
        file.setsampwidth(2)
        file.setframerate(sample_rate)
        file.writeframes(samples.tobytes())


def encode_mp3(audio: NDArray[np.floating], sample_rate: int = SAMPLE_RATE) -> bytes:
    """`audio`, (n,) or (n, 2) within -1..1, as an MP3 file: what every browser plays."""
    layout = "mono" if audio.ndim == 1 else "stereo"
    planes = np.ascontiguousarray(np.atleast_2d(audio.T), dtype=np.float32)
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp3") as container:
        stream = container.add_stream("libmp3lame", rate=sample_rate, layout=layout)
        stream.bit_rate = 96_000
        frame = av.AudioFrame.from_ndarray(planes, format="fltp", layout=layout)
        frame.sample_rate = sample_rate
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return buffer.getvalue()


def _releases(score: Score) -> list[float]:
    """When the damper falls on each note [s]: key and pedal are up, or the key is struck again."""
    end = score.total_time
    times = np.array([event.time for event in score.pedal])
    down = np.array([event.value >= 64 for event in score.pedal], bool)
    lifts = np.append(times[~down], np.inf)
    strikes: dict[int, list[float]] = defaultdict(list)
    for note in score.notes:
        strikes[note.pitch].append(note.start)
    releases = []
    for note in score.notes:
        release = note.end
        event = np.searchsorted(times, note.end, side="right") - 1
        if event >= 0 and down[event]:
            lift = lifts[np.searchsorted(lifts, note.end, side="right")]
            release = min(lift, max(end, note.end) + 2.0)  # a pedal never lifted lets go at last
        again = np.searchsorted(strikes[note.pitch], note.start, side="right")
        if again < len(strikes[note.pitch]):
            release = min(release, strikes[note.pitch][again])
        releases.append(max(release, note.start + 0.03))
    return releases


def _tone(pitch: int, hardness: float, seconds: float, rate: int) -> NDArray[np.float32]:
    """One undamped note of loudness 1, (n,); `hardness` 0..1 is how hard the hammer strikes."""
    fundamental = 440.0 * 2 ** ((pitch - 69) / 12)
    stiffness = 3.5e-4 * 2 ** (max(pitch - 45, 0) / 9 - 15 / 9)
    order = np.arange(1, 61)
    frequency = fundamental * order * np.sqrt((1 + stiffness * order**2) / (1 + stiffness))
    brightness = 200 + 2800 * hardness**1.5 + 0.6 * fundamental  # [Hz]
    level = np.abs(np.sin(np.pi * order / 8.3)) / order  # struck at about an eighth of the string
    level *= np.exp(-(frequency - fundamental) / brightness)
    audible = (frequency < 0.45 * rate) & (level > 1e-4 * level.max())
    frequency, level = frequency[audible], level[audible] / np.linalg.norm(level[audible])
    slow = 6.9 * 2 ** ((pitch - 21) / 24) / 14 + 4e-7 * frequency**2  # [1/s]

    # The soundboard's knock: modes that die at once, irregular so that they have no pitch.
    modes = np.arange(24)
    knock = 70 * 1.19**modes * (1 + 0.1 * np.sin(7.0 * modes))
    knock_level = 0.10 * (0.4 + hardness) * np.exp(-knock / (600 + 1500 * hardness))
    length = int(seconds * rate) + 1
    tone = _ring(
        np.concatenate([frequency, frequency * 1.0004, knock]),
        np.concatenate([2 * slow, 0.7 * slow, 45 + 0.05 * knock]),
        np.concatenate([0.65 * level, 0.35 * level, knock_level]),
        length,
        rate,
    )
    rise = min(length, int((0.0015 + 0.003 * (1 - hardness)) * rate))
    tone[:rise] *= 0.5 - 0.5 * np.cos(np.pi * np.arange(rise, dtype=np.float32) / rise)
    return tone


def _ring(
    frequency: NDArray[np.floating],
    decay: NDArray[np.floating],
    level: NDArray[np.floating],
    length: int,
    rate: int,
) -> NDArray[np.float32]:
    """`sum_k level_k exp(-decay_k t) sin(2 pi frequency_k t)` for `length` samples.

    Sample i * block + j of a damped sinusoid is the product of a factor of i and a factor of j, so
    the sum over k is one matrix product, and only 2 sqrt(length) exponentials are computed.
    """
    step = (-decay + 2j * np.pi * frequency) / rate
    block = int(np.sqrt(length)) + 1
    starts = np.arange(0, length, block)
    coarse = np.exp(np.multiply.outer(starts, step)) * level
    fine = np.exp(np.multiply.outer(step, np.arange(block)))
    # The imaginary part of coarse @ fine, in single precision.
    left = np.hstack([np.real(coarse), np.imag(coarse)]).astype(np.float32)
    right = np.vstack([np.imag(fine), np.real(fine)]).astype(np.float32)
    return (left @ right).ravel()[:length]


def _damping(pitch: int) -> float:
    """Time from the damper's fall to silence [s]."""
    return 1.2 if pitch > _LAST_DAMPER else 8 * _DAMPING


def _damped(tone: NDArray[np.float32], held: float, pitch: int, rate: int) -> NDArray[np.float32]:
    """The tone with the damper falling `held` [s] after its start, (n,)."""
    sound = tone[: int((held + _damping(pitch)) * rate)].copy()
    after = sound[int(held * rate) :]
    fade = np.linspace(1, 0, len(after), dtype=np.float32)  # ends at exactly 0: no click
    if pitch <= _LAST_DAMPER:
        fade *= np.exp(-np.arange(len(after), dtype=np.float32) / (_DAMPING * rate))
    after *= fade
    return sound


def _pan(key: int) -> NDArray[np.float32]:
    """Gains (2,) of the left and right ear, of equal power: bass a little left."""
    angle = np.pi / 4 * (1 + 0.45 * (2 * key / (NUM_KEYS - 1) - 1))
    return np.sqrt(2) * np.array([np.cos(angle), np.sin(angle)], np.float32)


def _in_room(mix: NDArray[np.float32], rate: int) -> NDArray[np.float32]:
    """Adds a little room: decaying noise, always the same, as impulse response."""
    time = np.arange(int(_TAIL * rate)) / rate
    noise = np.random.default_rng(88).standard_normal((len(time), 2))
    band = signal.butter(1, [200, 3500], "bandpass", fs=rate, output="sos")
    response = np.asarray(signal.sosfilt(band, noise * np.exp(-8 * time)[:, None], axis=0))
    response[: int(0.012 * rate)] = 0  # the first wall is some metres away
    response *= _ROOM * 4 / np.linalg.norm(response, axis=0)
    fade = np.linspace(1, 0, len(time))[:, None]
    wet = signal.oaconvolve(mix, np.float32(response * fade), axes=0)[: len(mix)]
    return mix + np.float32(wet)


def _limited(audio: NDArray[np.float32], rate: int) -> NDArray[np.float32]:
    """Turns down around peaks so that none exceeds the ceiling, without bending the waveform."""
    window = int(0.01 * rate) | 1
    peak = ndimage.maximum_filter1d(np.abs(audio).max(axis=1), window)
    gain = np.minimum(1, _CEILING / np.maximum(peak, 1e-9))
    return audio * ndimage.uniform_filter1d(gain, window).astype(np.float32)[:, None]
