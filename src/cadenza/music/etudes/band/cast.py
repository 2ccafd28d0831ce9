"""The cast of a song: who sings, who plays along, on which programs, and under which names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadenza.music.etudes.band.melody import Singing
from cadenza.music.etudes.band.parts import DRUM_CHANNEL, Role
from cadenza.music.etudes.band.passage import happens
from cadenza.music.etudes.band.styles import VOICE_PROGRAMS, VOICE_RANGES, Chair, Style, range_of
from cadenza.music.etudes.sheet import Tone, pick
from cadenza.music.formats.general_midi import INSTRUMENTS
from cadenza.music.score import OCTAVE

_CHANNELS = 16
_MIN_CHAIRS = 2
_LEAD_NAMES = (
    *("Vocal", "Vocals", "Lead Vocal", "VOCAL", "Voice", "Lead Vox", "Singer"),
    *("Melody", "MELODY", "Melodie", "Main Melody", "Lead", "Lead Line", "LEAD"),
)
_SOLO_NAMES = ("Solo", "Lead 2", "SOLO", "Solo Instrument", "Fills")
_SECOND_NAMES = ("Harmony", "Backing Vox", "BG Vocals", "Vocal 2", "Harmony Vox", "2nd Voice")
_DOUBLE_NAMES = ("Lead Double", "Melody 2", "Octave", "Unison", "Double")
_BASS_NAMES = ("Bass", "BASS", "Bs", "Bass 1", "Bass Line")
_DRUM_NAMES = ("Drums", "DRUMS", "Drum Kit", "Percussion", "Standard Kit")
_DOUBLES = ((48, 50), (73,), (9, 11), (88, 80), (0, 4), (40, 22))
"""Programs of instruments that double a melody."""
_FIRST_VELOCITIES: dict[str, tuple[int, int]] = {
    "melody": (82, 110),
    "second": (62, 92),
    "chords": (54, 90),
    "bass": (72, 104),
    "drums": (78, 104),
}
"""The softest and the loudest that each kind of player is, before sections and accents."""
_LEGATO = (1.0, 1.0, 0.95, 0.9, 0.8)
"""Shares of the time of a note for which singers and soloists hold it."""
# In percent of songs.
_INFORMATIVE, _INSTRUMENTS_ONLY = 66, 17  # names of tracks; in the rest there are none
_LEAD_FIRST = 40  # the tracks begin with the lead, then bass, drums and chords
_CHANNELS_IN_ORDER = 60
_SECOND_VOICE, _DOUBLE = 45, 40
_SECOND_ABOVE = 45
_PEDAL = 75
_SOLO_BY_CHAIR = 30  # an accompanying instrument takes the solo


@dataclass(eq=False)
class Player:
    """A player of the song: the part that becomes of it, and what it has been given to play.

    `loud` is the velocity before sections and accents, `legato` the share of the time of a note for
    which it sounds; `tones` are in quarters from the beginning.
    """

    name: str
    program: int
    loud: int
    legato: float
    tones: list[tuple[Tone, Role]] = field(default_factory=list)
    pedal: bool = False
    channel: int = DRUM_CHANNEL
    chair: Chair | None = None

    def play(self, tones: Sequence[Tone], start: float, role: Role) -> None:
        """Adds tones of a section that begins at `start` [quarters]."""
        self.tones += [(replace(tone, at=tone.at + start), role) for tone in tones]


@dataclass(eq=False)
class Cast:
    """All players of a song; a second voice and one that doubles the lead are not in each."""

    lead: Player
    singing: Singing
    solo: Player
    soloing: Singing
    bass: Player
    drums: Player
    chairs: tuple[Player, ...]
    second: Player | None
    second_above: bool
    double: Player | None
    double_by: int
    """Semitones that the lead is doubled above, or below if negative."""

    def in_order(self, rng: np.random.Generator) -> list[Player]:
        """The players who have something to play, in the order of the tracks of the file."""
        players = [self.lead, self.bass, self.drums, *self.chairs, self.solo]
        players += [player for player in (self.second, self.double) if player]
        players = [player for player in dict.fromkeys(players) if player.tones]
        if not happens(rng, _LEAD_FIRST):
            players = [players[i] for i in rng.permutation(len(players))]
        return players


def random_cast(rng: np.random.Generator, style: Style) -> Cast:
    """Players for a song of a style, with their names."""
    naming = int(rng.integers(100))

    def player(names: Sequence[str], program: int, kind: str) -> Player:
        loud = int(rng.integers(*_FIRST_VELOCITIES[kind], endpoint=True))
        name = pick(rng, names)
        if naming >= _INFORMATIVE:
            general = "Drums" if kind == "drums" else INSTRUMENTS[program].title()
            name = general if naming < _INFORMATIVE + _INSTRUMENTS_ONLY else ""
        return Player(name, program, loud, pick(rng, _LEGATO) if kind == "melody" else 1.0)

    lead = player(_LEAD_NAMES, pick(rng, style.leads), "melody")
    chosen = [chair for chair in style.chairs if happens(rng, chair.share)]
    chairs: list[Player] = []
    for chair in chosen if len(chosen) >= _MIN_CHAIRS else style.chairs[:_MIN_CHAIRS]:
        chairs.append(player(chair.names, pick(rng, chair.programs), "chords"))
        chairs[-1].chair, chairs[-1].pedal = chair, chair.pedal and happens(rng, _PEDAL)
    other = [program for program in style.solos if program != lead.program]
    solo = player(_SOLO_NAMES, pick(rng, other), "melody")
    if happens(rng, _SOLO_BY_CHAIR):
        solo = chairs[0]
    second = player(_SECOND_NAMES, pick(rng, (lead.program, 52, 53)), "second")
    double = player(_DOUBLE_NAMES, pick(rng, pick(rng, _DOUBLES)), "second")
    bass = player(_BASS_NAMES, pick(rng, style.basses), "bass")
    drum_kit = player(_DRUM_NAMES, 0, "drums")
    colour = pick(rng, style.colours)
    made = Cast(
        lead=lead,
        singing=_singing(rng, lead.program, pick(rng, style.cells), colour),
        solo=solo,
        soloing=_singing(rng, solo.program, "waltz solo" if style.beats == 3 else "solo", colour),
        bass=bass,
        drums=drum_kit,
        chairs=tuple(chairs),
        second=second if happens(rng, _SECOND_VOICE) else None,
        second_above=happens(rng, _SECOND_ABOVE),
        double=double if happens(rng, _DOUBLE) else None,
        double_by=pick(rng, (0, OCTAVE, OCTAVE, -OCTAVE)),
    )
    _number_channels(rng, [lead, bass, *chairs, solo, second, double])
    return made


def _singing(rng: np.random.Generator, program: int, cells: str, colour: str) -> Singing:
    sung = program in VOICE_PROGRAMS
    low, high = pick(rng, VOICE_RANGES) if sung else range_of(program)
    return Singing(low, high, cells, colour)


def _number_channels(rng: np.random.Generator, players: Sequence[Player]) -> None:
    channels = [c for c in range(1, _CHANNELS + 1) if c != DRUM_CHANNEL]
    if not happens(rng, _CHANNELS_IN_ORDER):
        channels = [channels[i] for i in rng.permutation(len(channels))]
    for player, channel in zip(dict.fromkeys(players), channels, strict=False):
        player.channel = channel
