"""Files of sound to keep and share: WAV, FLAC and MP3."""

from __future__ import annotations

from pathlib import Path

import av

from cadenza.files import write_atomically
from cadenza.report.sound import SAMPLE_RATE, Samples, write_audio

CODECS = {".wav": "pcm_s16le", ".flac": "flac", ".mp3": "libmp3lame"}
"""The encoder of each kind of file, by the ending of its name."""
_MP3_RATE = 192_000  # bit/s


def write_sound(path: Path, audio: Samples, seconds: float = 0.0) -> None:
    """Writes samples (n, 2) to a file of the kind that its name says, one of `CODECS`.

    WAV and FLAC keep every bit. The file lasts at least `seconds`, with silence at its end.

    Raises:
        OSError: the file cannot be written.
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
