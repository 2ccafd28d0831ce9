"""The tones of a sound font (SF2 or SF3) in place of the built-in piano's."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, extra_packages
from cadenza.report.sound import SAMPLE_RATE
from cadenza.report.tone import Tone, tone

_HARDEST = 127  # MIDI velocity
_TRIED = 60  # the pitch that every piano has
_QUALITY = 6  # of the resampling of symusic, 0 to 6


def voice_of(sound_font: Path | None) -> Tone:
    """The voice of a sound font, or the built-in piano if there is none.

    Raises:
        CadenzaError: as `font_tone` raises it.
    """
    return tone if sound_font is None else font_tone(sound_font)


def font_tone(path: Path) -> Tone:
    """Return the tones of a sound font's piano, its first program, as `synthesize` takes them.

    A font chooses the wave by pitch and velocity; `synthesize` does all else, so that loudness,
    dampers and pedal are those of the built-in piano. Raises CadenzaError if the file cannot be
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
        velocity = round(hardness * _HARDEST)
        track.notes.append(symusic.Note(0.0, seconds, pitch, velocity, ttype="second"))
        score = symusic.Score(ttype="second")
        score.tracks.append(track)
        sound = np.zeros(int(seconds * rate) + 1, np.float32)
        rendered = synthesizers[rate].render(score, stereo=True).mean(axis=0)[: len(sound)]
        sound[: len(rendered)] = rendered
        return sound

    if not font(_TRIED, 1.0, 0.1, SAMPLE_RATE).any():
        raise CadenzaError(f"{path}: has no sound for program 1, the piano; choose another file")
    return font
