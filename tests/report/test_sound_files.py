from pathlib import Path

import av
import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.report.sound import SAMPLE_RATE, font_tone, synthesize, write_sound
from sound_font import sine_font

SCORE = Score((Note(0.25, 1, 60), Note(0.5, 1, 67)))


def read(path: Path) -> np.ndarray:
    with av.open(str(path)) as file:
        parts = [frame.to_ndarray() for frame in file.decode(audio=0)]
    sound = np.concatenate(parts, axis=1).astype(float)
    if parts[0].dtype == np.float32:
        return sound.T * 32768
    return sound.reshape(-1, 2)


@pytest.mark.parametrize("kind", ["wav", "flac"])
def test_a_file_without_loss_has_every_sample(tmp_path, kind):
    audio = synthesize(SCORE)
    write_sound(tmp_path / f"a.{kind}", audio)
    assert np.array_equal(read(tmp_path / f"a.{kind}"), audio[:])


def test_an_mp3_sounds_alike(tmp_path):
    audio = synthesize(SCORE)
    write_sound(tmp_path / "A.MP3", audio)
    samples = read(tmp_path / "A.MP3")
    assert len(samples) == len(audio)
    assert np.corrcoef(samples[:, 0], audio[:][:, 0])[0, 1] > 0.99
    assert (tmp_path / "A.MP3").stat().st_size < 0.3 * 4 * len(audio)


class TestSoundFont:
    @pytest.fixture
    def font(self, tmp_path):
        pytest.importorskip("symusic")
        path = tmp_path / "sine.sf2"
        path.write_bytes(sine_font())
        return path

    def test_notes_sound_with_its_waves(self, font):
        high, low = Note(0, 1.0, 69), Note(0, 1.0, 57)
        for note, frequency in (high, 440), (low, 220):
            sound = synthesize(Score((note,)), voice=font_tone(font))[: SAMPLE_RATE // 2][:, 0]
            spectrum = np.abs(np.fft.rfft(sound * np.hanning(len(sound)), SAMPLE_RATE))
            assert spectrum.argmax() == frequency
            # The piano's second partial is a tenth of the first and more; a sine has none.
            assert spectrum[2 * frequency] < 0.02 * spectrum[frequency]

    def test_harder_is_louder_and_a_note_ends_where_its_key_is_released(self, font):
        score = Score((Note(0, 0.5, 69, 40), Note(2, 2.5, 69, 120)))
        sound = synthesize(score, voice=font_tone(font))[:][:, 0].astype(float)
        soft, silence, loud = (
            sound[int(t * SAMPLE_RATE) :][:10_000].std() for t in (0.1, 1.7, 2.1)
        )
        assert loud > 3 * soft > 100 * silence

    @pytest.mark.parametrize("content", [b"", b"RIFF", b"MThd" + bytes(100)])
    def test_what_is_no_sound_font_is_refused(self, font, content):
        font.write_bytes(content)
        with pytest.raises(CadenzaError, match=r"sine.sf2: is no sound font; choose an .sf2 file"):
            font_tone(font)
        with pytest.raises(CadenzaError, match="there is no such file"):
            font_tone(font.with_name("other.sf2"))
