"""A song for a band from a seed: who has the melody, who sings along, who accompanies."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cadenza.configs import MAX_SEED, whole_number
from cadenza.music.etudes.band.chords import SongPassage, happens
from cadenza.music.etudes.band.melody import Singing, answers, melody, second_voice
from cadenza.music.etudes.band.parts import Band, BandSection
from cadenza.music.etudes.band.plan import (
    BandPlan,
    BandPlayer,
    Cast,
    planned,
    played,
    random_cast,
    random_hand,
)
from cadenza.music.etudes.band.styles import styles
from cadenza.music.etudes.band.voicings import nearest
from cadenza.music.etudes.sheet import Tone, pick
from cadenza.music.score import MIDI_PITCHES, OCTAVE

_HIGH_POINTS = ("chorus", "bridge")  # sections in which others sing or play along
# In percent of songs.
_BRIDGE_BY_SOLO = 30  # the solo instrument has the melody of the bridge
_SECOND_VERSE_BY_SOLO = 15
_INTRO_BY_SOLO, _OUTRO_BY_SOLO, _OUTRO_BY_LEAD, _LAST_NOTE = 45, 35, 60, 50
_ANSWERS = 40  # the solo instrument answers the lead in its rests
_DOUBLES_ALL = 35  # who doubles the lead does so in all sections
_PICKUPS = 60  # phrases begin before their first bars
_SPLIT = 12  # [%] of long notes that are two when the melody comes again with other words
_LONG = 1  # quarters of a note that can be two
_UNUSED_SHARE = 4  # verses leave out the highest quarter of a range, choruses the lowest


def give_melodies(rng: np.random.Generator, plan: BandPlan, cast: Cast) -> list[BandPlayer | None]:
    """Give lead, soloist, second voice and double what they play; who leads each section."""
    who = _who_leads(rng, plan, cast)
    pickups, replies = happens(rng, _PICKUPS), happens(rng, _ANSWERS)
    along = {passage.kind for passage in plan.passages} if happens(rng, _DOUBLES_ALL) else set()
    known: dict[str, tuple[SongPassage, list[Tone]]] = {}
    last: dict[BandPlayer, int] = {}
    for (passage, start), player in zip(plan.placed, who, strict=True):
        if player is None:
            continue
        sung = player is cast.lead
        if sung and passage.kind in known:
            earlier, tones = known[passage.kind]
            tones = _with_other_words(rng, tones, passage.raised - earlier.raised)
        else:
            singing = cast.singing if sung else cast.soloing
            tones = _melody(passage, singing, pickups, last.get(player))
            if sung:
                known[passage.kind] = passage, tones
        last[player] = tones[-1].pitch
        tones = [tone for tone in tones if tone.at + start >= 0]
        player.play(tones, start, "melody")
        if sung and not passage.final:
            _play_along(passage, start, cast, tones, passage.kind in {*along, *_HIGH_POINTS})
            if replies and cast.solo.chair is None:
                cast.solo.play(list(answers(passage, tones, cast.soloing)), start, "harmony")
    return who


def _who_leads(rng: np.random.Generator, plan: BandPlan, cast: Cast) -> list[BandPlayer | None]:
    lead, solo = cast.lead, cast.solo
    who: dict[str, BandPlayer | None] = {
        "intro": solo if happens(rng, _INTRO_BY_SOLO) else None,
        "bridge": solo if happens(rng, _BRIDGE_BY_SOLO) else lead,
        "solo": solo,
        "outro": lead if happens(rng, _OUTRO_BY_LEAD) else None,
        "ending": lead if happens(rng, _LAST_NOTE) else None,
    }
    if happens(rng, _OUTRO_BY_SOLO):
        who["outro"] = solo
    players = [who.get(passage.kind, lead) for passage in plan.passages]
    verses = [i for i, passage in enumerate(plan.passages) if passage.kind == "verse"]
    if len(verses) > 1 and happens(rng, _SECOND_VERSE_BY_SOLO):
        players[verses[1]] = solo
    return players


def _melody(
    passage: SongPassage, singing: Singing, pickups: bool, before: int | None
) -> list[Tone]:
    low, high = singing.low, singing.high
    if passage.final:
        tonic = nearest([passage.key.pitch(0) % OCTAVE], (low + high) // 2)
        return [Tone(0, passage.length, tonic)]
    unused = (high - low) // _UNUSED_SHARE
    if passage.kind == "verse":
        high -= unused
    elif passage.kind == "chorus":
        low += unused
    return melody(passage, replace(singing, low=low, high=high), pickups, before)


def _with_other_words(rng: np.random.Generator, tones: Sequence[Tone], raised: int) -> list[Tone]:
    """The melody, higher by `raised`, with some long notes divided in two for other words."""
    found = []
    for tone in [replace(tone, pitch=tone.pitch + raised) for tone in tones]:
        if tone.length >= _LONG and happens(rng, _SPLIT):
            half = tone.length / 2
            found += [replace(tone, length=half), replace(tone, at=tone.at + half, length=half)]
        else:
            found.append(tone)
    return found


def _play_along(
    passage: SongPassage, start: int, cast: Cast, tones: Sequence[Tone], doubled: bool
) -> None:
    """Give the double the melody, and the second voice thirds to it."""
    if cast.double and doubled:
        moved = [replace(tone, pitch=tone.pitch + cast.double_by) for tone in tones]
        cast.double.play(moved, start, "doubling")
    if cast.second and passage.kind in _HIGH_POINTS:
        lowest = cast.singing.low - OCTAVE // 2
        voice = second_voice(passage, tones, cast.second_above, lowest)
        cast.second.play(voice, start, "harmony")


# In percent of songs.
_DRUMS = 90
_LATE_RHYTHM = 25  # bass and drums come in after the intro


def make_band(seed: int) -> Band:
    """A song of one to three minutes for a band: melody, chords, bass, drums and more.

    The same seed gives the same song.

    Raises:
        CadenzaError: `seed` is no such number.
    """
    seed = whole_number(seed, "seed", 0, MAX_SEED)
    rng = np.random.default_rng([zlib.crc32(b"band"), seed])
    style = pick(rng, list(styles()))
    plan = planned(rng, styles()[style])
    cast = random_cast(rng, plan.style)
    who = give_melodies(rng, plan, cast)
    _accompany(rng, plan, cast)
    players = cast.in_order(rng)
    hand = random_hand(rng, plan)
    parts = tuple(played(rng, plan, player, hand) for player in players)
    title = f"{style.capitalize()} in {plan.key.name}"
    sections = _sections(plan, players, who)
    return Band(title, style, plan.tempo, plan.style.beats, parts, sections)


def _accompany(rng: np.random.Generator, plan: BandPlan, cast: Cast) -> None:
    """Give chords, bass and drums to those who play them."""
    bass = pick(rng, plan.style.bass)
    has_drums, late = happens(rng, _DRUMS), happens(rng, _LATE_RHYTHM)
    for passage, start in plan.placed:
        if not (late and passage.kind == "intro"):
            cast.bass.play(list(bass(passage)), start, "bass")
            if has_drums:
                cast.drums.play(list(plan.style.drums(passage)), start, "drums")
    for player in cast.chairs:
        assert player.chair
        pattern = pick(rng, player.chair.plays)
        for passage, start in plan.placed:
            if not player.chair.sections or passage.kind in player.chair.sections:
                tones = _below_solo(player, list(pattern(passage)), start, start + passage.length)
                player.play(tones, start, "harmony")


def _below_solo(player: BandPlayer, tones: list[Tone], start: float, end: float) -> list[Tone]:
    """The tones of a section that lie below the melody that the same player has there, if any."""
    melody = [tone for tone, role in player.tones if role == "melody" and start <= tone.at < end]
    lowest = min((tone.pitch for tone in melody), default=MIDI_PITCHES[-1])
    return [tone for tone in tones if tone.pitch < lowest]


def _sections(
    plan: BandPlan, players: list[BandPlayer], who: list[BandPlayer | None]
) -> tuple[BandSection, ...]:
    return tuple(
        BandSection(
            passage.kind,
            plan.seconds(start),
            plan.seconds(start + passage.length),
            players.index(player) if player else None,
        )
        for (passage, start), player in zip(plan.placed, who, strict=True)
    )
