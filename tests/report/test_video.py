import errno
import io
import os

import av
import numpy as np
import pytest

from cadenza.errors import explained
from cadenza.files import TEMPORARY
from cadenza.music.score import Note, Score
from cadenza.report.sound import synthesize
from cadenza.report.video import write_animation, write_video


def test_pictures_and_sound_are_read_back(tmp_path):
    audio = synthesize(Score((Note(0, 1, 60),)))
    path = tmp_path / "a.mp4"
    pictures = (np.full((121, 163, 3), 5 * i, np.uint8) for i in range(40))
    write_video(path, pictures, 20, audio, (163, 121))
    with av.open(str(path)) as file:
        video, sound = file.streams.video[0], file.streams.audio[0]
        assert (video.codec.name, sound.codec.name) == ("h264", "aac")
        assert (video.width, video.height, video.average_rate) == (162, 120, 20)
        assert float(video.duration * video.time_base) == pytest.approx(2, abs=0.01)
        pictures = [frame.to_ndarray(format="rgb24").mean() for frame in file.decode(video)]
        file.seek(0)
        heard = np.concatenate([frame.to_ndarray() for frame in file.decode(sound)], axis=1)
    assert pictures == pytest.approx(5 * np.arange(40), abs=6)
    assert np.abs(heard[:, :44100]).max() > 0.5 * np.abs(audio[:]).max() / 32768


def test_sound_does_not_go_on_long_after_the_pictures(tmp_path):
    pictures = np.zeros((20, 64, 64, 3), np.uint8)
    write_video(tmp_path / "a.mp4", pictures, 20, np.zeros((441000, 2), np.int16), (64, 64))
    with av.open(str(tmp_path / "a.mp4")) as file:
        assert file.duration / 1e6 == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("room", [0, 1000, 20_000])
def test_a_full_disk_is_said_to_be_full(room, tmp_path, monkeypatch) -> None:
    """In the writing of pictures as well as at the end of the file."""

    class Full(io.FileIO):
        def write(self, data):
            if self.tell() + len(data) > room:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(data)

    monkeypatch.setattr(
        "cadenza.files.open",
        lambda path, mode, opener: Full(path, mode, opener=opener),
        raising=False,
    )
    rng = np.random.default_rng(0)
    noise = (rng.integers(0, 255, (64, 64, 3), np.uint8) for _ in range(40))
    with pytest.raises(OSError, match=r"a\.mp4") as raised:
        write_video(tmp_path / "a.mp4", noise, 20, np.zeros((44100, 2), np.int16), (64, 64))
    assert "the disk is full" in explained(raised.value)
    assert not any(name.startswith(TEMPORARY) for name in os.listdir(tmp_path))


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_a_moving_picture_has_all_pictures_in_their_colours(tmp_path, kind) -> None:
    colours = np.array([[220, 30, 30], [30, 220, 30], [30, 30, 220]] * 10, np.uint8)
    path = tmp_path / f"a.{kind}"
    frames = (np.tile(colour, (90, 160, 1)) for colour in colours)
    write_animation(path, frames, 20, (80, 44))
    if kind == "webp":  # FFmpeg does not read animations of it
        content = path.read_bytes()
        assert (content[8:12], content.count(b"ANIM"), content.count(b"ANMF")) == (b"WEBP", 1, 30)
        return
    with av.open(str(path)) as file:
        assert file.duration / 1e6 == pytest.approx(1.5)
        pictures = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert pictures[0].shape == (44, 80, 3)
    assert np.array([p.mean(axis=(0, 1)) for p in pictures]) == pytest.approx(colours, abs=8)
