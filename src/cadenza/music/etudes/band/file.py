"""Songs for bands as MIDI files with a track for each part."""

from __future__ import annotations

import tempfile
from collections.abc import Collection
from operator import itemgetter
from pathlib import Path

from cadenza.files import write_atomically
from cadenza.music.etudes.band.parts import (
    TICKS_PER_BEAT,
    Band,
    Part,
    microseconds_per_beat,
    ticks,
)
from cadenza.music.score import Score

_SUSTAIN = 64  # controller number of the sustain pedal


def write_band(band: Band, path: str | Path) -> None:
    """Writes a song as a MIDI file of format 1: a track for title, tempo and metre, then the parts.

    Read back by `cadenza.music.formats.midi.read_midi`, notes and bars have the same times to the
    bit. Notes of equal pitch that parts play at once are merged there, as on one piano.
    """
    import mido  # here, so that the names of etudes can be had without it

    file = mido.MidiFile(type=1, ticks_per_beat=TICKS_PER_BEAT, charset="utf-8")
    heading = file.add_track(band.title)
    heading.append(mido.MetaMessage("set_tempo", tempo=microseconds_per_beat(band.tempo)))
    heading.append(mido.MetaMessage("time_signature", numerator=band.beats, denominator=4))
    for part in band.parts:
        track = file.add_track(part.name or None)
        now = 0
        for tick, kind, values in _messages(part, band.tempo):
            track.append(mido.Message(kind, channel=part.channel - 1, time=tick - now, **values))
            now = tick
    with write_atomically(Path(path)) as out:
        file.save(file=out)


def _messages(part: Part, tempo: int) -> list[tuple[int, str, dict[str, int]]]:
    """Ticks, kinds and values of the messages of a part.

    At one tick, notes end, then the pedal moves, then notes begin.
    """
    ends, moves, begins = [], [], []
    for note in part.notes:
        on = {"note": note.pitch, "velocity": note.velocity}
        begins.append((ticks(note.start, tempo), "note_on", on))
        ends.append((ticks(note.end, tempo), "note_off", {"note": note.pitch}))
    for event in part.pedal:
        value = {"control": _SUSTAIN, "value": event.value}
        moves.append((ticks(event.time, tempo), "control_change", value))
    timed = sorted([*ends, *moves, *begins], key=itemgetter(0))  # which keeps their order at a tick
    return [(0, "program_change", {"program": part.program}), *timed]


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
