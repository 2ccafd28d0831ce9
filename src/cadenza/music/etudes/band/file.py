"""Songs for bands as MIDI files with a track for each part."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterator
from pathlib import Path

import mido

from cadenza.files import write_atomically
from cadenza.music.etudes.band.parts import (
    TICKS_PER_BEAT,
    Band,
    Part,
    microseconds_per_beat,
    ticks,
)
from cadenza.music.formats.midi import read_midi
from cadenza.music.score import Score

_SUSTAIN = 64  # controller number of the sustain pedal


def write_band(band: Band, path: str | Path) -> None:
    """Writes a song as a MIDI file of format 1: a track for title, tempo and metre, then the parts.

    Read back by `cadenza.music.formats.midi.read_midi`, notes and bars have the same times to the
    bit. Notes of equal pitch that parts play at once are merged there, as on one piano.
    """
    file = mido.MidiFile(type=1, ticks_per_beat=TICKS_PER_BEAT, charset="utf-8")
    file.tracks.append(
        mido.MidiTrack(
            [
                mido.MetaMessage("track_name", name=band.title),
                mido.MetaMessage("set_tempo", tempo=microseconds_per_beat(band.tempo)),
                mido.MetaMessage("time_signature", numerator=band.beats, denominator=4),
            ]
        )
    )
    file.tracks += [_track(part, band.tempo) for part in band.parts]
    with write_atomically(Path(path)) as out:
        file.save(file=out)


def band_score(band: Band, tracks: Collection[int] = ()) -> Score:
    """The piano score of all parts but the drums, or of `tracks`, as it is read from the file.

    Raises:
        CadenzaError: there is no such track.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{band.title}.mid")
        write_band(band, path)
        return read_midi(path, tracks)


def _track(part: Part, tempo: int) -> mido.MidiTrack:
    track = mido.MidiTrack([mido.MetaMessage("track_name", name=part.name)] if part.name else [])
    channel = part.channel - 1
    track.append(mido.Message("program_change", channel=channel, program=part.program))
    now = 0
    for tick, _, message in sorted(_timed(part, channel, tempo), key=lambda item: item[:2]):
        track.append(message.copy(time=tick - now))
        now = tick
    return track


def _timed(part: Part, channel: int, tempo: int) -> Iterator[tuple[int, int, mido.Message]]:
    """Yields messages with their ticks; at one tick, notes end, the pedal moves, notes begin."""
    for note in part.notes:
        on = mido.Message("note_on", channel=channel, note=note.pitch, velocity=note.velocity)
        yield ticks(note.start, tempo), 2, on
        off = mido.Message("note_off", channel=channel, note=note.pitch)
        yield ticks(note.end, tempo), 0, off
    for event in part.pedal:
        move = mido.Message("control_change", channel=channel, control=_SUSTAIN, value=event.value)
        yield ticks(event.time, tempo), 1, move
