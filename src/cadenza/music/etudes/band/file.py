"""Songs for bands as MIDI files with a track for each part."""

from __future__ import annotations

import tempfile
from collections.abc import Collection
from functools import partial
from pathlib import Path

from cadenza.files import write_atomically
from cadenza.music.etudes.band.parts import (
    TICKS_PER_BEAT,
    Band,
    microseconds_per_beat,
    ticks,
)
from cadenza.music.score import Score


def write_band(band: Band, path: str | Path) -> None:
    """Writes a song as a MIDI file of format 1: a track for title, tempo and metre, then the parts.

    Read back by `cadenza.music.formats.midi.read_midi`, notes and bars have the same times to the
    bit. Notes of equal pitch that parts play at once are merged there, as on one piano.
    """
    import mido  # here, so that the names of etudes can be had without it

    from cadenza.music.formats.midi import messages

    file = mido.MidiFile(type=1, ticks_per_beat=TICKS_PER_BEAT, charset="utf-8")
    heading = file.add_track(band.title)
    heading.append(mido.MetaMessage("set_tempo", tempo=microseconds_per_beat(band.tempo)))
    heading.append(mido.MetaMessage("time_signature", numerator=band.beats, denominator=4))
    on_tick = partial(ticks, tempo=band.tempo)
    for part in band.parts:
        track, channel = file.add_track(part.name or None), part.channel - 1
        track.append(mido.Message("program_change", program=part.program, channel=channel))
        track += messages(part.notes, part.pedal, on_tick, channel)
    with write_atomically(Path(path)) as out:
        file.save(file=out)


def band_score(band: Band, tracks: Collection[int] = ()) -> Score:
    """The piano score of all parts but the drums, or of `tracks`, as it is read from the file.

    Raises:
        CadenzaError: there is no such track.
    """
    from cadenza.music.formats.midi import read_midi  # which needs mido, too

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{band.title}.mid")
        write_band(band, path)
        return read_midi(path, tracks)
