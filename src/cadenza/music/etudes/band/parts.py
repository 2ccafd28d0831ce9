"""A song for a band: its parts, its sections, the role of every note, and its MIDI file."""

from __future__ import annotations

import io
from collections.abc import Collection
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, get_args

from cadenza.errors import errors_in
from cadenza.files import write_atomically
from cadenza.music.score import Note, PedalEvent, Score

Role = Literal["melody", "bass", "harmony", "doubling", "drums"]
"""What a note is in the song; `doubling` are notes that play along with the melody in unison or in
octaves, `harmony` is all that accompanies: chords, second voices, fills between phrases."""
ROLES: tuple[Role, ...] = get_args(Role)
DRUM_CHANNEL = 10
"""The MIDI channel of drums, counted from 1."""
TICKS_PER_BEAT = 480
"""Ticks of the MIDI file in a quarter; all notes begin and end on one."""


@dataclass(frozen=True)
class BandPart:
    """What one instrument plays: notes by (start, pitch), and the role of each.

    `program` is that of General MIDI, counted from 0, `channel` that of MIDI, counted from 1.
    """

    name: str
    program: int
    channel: int
    notes: tuple[Note, ...]
    roles: tuple[Role, ...]
    pedal: tuple[PedalEvent, ...] = ()


@dataclass(frozen=True)
class BandSection:
    """A section such as a verse, from `start` to `end` [s].

    `melody` is the index of the part that has the melody, None if none has.
    """

    name: str
    start: float
    end: float
    melody: int | None


@dataclass(frozen=True)
class Band:
    """A song for a band, with `tempo` quarters a minute, and `beats` quarters in each bar."""

    title: str
    style: str
    tempo: int
    beats: int
    parts: tuple[BandPart, ...]
    sections: tuple[BandSection, ...]

    def notes(self, role: Role) -> tuple[Note, ...]:
        """The notes of all parts that have this role, by (start, pitch)."""
        found = (
            note
            for part in self.parts
            for note, its_role in zip(part.notes, part.roles, strict=True)
            if its_role == role
        )
        return tuple(sorted(found, key=lambda note: (note.start, note.pitch)))


def microseconds_per_beat(tempo: int) -> int:
    """The length of a quarter [us], a whole number as in a MIDI file."""
    return round(60_000_000 / tempo)


def seconds(ticks: int, tempo: int) -> float:
    """The time [s] of a number of ticks, to the bit as it is read from the MIDI file."""
    return ticks * microseconds_per_beat(tempo) / (TICKS_PER_BEAT * 1_000_000)


def ticks(seconds: float, tempo: int) -> int:
    """The number of ticks that is nearest to a time [s]."""
    return round(seconds * TICKS_PER_BEAT * 1_000_000 / microseconds_per_beat(tempo))


def write_band(band: Band, path: str | Path) -> None:
    """Write a song as a MIDI file of format 1: a track for title, tempo and metre, then the parts.

    Read back by `cadenza.music.formats.midi.read_midi`, notes and bars have the same times to the
    bit. Notes of equal pitch that parts play at once are merged there, as on one piano.
    """
    with write_atomically(Path(path)) as out:
        out.write(_midi_of(band))


def _midi_of(band: Band) -> bytes:
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
    content = io.BytesIO()
    file.save(file=content)
    return content.getvalue()


def band_score(band: Band, tracks: Collection[int] = ()) -> Score:
    """The piano score of all parts but the drums, or of `tracks`, as it is read from the file.

    Raises:
        CadenzaError: there is no such track.
    """
    from cadenza.music.formats.midi import score_of  # which needs mido, too
    from cadenza.music.formats.midi_messages import parsed

    with errors_in(band.title):
        return score_of(parsed(_midi_of(band)), tracks, band.title)
