import io
import itertools
import tracemalloc

import av
import numpy as np
import pyloudnorm
import pytest
from scipy import signal

from cadenza.music.score import Note, PedalEvent, Score
from cadenza.report import sound
from cadenza.report.sound import SAMPLE_RATE, bit_rate_of, encode_opus, synthesize


def samples_of(score):
    """(n, 2) within -1..1."""
    return synthesize(score)[:] / 32768


def amplitude(audio, start, end):
    """Root mean square between two times [s]."""
    return float(np.sqrt(np.mean(audio[int(start * SAMPLE_RATE) : int(end * SAMPLE_RATE)] ** 2)))


def spectrum(audio):
    samples = audio[:, 0].astype(float)
    size = 1 << 19
    return np.fft.rfftfreq(size, 1 / SAMPLE_RATE), np.abs(
        np.fft.rfft(samples * np.hanning(len(samples)), size)
    )


@pytest.mark.parametrize("pitch", [33, 45, 57, 69, 81, 93, 105])
def test_a_key_sounds_at_its_pitch(pitch):
    frequency, strength = spectrum(samples_of(Score((Note(0, 3, pitch),))))
    expected = 440 * 2 ** ((pitch - 69) / 12)
    near = (frequency > expected * 0.95) & (frequency < expected * 1.05)
    peak = frequency[near][np.argmax(strength[near])]
    assert abs(1200 * np.log2(peak / expected)) < 3  # cents
    assert strength[near].max() > 0.25 * strength.max()


def test_harder_is_louder_and_brighter():
    velocities = (30, 64, 90, 120)
    audio = samples_of(
        Score(tuple(Note(2 * i, 2 * i + 1, 60, v) for i, v in enumerate(velocities)))
    )
    notes = [audio[2 * i * SAMPLE_RATE : (2 * i + 1) * SAMPLE_RATE] for i in range(4)]
    loud = [amplitude(note, 0, 1) for note in notes]
    assert all(b > 1.3 * a for a, b in itertools.pairwise(loud))
    spectra = [spectrum(note) for note in notes]
    centroids = [np.sum(f * s**2) / np.sum(s**2) for f, s in spectra]
    assert all(b > 1.03 * a for a, b in itertools.pairwise(centroids))


def decay(audio, start, end):
    """Of the level between two times [dB/s]."""
    level = [20 * np.log10(amplitude(audio, t, t + 0.1)) for t in (start, end)]
    return (level[0] - level[1]) / (end - start)


# At first and later [dB/s], about a string's loss in Bensa et al. (2003), 2 at C2 and 10 at C4, and
# the piano tone of Weinreich (1990), E flat 4: 8, then less than a quarter of it.
@pytest.mark.parametrize(
    ("pitch", "first", "later"),
    [(33, (1, 6), (0.3, 3)), (69, (7, 18), (2, 6)), (93, (25, 80), (10, 25))],
)
def test_notes_decay_as_those_of_a_piano_quickly_and_then_slowly(pitch, first, later):
    audio = samples_of(Score((Note(0, 4, pitch, 100),)))
    assert first[0] < decay(audio, 0.05, 0.4) < first[1]
    assert later[0] < decay(audio, 1.5, 2.5) < later[1]


def test_a_long_note_is_still_heard_after_a_second():
    audio = samples_of(Score((Note(0, 3, 69),)))
    assert amplitude(audio, 1.0, 1.1) > 0.16 * amplitude(audio, 0.02, 0.12)  # 16 dB


def test_the_pedal_holds_notes_until_it_is_lifted():
    note, later = Note(0, 0.5, 55), Note(3, 3.1, 90)
    dry = samples_of(Score((note, later)))
    held = samples_of(Score((note, later), (PedalEvent(0.2, 127), PedalEvent(2, 0))))
    assert amplitude(dry, 1.5, 1.9) < 0.02 * amplitude(dry, 0, 0.4)
    assert amplitude(held, 1.5, 1.9) > 0.2 * amplitude(held, 0, 0.4)
    assert amplitude(held, 2.8, 2.99) < 0.1 * amplitude(held, 1.5, 1.9)


def test_a_pedal_that_is_never_lifted_does_not_ring_for_ever():
    audio = synthesize(Score((Note(0, 0.5, 40),), (PedalEvent(0, 127),)))[:]
    assert len(audio) < 5 * SAMPLE_RATE


def many(velocity):
    rng = np.random.default_rng(0)
    return Score(
        tuple(
            Note(t / 10, t / 10 + 0.5, int(pitch), velocity)
            for t in range(60)
            for pitch in rng.choice(np.arange(30, 90), 8, replace=False)
        )
    )


PIECES = {
    "sparse and soft": Score(tuple(Note(4 * i, 4 * i + 0.3, 60 + i, 30) for i in range(4))),
    "dense and loud": many(127),
    "dense and soft": many(20),
    "first soft and then loud": Score(
        tuple(Note(i / 2, i / 2 + 0.5, 60, 25 if i < 10 else 120) for i in range(20))
    ),
    "shorter than a block of the meter": Score((Note(0, 0.05, 60, 40),)),
    "one low note": Score((Note(0, 2, 21),)),
}


@pytest.mark.parametrize("piece", PIECES)
def test_all_recordings_are_equally_loud_and_none_clips(piece):
    audio = samples_of(PIECES[piece])
    assert pyloudnorm.Meter(SAMPLE_RATE).integrated_loudness(audio) == pytest.approx(-18, abs=0.3)
    between = signal.resample_poly(audio, 4, 1, axis=0)  # as BS.1770 finds the true peak
    assert np.abs(between).max() < 10 ** (-1 / 20)


def test_no_sound_depends_on_the_blocks_that_it_is_made_in(monkeypatch):
    score = Score(
        (Note(0, 0.2, 30), Note(0.9, 7.5, 60, 127), Note(1.95, 2.5, 64, 127), Note(2, 2.3, 67, 50)),
        (PedalEvent(0, 127), PedalEvent(6, 0)),
    )
    monkeypatch.setattr(sound, "CEILING", 0.2)  # so that there is something to turn down
    samples = synthesize(score)[:].astype(int)
    assert np.abs(samples).max() > 0.15 * 32768
    for seconds in (1, 3):
        monkeypatch.setattr(sound, "BLOCK", seconds)
        assert np.abs(synthesize(score)[:] - samples).max() <= 1


def test_memory_does_not_grow_with_the_sound(monkeypatch):
    monkeypatch.setattr(sound, "IN_MEMORY", 1 << 20)
    monkeypatch.setattr(sound, "SAMPLE_RATE", 8000)  # which takes less time

    def peak(minutes):
        score = Score(tuple(Note(t, t + 2, 60) for t in range(0, 60 * minutes, 10)))
        tracemalloc.start()
        encode_opus(synthesize(score), bit_rate=8000)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    samples = 60 * 8000 * 4  # bytes a minute
    assert peak(3) - peak(1) < 2 * 0.2 * samples


def test_a_long_sound_is_what_it_is_in_memory(monkeypatch):
    score = Score((Note(0, 0.2, 30), Note(0.9, 7.5, 60, 127), Note(11.95, 12.5, 64, 127)))
    in_memory = synthesize(score)
    monkeypatch.setattr(sound, "IN_MEMORY", 1000)
    in_a_file = synthesize(score)
    assert len(in_a_file) > 12 * SAMPLE_RATE
    np.testing.assert_array_equal(in_a_file[:], in_memory[:])
    np.testing.assert_array_equal(in_a_file[-50:], in_memory[:][-50:])
    assert encode_opus(in_a_file) == encode_opus(in_memory)


def test_a_note_ends_without_a_click():
    audio = samples_of(Score((Note(0, 1.0, 48, 100),)))[:, 0]
    step = np.abs(np.diff(audio, 2))  # a click is a step in the waveform
    assert (
        step[int(0.95 * SAMPLE_RATE) :].max()
        < 1.2 * step[int(0.5 * SAMPLE_RATE) : int(0.95 * SAMPLE_RATE)].max()
    )
    assert abs(audio[0]) < 1e-3
    assert abs(audio[-1]) < 1e-3


def test_bass_comes_more_from_the_left():
    low, high = (samples_of(Score((Note(0, 1, pitch),))) for pitch in (24, 100))
    assert np.sum(low[:, 0] ** 2) > 1.5 * np.sum(low[:, 1] ** 2)
    assert np.sum(high[:, 1] ** 2) > 1.5 * np.sum(high[:, 0] ** 2)


def test_the_same_score_always_sounds_the_same():
    score = Score((Note(0, 0.3, 60), Note(0.1, 0.5, 64, 50)))
    assert np.array_equal(synthesize(score)[:], synthesize(score)[:])


def test_no_notes_no_sound():
    silence = synthesize(Score((), (PedalEvent(0, 127),)))
    assert len(silence) == 0
    assert silence[:].shape == (0, 2)


def decoded(webm):
    """The samples of a file, (n, channels), at `SAMPLE_RATE`."""
    with av.open(io.BytesIO(webm)) as file:
        resampler = av.AudioResampler(rate=SAMPLE_RATE)
        frames = [part for frame in file.decode(audio=0) for part in resampler.resample(frame)]
        frames += resampler.resample(None)
    return np.concatenate([frame.to_ndarray() for frame in frames], axis=1).T


def test_opus_keeps_the_sound_and_its_time():
    audio = synthesize(Score((Note(0.25, 1, 60), Note(0.5, 1, 67))))[:]
    read = decoded(encode_opus(audio))
    assert len(read) == len(audio)
    assert np.corrcoef(read[:, 0], audio[:, 0])[0, 1] > 0.99


def test_opus_of_one_channel_and_of_a_longer_time():
    audio = synthesize(Score((Note(0.25, 1, 60), Note(0.5, 1, 67))))[:]
    webm = encode_opus(audio, bit_rate=48_000, mono=True, seconds=5)
    read = decoded(webm)
    assert read.shape == (5 * SAMPLE_RATE, 1)
    assert len(webm) < 5 * 48_000 / 8
    middle = audio.mean(axis=1)
    assert np.corrcoef(read[: len(audio), 0], middle)[0, 1] > 0.99
    assert np.abs(read[len(audio) + SAMPLE_RATE :]).max() < 1e-3


def test_the_longer_a_sound_the_lower_its_bit_rate():
    assert bit_rate_of(0) == bit_rate_of(30) == 96_000
    assert bit_rate_of(120) == 45_000
    assert bit_rate_of(180) == bit_rate_of(3600) == 30_000
    assert bit_rate_of(180, mono=True) < bit_rate_of(180)
