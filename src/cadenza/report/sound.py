"""Synthesis of a score, note by note; see `cadenza.report.tone`.

Sound is made, levelled and encoded block by block, and lies in a file in between, so that the
memory it takes does not grow with its length.
"""

import io
import tempfile
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import IO

import av
import av.filter
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from threadpoolctl import threadpool_limits

from cadenza.errors import CadenzaError, extra_packages
from cadenza.files import write_atomically
from cadenza.music.score import PEDAL_DOWN, PITCHES, Note, Score
from cadenza.report.tone import DAMPING, LAST_DAMPER, LOUDER, Tone, tone

SAMPLE_RATE = 44100  # [Hz]

# [LUFS] integrated loudness of every recording: that of ReplayGain 2.0, at which a piano's peaks,
# some 12 to 18 dB higher, hardly meet the ceiling.
_LOUDNESS = -18.0
# No sample is larger: 2 dBFS below full scale, so that the wave between samples, also of the
# compressed sound, stays 1 dB below it.
CEILING = 10 ** (-2 / 20)
_MAX_AMPLITUDE = 0.2  # amplitude of the loudest note, before levelling
BLOCK = 10  # [s] of sound that is made at a time
_MAX_NOTE = 30.0  # [s] that a note sounds, however long it is held
_VELOCITY_BAND = 8  # velocities that share one timbre
_MAX_TONES = 64e6  # bytes of tones that are kept for later notes
_OPUS_RATE, _OPUS_FRAME = 48_000, 60  # [Hz], [ms]
_STEREO_RATES, _MONO_RATES = (30_000, 96_000), (20_000, 48_000)  # bit/s, minimum and maximum
_LONG = 180.0  # [s] from which on a sound has the minimum bit rate
_TAIL = 0.7  # [s] of room after the last note
_ROOM = 0.05  # level of the room against the piano
IN_MEMORY = 32 << 20  # bytes of sound that need no file: three minutes


CODECS = {".wav": "pcm_s16le", ".flac": "flac", ".mp3": "libmp3lame"}
"""The encoder of each kind of file, by the ending of its name."""
_MP3_RATE = 192_000  # bit/s


class Sound:
    """Samples (n, 2) left and right, 16 bit, to be read with `sound[first:last]`.

    They lie in a file without a name; those of a short sound in memory.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._file: IO[bytes] = tempfile.SpooledTemporaryFile(IN_MEMORY)  # noqa: SIM115

    def __del__(self) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, part: slice) -> NDArray[np.int16]:
        first, last, _ = part.indices(len(self))
        self._file.seek(4 * first)
        return np.frombuffer(self._file.read(4 * max(last - first, 0)), np.int16).reshape(-1, 2)

    def write(self, first: int, samples: NDArray[np.int16]) -> None:
        """Write `samples` from the sample `first` on."""
        self._file.seek(4 * first)
        self._file.write(samples.tobytes())


Samples = NDArray[np.int16] | Sound  # samples (n, 2) left and right, 16 bit


def synthesize(score: Score, voice: Tone = tone) -> Sound:
    """The sound of `score` by a `voice`, such as `font_tone`; no notes have no samples.

    Louder notes are also brighter; while the pedal is down, notes ring on after their end. The
    whole has an integrated loudness of -18 LUFS (ITU-R BS.1770) and peaks below -1 dBFS, so that
    all recordings are equally loud. It takes about 150 MB, however many notes there are.
    """
    if not score.notes:
        return Sound(0)
    notes = list(zip(score.notes, _releases(score), strict=True))
    latest = max(release + _damping(note.pitch) for note, release in notes)
    # Half precision: an error 76 dB below the sound, whatever its level.
    sound = Sound(int((latest + _TAIL) * SAMPLE_RATE) + 1)
    meter = _LoudnessMeter()
    first = 0
    with threadpool_limits(1):  # small matrices
        for block in _in_room(_blocks(notes, len(sound), voice)):
            sound.write(first, block.T.astype(np.float16).view(np.int16))
            meter.add(block)
            first += block.shape[1]
    _level(sound, 10 ** ((_LOUDNESS - meter.integrated) / 20))
    return sound


def encode_opus(
    audio: Samples, bit_rate: int | None = None, mono: bool = False, seconds: float = 0.0
) -> bytes:
    """Return `audio` as a WebM file with Opus, which every browser plays.

    Args:
        audio: the samples.
        bit_rate: approximate bits a second; by default as `bit_rate_of`.
        mono: whether both channels are mixed into one.
        seconds: minimum length; silence is added to shorter audio.
    """
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="webm", options={"fflags": "+bitexact"}) as container:
        layout = "mono" if mono else "stereo"
        frames = {"frame_duration": str(_OPUS_FRAME)}
        stream = container.add_stream("libopus", rate=_OPUS_RATE, layout=layout, options=frames)
        stream.bit_rate = bit_rate_of(seconds, mono) if bit_rate is None else bit_rate
        length = max(len(audio), int(np.ceil(seconds * SAMPLE_RATE)))
        write_audio(container, stream, audio, length)
    return buffer.getvalue()


def bit_rate_of(seconds: float, mono: bool = False) -> int:
    """The bit rate of a sound on a page: the longer it lasts, the lower, within limits.

    A minute has 90 kbit/s, three minutes or more 30 kbit/s; one channel 48 and 20 kbit/s.
    """
    lowest, highest = _MONO_RATES if mono else _STEREO_RATES
    return round(min(max(lowest * _LONG / max(seconds, 1.0), lowest), highest))


def write_audio(
    container: av.container.OutputContainer, stream: av.AudioStream, audio: Samples, length: int
) -> None:
    """Encode `length` samples of `audio`, with silence after its end, a second at a time."""
    for first in range(0, length, SAMPLE_RATE):
        samples = np.zeros((min(SAMPLE_RATE, length - first), 2), np.int16)
        part = audio[first : first + len(samples)]
        samples[: len(part)] = part
        frame = av.AudioFrame.from_ndarray(samples.reshape(1, -1), format="s16", layout="stereo")
        frame.sample_rate = SAMPLE_RATE
        frame.pts, frame.time_base = first, Fraction(1, SAMPLE_RATE)
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))


def write_sound(path: Path, audio: Samples, seconds: float = 0.0) -> None:
    """Write samples (n, 2) to a file of one of the kinds in `CODECS`, by its ending.

    WAV and FLAC keep every bit. The file lasts at least `seconds`, with silence at its end. Raises
    OSError if the file cannot be written.
    """
    with (
        write_atomically(path) as file,
        av.open(file, "w", format=path.suffix.lower().removeprefix(".")) as container,
    ):
        stream = container.add_stream(
            CODECS[path.suffix.lower()], rate=SAMPLE_RATE, layout="stereo"
        )
        assert isinstance(stream, av.AudioStream)
        if stream.codec.name == CODECS[".mp3"]:
            stream.bit_rate = _MP3_RATE
        length = max(len(audio), round(seconds * SAMPLE_RATE))
        write_audio(container, stream, audio, length)


class _LoudnessMeter:
    """A meter of integrated loudness by ITU-R BS.1770-4, with FFmpeg's filter ebur128."""

    def __init__(self) -> None:
        self.integrated = -70.0
        """Loudness [LUFS] so far, but for the last tenth of a second; -70 for silence."""
        self._added = 0
        self._graph = av.filter.Graph()
        nodes = (
            self._graph.add_abuffer(
                sample_rate=SAMPLE_RATE,
                format="fltp",
                layout="stereo",
                time_base=Fraction(1, SAMPLE_RATE),
            ),
            self._graph.add("ebur128", "metadata=1"),
            self._graph.add("abuffersink"),
        )
        self._graph.link_nodes(*nodes).configure()

    def add(self, block: NDArray[np.float32]) -> None:
        """Measure the next samples (2, n) of the piece."""
        frame = av.AudioFrame.from_ndarray(block, format="fltp", layout="stereo")
        frame.sample_rate, frame.pts = SAMPLE_RATE, self._added
        self._graph.push(frame)
        self._added += block.shape[1]
        while True:
            try:
                measured = self._graph.pull().metadata
            except av.BlockingIOError:
                return
            self.integrated = float(measured["lavfi.r128.I"])


def _blocks(
    notes: list[tuple[Note, float]], length: int, voice: Tone
) -> Iterator[NDArray[np.float32]]:
    """Yield the sound of notes, sorted by start, with their releases [s], in blocks (2, n)."""
    loudest = max(note.velocity for note, _ in notes)
    size = BLOCK * SAMPLE_RATE
    mix = np.zeros((2, size), np.float32)  # from the block's beginning on
    tones: dict[tuple[int, int, int], NDArray[np.float32]] = {}
    index = 0
    for begin in range(0, length, size):
        while index < len(notes) and round(notes[index][0].start * SAMPLE_RATE) < begin + size:
            note, release = notes[index]
            sound = _damped(_tone_of(note, release, tones, voice), note, release)
            first = round(note.start * SAMPLE_RATE) - begin
            mix = _padded(first + len(sound), mix)
            gain = _MAX_AMPLITUDE * (note.velocity / loudest) ** LOUDER
            for channel, level in zip(mix, gain * _pan(note.pitch), strict=True):
                channel[first : first + len(sound)] += sound * level
            index += 1
        yield np.ascontiguousarray(mix[:, : min(size, length - begin)])
        mix = _padded(size, mix[:, size:])


def _padded(length: int, mix: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return `mix` (2, n) with silence after it where it is shorter."""
    return np.pad(mix, ((0, 0), (0, max(0, length - mix.shape[1]))))


def _tone_of(
    note: Note, release: float, tones: dict[tuple[int, int, int], NDArray[np.float32]], voice: Tone
) -> NDArray[np.float32]:
    """The undamped tone of a note, at least as long as the note sounds; `tones` caches it."""
    band = note.velocity // _VELOCITY_BAND * _VELOCITY_BAND + _VELOCITY_BAND // 2
    # Lengths are powers of two, so that notes of different lengths share a tone.
    doublings = max(0, int(np.ceil(np.log2(release - note.start + _damping(note.pitch)))))
    key = note.pitch, band, doublings
    if key not in tones:
        if sum(tone.nbytes for tone in tones.values()) > _MAX_TONES:
            tones.clear()
        tones[key] = voice(note.pitch, band / 127, 2.0**doublings, SAMPLE_RATE)
    return tones[key]


def _releases(score: Score) -> list[float]:
    """When each damper falls [s]: key and pedal are up, or the key is struck again."""
    end = score.total_time
    times = np.array([event.time for event in score.pedal])
    down = np.array([event.value >= PEDAL_DOWN for event in score.pedal], bool)
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
        index = bisect_right(strikes[note.pitch], note.start)
        if index < len(strikes[note.pitch]):
            release = min(release, strikes[note.pitch][index])
        releases.append(min(max(release, note.start + 0.03), note.start + _MAX_NOTE))
    return releases


def _damping(pitch: int) -> float:
    """The time from the damper's fall to silence [s]."""
    return 1.2 if pitch > LAST_DAMPER else 8 * DAMPING


def _damped(tone: NDArray[np.float32], note: Note, release: float) -> NDArray[np.float32]:
    """The note's tone (n,) with the damper falling at `release` [s]."""
    seconds, damping = release - note.start, _damping(note.pitch)
    sound = tone[: int((seconds + damping) * SAMPLE_RATE)].copy()
    tail = sound[int(seconds * SAMPLE_RATE) :]
    fade = np.linspace(1, 0, len(tail), dtype=np.float32)  # ends at exactly 0: no click
    if note.pitch <= LAST_DAMPER:
        fade *= np.exp(-np.arange(len(tail), dtype=np.float32) / (DAMPING * SAMPLE_RATE))
    tail *= fade
    return sound


def _pan(pitch: int) -> NDArray[np.float32]:
    """Gains (2,) of the left and right ear, of equal power: bass a little left."""
    across = (pitch - PITCHES[0]) / (PITCHES[-1] - PITCHES[0])
    angle = np.pi / 4 * (1 + 0.45 * (2 * across - 1))
    return np.sqrt(2) * np.array([np.cos(angle), np.sin(angle)], np.float32)


def _in_room(blocks: Iterator[NDArray[np.float32]]) -> Iterator[NDArray[np.float32]]:
    """Add a little room: decaying noise, always the same, as impulse response."""
    from scipy import signal  # which takes half a second, and would delay the first action

    time = np.arange(int(_TAIL * SAMPLE_RATE)) / SAMPLE_RATE
    noise = np.random.default_rng(88).standard_normal((len(time), 2)).T
    band = signal.butter(1, [200, 3500], "bandpass", fs=SAMPLE_RATE, output="sos")
    response = np.asarray(signal.sosfilt(band, noise * np.exp(-8 * time)))
    response[:, : int(0.012 * SAMPLE_RATE)] = 0  # the first wall is some metres away
    response *= _ROOM * 4 / np.linalg.norm(response, axis=1, keepdims=True)
    response = (response * np.linspace(1, 0, len(time))).astype(np.float32)
    ringing = np.zeros((2, 0), np.float32)
    for block in blocks:
        # A second at a time, so that no bit depends on the size of the blocks.
        for first in range(0, block.shape[1], SAMPLE_RATE):
            dry = block[:, first : first + SAMPLE_RATE]
            wet = signal.fftconvolve(dry, response, axes=1)
            wet[:, : ringing.shape[1]] += ringing
            ringing = wet[:, dry.shape[1] :]
            dry += wet[:, : dry.shape[1]]
        yield block


def _level(sound: Sound, gain: float) -> None:
    """Replace a mix in half precision by its samples times `gain`.

    Around peaks above the ceiling the gain is lower, so that the waveform is not distorted.
    """
    window = int(0.01 * SAMPLE_RATE) | 1
    size = BLOCK * SAMPLE_RATE
    previous = np.zeros((2, 0), np.float32)  # the end of the block before, without limiting
    for first in range(0, len(sound), size):
        mix = sound[first : first + size + window].view(np.float16)
        current = mix.T.astype(np.float32) * np.float32(gain)
        audio = np.hstack([previous, current])
        peak = ndimage.maximum_filter1d(np.abs(audio).max(axis=0), window)
        down = ndimage.uniform_filter1d(np.minimum(1, CEILING / np.maximum(peak, 1e-9)), window)
        block = (audio * down)[:, previous.shape[1] :][:, :size]
        sound.write(first, np.rint(block * 32767).T.astype(np.int16))
        previous = current[:, :size][:, -window:]


# Sound fonts

_MAX_VELOCITY = 127  # MIDI's
_TEST_PITCH = 60  # on every piano
_QUALITY = 6  # quality of symusic's resampling, 0 to 6


def voice_of(sound_font: Path | None) -> Tone:
    """The voice of a sound font, or the built-in piano without one.

    Raises CadenzaError as `font_tone`.
    """
    return tone if sound_font is None else font_tone(sound_font)


def font_tone(path: Path) -> Tone:
    """The tones of a sound font's piano, its first program, as `synthesize` takes them.

    A font chooses the wave by pitch and velocity; loudness, dampers and pedal, as `synthesize` has
    them, are those of the built-in piano. Raises CadenzaError if the file cannot be
    read as a sound font with a piano, or symusic is not installed.
    """
    with extra_packages("soundfont", "--sound-font"):
        import symusic
    if not path.is_file():
        raise CadenzaError(f"{path}: there is no such file")
    synthesizers = {}

    def font(pitch: int, hardness: float, seconds: float, rate: int) -> NDArray[np.float32]:
        if rate not in synthesizers:
            try:
                synthesizers[rate] = symusic.Synthesizer(path, rate, _QUALITY)
            except RuntimeError as error:
                raise CadenzaError(f"{path}: is no sound font; choose an .sf2 file") from error
        track = symusic.Track("", 0, False, ttype="second")
        velocity = round(hardness * _MAX_VELOCITY)
        track.notes.append(symusic.Note(0.0, seconds, pitch, velocity, ttype="second"))
        score = symusic.Score(ttype="second")
        score.tracks.append(track)
        sound = np.zeros(int(seconds * rate) + 1, np.float32)
        rendered = synthesizers[rate].render(score, stereo=True).mean(axis=0)[: len(sound)]
        sound[: len(rendered)] = rendered
        return sound

    if not font(_TEST_PITCH, 1.0, 0.1, SAMPLE_RATE).any():
        raise CadenzaError(f"{path}: has no sound for program 1, the piano; choose another file")
    return font
