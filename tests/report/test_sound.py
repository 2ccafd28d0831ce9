import io
import itertools
import wave

import av
import numpy as np
import pytest

from cadenza.music.score import Note, PedalEvent, Score
from cadenza.report.sound import SAMPLE_RATE, encode_mp3, synthesize, write_wav


def loudness(audio, start, end):
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
    frequency, strength = spectrum(synthesize(Score((Note(0, 3, pitch),))))
    expected = 440 * 2 ** ((pitch - 69) / 12)
    near = (frequency > expected * 0.95) & (frequency < expected * 1.05)
    found = frequency[near][np.argmax(strength[near])]
    assert abs(1200 * np.log2(found / expected)) < 3  # cents
    assert strength[near].max() > 0.25 * strength.max()


def test_harder_is_louder_and_brighter():
    heard = [synthesize(Score((Note(0, 1, 60, velocity),))) for velocity in (30, 64, 90, 120)]
    loud = [loudness(audio, 0, 1) for audio in heard]
    assert all(b > 1.3 * a for a, b in itertools.pairwise(loud))
    spectra = [spectrum(audio) for audio in heard]
    centroids = [np.sum(f * s**2) / np.sum(s**2) for f, s in spectra]
    assert all(b > 1.03 * a for a, b in itertools.pairwise(centroids))


def test_the_pedal_holds_notes_until_it_is_lifted():
    note, later = Note(0, 0.5, 55), Note(3, 3.1, 90)
    dry = synthesize(Score((note, later)))
    held = synthesize(Score((note, later), (PedalEvent(0.2, 127), PedalEvent(2, 0))))
    assert loudness(dry, 1.5, 1.9) < 0.02 * loudness(dry, 0, 0.4)
    assert loudness(held, 1.5, 1.9) > 10 * loudness(dry, 1.5, 1.9)
    assert loudness(held, 2.8, 2.99) < 0.1 * loudness(held, 1.5, 1.9)


def test_a_pedal_that_is_never_lifted_does_not_ring_for_ever():
    audio = synthesize(Score((Note(0, 0.5, 40),), (PedalEvent(0, 127),)))
    assert len(audio) < 5 * SAMPLE_RATE


def test_nothing_clips_however_many_keys_are_hit():
    chord = tuple(Note(t, t + 1, pitch, 127) for t in (0, 0.5, 1) for pitch in range(30, 90, 3))
    audio = synthesize(Score(tuple(sorted(chord, key=lambda n: (n.start, n.pitch)))))
    assert 0.5 < np.abs(audio).max() < 0.9
    assert np.isfinite(audio).all()


def test_a_note_ends_without_a_click():
    audio = synthesize(Score((Note(0, 1.0, 48, 100),)))[:, 0]
    step = np.abs(np.diff(audio, 2))  # a click is a step in the waveform
    assert (
        step[int(0.95 * SAMPLE_RATE) :].max()
        < 1.2 * step[int(0.5 * SAMPLE_RATE) : int(0.95 * SAMPLE_RATE)].max()
    )
    assert abs(audio[0]) < 1e-3
    assert abs(audio[-1]) < 1e-3


def test_bass_comes_more_from_the_left():
    low, high = (synthesize(Score((Note(0, 1, pitch),))) for pitch in (24, 100))
    assert np.sum(low[:, 0] ** 2) > 1.5 * np.sum(low[:, 1] ** 2)
    assert np.sum(high[:, 1] ** 2) > 1.5 * np.sum(high[:, 0] ** 2)


def test_the_same_score_always_sounds_the_same():
    score = Score((Note(0, 0.3, 60), Note(0.1, 0.5, 64, 50)))
    assert np.array_equal(synthesize(score), synthesize(score))


def test_no_notes_no_sound():
    assert synthesize(Score((), (PedalEvent(0, 127),))).shape == (0, 2)


def test_wav_is_read_back(tmp_path):
    audio = synthesize(Score((Note(0, 0.3, 60),)))
    write_wav(tmp_path / "a.wav", audio)
    with wave.open(str(tmp_path / "a.wav")) as file:
        assert (file.getframerate(), file.getnchannels()) == (SAMPLE_RATE, 2)
        read = np.frombuffer(file.readframes(file.getnframes()), "<i2").reshape(-1, 2) / 32767
    assert np.abs(read - audio).max() < 1e-4


def test_mp3_keeps_the_sound_and_its_time():
    audio = synthesize(Score((Note(0.25, 1, 60), Note(0.5, 1, 67))))
    with av.open(io.BytesIO(encode_mp3(audio))) as file:
        read = np.concatenate([frame.to_ndarray() for frame in file.decode(audio=0)], axis=1).T
    assert len(read) == len(audio)
    assert np.corrcoef(read[:, 0], audio[:, 0])[0, 1] > 0.99
