"""A song for a band from a seed."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cadenza.configs import MOST_SEED, whole_number
from cadenza.music.etudes.band.cast import Cast, Player, cast
from cadenza.music.etudes.band.chords import harmonies
from cadenza.music.etudes.band.melody import Singing, answers, melody, second_voice
from cadenza.music.etudes.band.parts import (
    TICKS_PER_BEAT,
    Band,
    Part,
    Role,
    Section,
    microseconds_per_beat,
    seconds,
    ticks,
)
from cadenza.music.etudes.band.passage import Passage, happens, pick
from cadenza.music.etudes.band.rhythm_section import MEDIUM
from cadenza.music.etudes.band.styles import RANGES, SECTIONS, STYLES, Style
from cadenza.music.etudes.band.voicings import nearest
from cadenza.music.etudes.keys import OCTAVE, Key
from cadenza.music.etudes.sheet import Tone
from cadenza.music.score import MIDI_PITCHES, Note, PedalEvent

SHORTEST, LONGEST = 60.0, 180.0  # [s] of a song
_ACCIDENTALS = 4  # at most
_ENERGY = {"intro": -8, "verse": -4, "chorus": 6, "bridge": 1, "solo": 2, "outro": -4, "ending": 0}
"""Velocities by which sections are louder than others."""
_INSTEAD = {"intro": "verse", "outro": "chorus", "solo": "verse", "chorus": "verse"}
"""Sections whose chords are those of another, where the style has none of their own."""
_RAISED = {1: -5, 2: 2}
"""Semitones by which the last chorus may be higher -> how many sharps its key has more."""
# In percent of songs.
_RAISES = 15  # the last chorus is higher
_HUMAN = 60  # notes are not quite in time
_FLAT = 12  # all notes of a player are equally loud
_BRIDGE_BY_SOLO = 30  # the solo instrument has the melody of the bridge
_SECOND_VERSE_BY_SOLO = 15
_INTRO_BY_SOLO, _OUTRO_BY_SOLO, _OUTRO_BY_LEAD = 45, 35, 40
_ANSWERS = 40  # the solo instrument answers the lead in its rests
_SOLO_BY_CHAIR = 30  # an accompanying instrument takes the solo
_DRUMS = 90
_LATE_RHYTHM = 25  # bass and drums come in after the intro
_DOUBLES_ALL = 35  # who doubles the lead does so in all sections, not only in choruses
_PICKUPS = 60
# In percent of notes.
_SPLIT = 12  # of long notes, when the melody comes again with other words
_JITTER = 0.01  # [s] by which notes are early or late, at most
_SPREAD = 5  # velocities by which notes are louder or softer at random, at most
_RELEASE, _RELEASE_SHARE = 20, 8  # [ticks] by which notes end early; at most one in so many
_PEDAL_DOWN = 60  # [ticks] after a change of harmony


@dataclass(frozen=True)
class _Plan:
    """What holds for the whole song."""

    style: Style
    key: Key
    tempo: int
    passages: tuple[Passage, ...]
    rng: np.random.Generator

    @property
    def starts(self) -> list[int]:
        """The quarters at which sections begin."""
        lengths = [passage.length for passage in self.passages]
        return [sum(lengths[:i]) for i in range(len(lengths))]


def make_band(seed: int) -> Band:
    """A song of one to three minutes for a band: melody, chords, bass, drums and more.

    Args:
        seed: the seed of style, key, tempo, form, chords, melody and instruments; the same seed
            gives the same song.

    Raises:
        CadenzaError: `seed` is no such number.
    """
    seed = whole_number(seed, "seed", 0, MOST_SEED)
    rng = np.random.default_rng([zlib.crc32(b"band"), seed])
    name = pick(rng, list(STYLES))
    plan = _plan(rng, STYLES[name])
    players = cast(rng, plan.style)
    melodies = _lead(plan, players)
    _accompany(plan, players)
    order = players.in_order(rng)
    jitter = happens(rng, _HUMAN)
    flat = happens(rng, _FLAT)
    parts = tuple(_part(plan, player, jitter, flat) for player in order)
    sections = tuple(
        Section(
            passage.kind,
            seconds(start * TICKS_PER_BEAT, plan.tempo),
            seconds((start + passage.length) * TICKS_PER_BEAT, plan.tempo),
            order.index(player) if player else None,
        )
        for passage, start, player in zip(plan.passages, plan.starts, melodies, strict=True)
    )
    title = f"{name.capitalize()} in {plan.key.name}"
    return Band(title, name, plan.tempo, plan.style.beats, parts, sections)


def _plan(rng: np.random.Generator, style: Style) -> _Plan:
    minor = happens(rng, style.minor)
    key = Key(int(rng.integers(-_ACCIDENTALS, _ACCIDENTALS, endpoint=True)), minor)
    tempo = pick(rng, style.tempi)
    kinds = pick(rng, _fitting_forms(style, tempo))
    written = {kind: _numerals(rng, style, minor, kind) for kind in dict.fromkeys(kinds)}
    raised = pick(rng, list(_RAISED)) if happens(rng, _RAISES) and "chorus" in kinds else 0
    higher = len(kinds) - 1 - kinds[::-1].index("chorus") if raised else len(kinds)
    passages = []
    for i, kind in enumerate(kinds):
        by = raised if i >= higher else 0
        here = Key(key.sharps + _RAISED[raised], minor) if by else key
        bars = style.bars[kind]
        chords = harmonies(written[kind], here, style.beats, bars)
        final = kind == "ending"
        passages.append(Passage(kind, here, style.beats, bars, chords, rng, final, by))
    return _Plan(style, key, tempo, tuple(passages), rng)


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
    known = style.progressions[minor]
    while kind not in known:
        kind = _INSTEAD[kind]
    return pick(rng, known[kind])


# The melody and those who follow it


def _lead(plan: _Plan, players: Cast) -> list[Player | None]:
    """Gives all their melodies; returns who has that of each section."""
    rng = plan.rng
    who = _who_leads(plan, players)
    pickups = happens(rng, _PICKUPS)
    replies = happens(rng, _ANSWERS)
    doubled = {passage.kind for passage in plan.passages} if happens(rng, _DOUBLES_ALL) else set()
    doubled |= {"chorus", "bridge"}
    known: dict[tuple[str, bool], tuple[Passage, list[Tone]]] = {}
    last: dict[bool, int] = {}
    for passage, start, player in zip(plan.passages, plan.starts, who, strict=True):
        if player is None:
            continue
        sung = player is players.lead
        singing = players.singing if sung else players.soloing
        place = passage.kind, sung
        if place in known and sung:
            earlier, tones = known[place]
            tones = _with_other_words(rng, tones, passage.raised - earlier.raised)
        else:
            tones = _section_melody(passage, singing, pickups, last.get(sung))
            known[place] = passage, tones
        last[sung] = tones[-1].pitch
        tones = [tone for tone in tones if tone.at + start >= 0]
        player.play(tones, start, "melody")
        if not sung or passage.final:
            continue
        if players.double and passage.kind in doubled:
            by = players.double_by
            players.double.play(
                [replace(tone, pitch=tone.pitch + by) for tone in tones], start, "doubling"
            )
        if players.second and passage.kind in ("chorus", "bridge"):
            voice = second_voice(passage, tones, players.second_above, singing.low - OCTAVE // 2)
            players.second.play(voice, start, "harmony")
        if replies and players.solo.chair is None:
            players.solo.play(list(answers(passage, tones, players.soloing)), start, "harmony")
    return who


def _who_leads(plan: _Plan, players: Cast) -> list[Player | None]:
    rng = plan.rng
    lead, solo = players.lead, players.solo
    if players.chairs and happens(rng, _SOLO_BY_CHAIR):
        solo = players.solo = players.chairs[0]
        low, high = RANGES.get(solo.program, (players.soloing.low, players.soloing.high))
        players.soloing = replace(players.soloing, low=low, high=high)
    by_solo = {"solo": solo}
    if happens(rng, _BRIDGE_BY_SOLO):
        by_solo["bridge"] = solo
    around = {
        "intro": solo if happens(rng, _INTRO_BY_SOLO) else None,
        "outro": pick(rng, [solo] * _OUTRO_BY_SOLO + [lead] * _OUTRO_BY_LEAD + [None] * 25),
        "ending": pick(rng, (lead, None)),
    }
    who: list[Player | None] = []
    second_verse = happens(rng, _SECOND_VERSE_BY_SOLO)
    for passage in plan.passages:
        kinds = [earlier.kind for earlier in plan.passages[: len(who)]]
        if second_verse and passage.kind == "verse" and kinds.count("verse") == 1:
            who.append(solo)
        elif passage.kind in around:
            who.append(around[passage.kind])
        else:
            who.append(by_solo.get(passage.kind, lead))
    return who


def _section_melody(
    passage: Passage, singing: Singing, pickups: bool, before: int | None
) -> list[Tone]:
    if passage.final:
        middle = (singing.low + singing.high) // 2
        return [Tone(0, passage.length, nearest([passage.key.pitch(0) % OCTAVE], middle))]
    # Choruses lie high, verses low.
    third = (singing.high - singing.low) // 4
    low, high = singing.low, singing.high
    if passage.kind == "verse":
        high -= third
    elif passage.kind == "chorus":
        low += third
    return melody(passage, replace(singing, low=low, high=high), pickups, before)


def _with_other_words(rng: np.random.Generator, tones: Sequence[Tone], raised: int) -> list[Tone]:
    """The melody, higher by `raised`, with some long notes divided in two for other words."""
    found = []
    for tone in [replace(tone, pitch=tone.pitch + raised) for tone in tones]:
        if tone.length >= 1 and happens(rng, _SPLIT):
            half = tone.length / 2
            found += [replace(tone, length=half), replace(tone, at=tone.at + half, length=half)]
        else:
            found.append(tone)
    return found


# The accompaniment


def _accompany(plan: _Plan, players: Cast) -> None:
    rng, style = plan.rng, plan.style
    bass = pick(rng, style.bass)
    has_drums = happens(rng, _DRUMS)
    late = happens(rng, _LATE_RHYTHM)
    how = [pick(rng, player.chair.plays) for player in players.chairs if player.chair]
    for passage, start in zip(plan.passages, plan.starts, strict=True):
        rests = late and passage.kind == "intro"
        if not rests:
            players.bass.play(list(bass(passage)), start, "bass")
        if has_drums and not rests:
            players.drums.play(list(style.drums(passage)), start, "drums")
        for player, plays in zip(players.chairs, how, strict=True):
            assert player.chair
            if player.chair.sections and passage.kind not in player.chair.sections:
                continue
            tones = _below_solo(player, list(plays(passage)), start, start + passage.length)
            player.play(tones, start, "harmony")


def _below_solo(player: Player, tones: list[Tone], start: float, end: float) -> list[Tone]:
    """The tones of a section that lie below the melody that the same player has there, if any."""
    melody = [tone for tone, role in player.tones if role == "melody" and start <= tone.at < end]
    lowest = min((tone.pitch for tone in melody), default=MIDI_PITCHES[-1])
    return [tone for tone in tones if tone.pitch < lowest]


# From tones to notes


def _part(plan: _Plan, player: Player, jitter: bool, flat: bool) -> Part:
    """The part of a player, in which no two notes of a pitch, or of a melody, overlap."""
    found = [_event(plan, player, tone, role, jitter, flat) for tone, role in player.tones]
    latest: dict[object, int] = {}
    kept: list[list] = []
    for event in sorted(found, key=lambda event: (event[0], event[4] != "melody", event[2])):
        start, _, pitch, _, role = event
        keys = [pitch, "melody"] if role == "melody" else [pitch]
        before = [latest[key] for key in keys if key in latest]
        if any(kept[i][0] >= start for i in before):
            continue
        for i in before:
            kept[i][1] = min(kept[i][1], start)
        latest |= dict.fromkeys(keys, len(kept))
        kept.append(list(event))
    notes = [
        Note(seconds(start, plan.tempo), seconds(end, plan.tempo), pitch, velocity)
        for start, end, pitch, velocity, _ in kept
    ]
    order = sorted(range(len(notes)), key=lambda i: (notes[i].start, notes[i].pitch))
    return Part(
        player.name,
        player.program,
        player.channel,
        tuple(notes[i] for i in order),
        tuple(kept[i][4] for i in order),
        _pedal(plan) if player.pedal else (),
    )


def _event(
    plan: _Plan, player: Player, tone: Tone, role: Role, jitter: bool, flat: bool
) -> tuple[int, int, int, int, Role]:
    """Start and end [ticks], pitch, velocity and role of a note."""
    rng = plan.rng
    until = tone.at + player.legato * tone.length
    start, end = (_ticks(plan.style, at) for at in (tone.at, until))
    end -= min(_RELEASE, (end - start) // _RELEASE_SHARE)
    velocity = player.loud
    if not flat:
        section = max(i for i, at in enumerate(plan.starts) if at <= max(tone.at, 0))
        velocity += tone.velocity - MEDIUM + _ENERGY[plan.passages[section].kind]
        velocity += int(rng.integers(-_SPREAD, _SPREAD, endpoint=True))
    if jitter:
        most = ticks(_JITTER, plan.tempo)
        late = int(rng.integers(-most, most, endpoint=True))
        length = end - start
        start = max(start + late, 0)
        end = start + length
    return start, max(end, start + 1), tone.pitch, min(max(velocity, 1), 127), role


def _ticks(style: Style, at: float) -> int:
    """The ticks of a time in quarters; in swing, the first half of each beat is the longer."""
    beat, within = divmod(at, 1)
    if within <= 0.5:
        within *= 2 * style.swing
    else:
        within = style.swing + (2 * within - 1) * (1 - style.swing)
    return round((beat + within) * TICKS_PER_BEAT)


def _pedal(plan: _Plan) -> tuple[PedalEvent, ...]:
    """A pedal that is lifted where harmonies change, and goes down right after."""
    events = []
    for passage, start in zip(plan.passages, plan.starts, strict=True):
        for harmony in passage.harmonies:
            at = _ticks(plan.style, start + harmony.at)
            events.append(PedalEvent(seconds(at, plan.tempo), 0))
            events.append(PedalEvent(seconds(at + _PEDAL_DOWN, plan.tempo), 127))
    end = plan.starts[-1] + plan.passages[-1].length
    events.append(PedalEvent(seconds(_ticks(plan.style, end), plan.tempo), 0))
    return tuple(events)
