"""The plan of a song: its key, tempo, sections and players; and its parts, note by note."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate
from operator import attrgetter

import numpy as np

from cadenza.music.etudes.band.chords import SongPassage, happens, harmonies
from cadenza.music.etudes.band.melody import Singing
from cadenza.music.etudes.band.parts import (
    DRUM_CHANNEL,
    TICKS_PER_BEAT,
    BandPart,
    Role,
    microseconds_per_beat,
    seconds,
    ticks,
)
from cadenza.music.etudes.band.patterns import MEDIUM
from cadenza.music.etudes.band.styles import (
    SECTIONS,
    VOICE_PROGRAMS,
    VOICE_RANGES,
    Chair,
    Style,
    range_of,
)
from cadenza.music.etudes.keys import Key
from cadenza.music.etudes.sheet import Tone, pick
from cadenza.music.formats.general_midi import INSTRUMENTS
from cadenza.music.score import LOUDEST, OCTAVE, Note, PedalEvent

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
class BandPlayer:
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
        """Add tones of a section that begins at `start` [quarters]."""
        self.tones += [(replace(tone, at=tone.at + start), role) for tone in tones]


@dataclass(eq=False)
class Cast:
    """All players of a song; a second voice and one that doubles the lead are not in each."""

    lead: BandPlayer
    singing: Singing
    solo: BandPlayer
    soloing: Singing
    bass: BandPlayer
    drums: BandPlayer
    chairs: tuple[BandPlayer, ...]
    second: BandPlayer | None
    second_above: bool
    double: BandPlayer | None
    double_by: int
    """Semitones that the lead is doubled above, or below if negative."""

    def in_order(self, rng: np.random.Generator) -> list[BandPlayer]:
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

    def player(names: Sequence[str], program: int, kind: str) -> BandPlayer:
        loud = int(rng.integers(*_FIRST_VELOCITIES[kind], endpoint=True))
        name = pick(rng, names)
        if naming >= _INFORMATIVE:
            general = "Drums" if kind == "drums" else INSTRUMENTS[program].title()
            name = general if naming < _INFORMATIVE + _INSTRUMENTS_ONLY else ""
        return BandPlayer(name, program, loud, pick(rng, _LEGATO) if kind == "melody" else 1.0)

    lead = player(_LEAD_NAMES, pick(rng, style.leads), "melody")
    chosen = [chair for chair in style.chairs if happens(rng, chair.share)]
    chairs: list[BandPlayer] = []
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


def _number_channels(rng: np.random.Generator, players: Sequence[BandPlayer]) -> None:
    channels = [c for c in range(1, _CHANNELS + 1) if c != DRUM_CHANNEL]
    if not happens(rng, _CHANNELS_IN_ORDER):
        channels = [channels[i] for i in rng.permutation(len(channels))]
    for player, channel in zip(dict.fromkeys(players), channels, strict=False):
        player.channel = channel


SHORTEST, LONGEST = 60.0, 180.0  # [s] of a song
_ACCIDENTALS = 4  # at most
_INSTEAD = {"intro": "verse", "outro": "chorus", "solo": "verse", "chorus": "verse"}
"""Sections whose chords are those of another, where the style has none of their own."""
_RAISES = 15  # [%] of songs in which the last chorus is higher
_RAISED = {1: -5, 2: 2}
"""Semitones by which the last chorus may be higher -> how many sharps its key has more."""


@dataclass(frozen=True)
class BandPlan:
    """What holds for a whole song, with quarters a minute as `tempo`."""

    style: Style
    key: Key
    tempo: int
    passages: tuple[SongPassage, ...]

    @cached_property
    def starts(self) -> list[int]:
        """The quarters at which sections begin."""
        return [0, *accumulate(passage.length for passage in self.passages[:-1])]

    @property
    def placed(self) -> Iterator[tuple[SongPassage, int]]:
        """The sections and the quarters at which they begin."""
        return zip(self.passages, self.starts, strict=True)

    def passage(self, at: float) -> SongPassage:
        """The section in which a time [quarters] lies; the first before the song."""
        return self.passages[max(bisect_right(self.starts, at) - 1, 0)]

    def ticks(self, at: float) -> int:
        """The ticks of a time [quarters]; in swing, the first half of each beat is the longer."""
        swing = self.style.swing
        beat, within = divmod(at, 1)
        if within <= 0.5:
            within *= 2 * swing
        else:
            within = swing + (2 * within - 1) * (1 - swing)
        return round((beat + within) * TICKS_PER_BEAT)

    def seconds(self, at: float) -> float:
        """The time [s] of a time in quarters."""
        return seconds(self.ticks(at), self.tempo)


def planned(rng: np.random.Generator, style: Style) -> BandPlan:
    """The plan of a song of a style; sections of the same kind have the same chords."""
    minor = happens(rng, style.minor)
    key = Key(int(rng.integers(-_ACCIDENTALS, _ACCIDENTALS, endpoint=True)), minor)
    tempo = pick(rng, style.tempi)
    kinds = pick(rng, _fitting_forms(style, tempo))
    written = {kind: _numerals(rng, style, minor, kind) for kind in dict.fromkeys(kinds)}
    raised = pick(rng, list(_RAISED)) if "chorus" in kinds and happens(rng, _RAISES) else 0
    last_chorus = len(kinds) - 1 - kinds[::-1].index("chorus") if raised else len(kinds)
    passages = []
    for i, kind in enumerate(kinds):
        by = raised if i >= last_chorus else 0
        here = Key(key.sharps + _RAISED[by], minor) if by else key
        bars = style.bars[kind]
        chords = harmonies(written[kind], here, style.beats, bars)
        final = kind == "ending"
        passages.append(SongPassage(kind, here, style.beats, bars, chords, rng, final, by))
    return BandPlan(style, key, tempo, tuple(passages))


def _fitting_forms(style: Style, tempo: int) -> list[list[str]]:
    """The forms that last neither too short nor too long; the nearest if there is none."""
    forms = [[SECTIONS[letter] for letter in form] for form in style.forms]
    beat = microseconds_per_beat(tempo) / 1e6

    def excess(form: Sequence[str]) -> float:
        length = sum(style.bars[kind] for kind in form) * style.beats * beat
        return max(SHORTEST - length, length - LONGEST, 0.0)

    return [form for form in forms if excess(form) == 0] or [min(forms, key=excess)]


def _numerals(rng: np.random.Generator, style: Style, minor: bool, kind: str) -> str:
    if kind == "ending":
        return "i" if minor else "I"
    known = style.progressions["minor" if minor else "major"]
    while kind not in known:
        kind = _INSTEAD[kind]
    return pick(rng, known[kind])


_ENERGY = {"intro": -8, "verse": -4, "chorus": 6, "bridge": 1, "solo": 2, "outro": -4, "ending": 0}
"""Velocities by which sections are louder than others."""
# In percent of songs.
_HUMAN = 60  # notes are not quite in time
_FLAT = 12  # all notes of a player are equally loud
_JITTER = 0.01  # [s] by which notes are early or late, at most
_SPREAD = 5  # velocities by which notes are louder or softer at random, at most
_RELEASE, _RELEASE_SHARE = 20, 8  # [ticks] by which notes end early; an eighth of short notes
_PEDAL_DOWN = 60  # [ticks] after a change of harmony


@dataclass(slots=True)
class _TickNote:
    """A note in ticks."""

    start: int
    end: int
    pitch: int
    velocity: int
    role: Role


@dataclass(frozen=True)
class Manner:
    """How all players of a song play: with jitter of `late` ticks at most, or `flat`, all alike."""

    late: int
    flat: bool


def random_hand(rng: np.random.Generator, plan: BandPlan) -> Manner:
    """Players who are in time or not quite, and mostly with dynamics."""
    late = ticks(_JITTER, plan.tempo) if happens(rng, _HUMAN) else 0
    return Manner(late, happens(rng, _FLAT))


def played(rng: np.random.Generator, plan: BandPlan, player: BandPlayer, hand: Manner) -> BandPart:
    """The part of a player, in which no two notes of a pitch, or of a melody, overlap."""
    events = [_event(rng, plan, player, tone, role, hand) for tone, role in player.tones]
    events = sorted(_apart(events), key=attrgetter("start", "pitch"))
    notes = (
        Note(seconds(e.start, plan.tempo), seconds(e.end, plan.tempo), e.pitch, e.velocity)
        for e in events
    )
    roles = tuple(event.role for event in events)
    pedal = _pedal(plan) if player.pedal else ()
    return BandPart(player.name, player.program, player.channel, tuple(notes), roles, pedal)


def _event(
    rng: np.random.Generator,
    plan: BandPlan,
    player: BandPlayer,
    tone: Tone,
    role: Role,
    hand: Manner,
) -> _TickNote:
    start, end = plan.ticks(tone.at), plan.ticks(tone.at + player.legato * tone.length)
    length = max(end - start - min(_RELEASE, (end - start) // _RELEASE_SHARE), 1)
    velocity = player.loud
    if not hand.flat:
        velocity += tone.velocity - MEDIUM + _ENERGY[plan.passage(tone.at).kind]
        velocity += int(rng.integers(-_SPREAD, _SPREAD, endpoint=True))
    start = max(start + int(rng.integers(-hand.late, hand.late, endpoint=True)), 0)
    return _TickNote(start, start + length, tone.pitch, min(velocity, LOUDEST), role)


def _apart(events: list[_TickNote]) -> list[_TickNote]:
    """The events with those cut at which the next of their pitch, or of the melody, begins.

    Of equal pitches that begin together one is left, that of the melody first.
    """
    kept: list[_TickNote] = []
    latest: dict[int | str, _TickNote] = {}
    for event in sorted(events, key=lambda e: (e.start, e.role != "melody", e.pitch)):
        lines = (event.pitch, event.role) if event.role == "melody" else (event.pitch,)
        before = [latest[line] for line in lines if line in latest]
        if any(earlier.start == event.start for earlier in before):
            continue
        for earlier in before:
            earlier.end = min(earlier.end, event.start)
        latest |= dict.fromkeys(lines, event)
        kept.append(event)
    return kept


def _pedal(plan: BandPlan) -> tuple[PedalEvent, ...]:
    """A pedal that is lifted where harmonies change, and goes down right after."""
    events = []
    for passage, start in plan.placed:
        for harmony in passage.harmonies:
            at = plan.ticks(start + harmony.at)
            events.append(PedalEvent(seconds(at, plan.tempo), 0))
            events.append(PedalEvent(seconds(at + _PEDAL_DOWN, plan.tempo), LOUDEST))
    end = plan.starts[-1] + plan.passages[-1].length
    return (*events, PedalEvent(plan.seconds(end), 0))
