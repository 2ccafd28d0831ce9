"""A song for a band from a seed."""

from __future__ import annotations

import zlib

import numpy as np

from cadenza.configs import MOST_SEED, whole_number
from cadenza.music.etudes.band.cast import Cast, Player, random_cast
from cadenza.music.etudes.band.leading import give_melodies
from cadenza.music.etudes.band.parts import Band, Section
from cadenza.music.etudes.band.passage import happens, pick
from cadenza.music.etudes.band.plan import Plan, planned
from cadenza.music.etudes.band.playing import played, random_hand
from cadenza.music.etudes.band.styles import styles
from cadenza.music.etudes.sheet import Tone
from cadenza.music.score import MIDI_PITCHES

# In percent of songs.
_DRUMS = 90
_LATE_RHYTHM = 25  # bass and drums come in after the intro


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


def _accompany(rng: np.random.Generator, plan: Plan, cast: Cast) -> None:
    """Gives chords, bass and drums to those who play them."""
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


def _below_solo(player: Player, tones: list[Tone], start: float, end: float) -> list[Tone]:
    """The tones of a section that lie below the melody that the same player has there, if any."""
    melody = [tone for tone, role in player.tones if role == "melody" and start <= tone.at < end]
    lowest = min((tone.pitch for tone in melody), default=MIDI_PITCHES[-1])
    return [tone for tone in tones if tone.pitch < lowest]


def _sections(plan: Plan, players: list[Player], who: list[Player | None]) -> tuple[Section, ...]:
    return tuple(
        Section(
            passage.kind,
            plan.seconds(start),
            plan.seconds(start + passage.length),
            players.index(player) if player else None,
        )
        for (passage, start), player in zip(plan.placed, who, strict=True)
    )
