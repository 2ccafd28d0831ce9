"""Gives the notes of players their times and velocities: swing, dynamics, jitter, pedal."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from cadenza.music.etudes.band.cast import Player
from cadenza.music.etudes.band.parts import Part, Role, seconds, ticks
from cadenza.music.etudes.band.passage import happens
from cadenza.music.etudes.band.plan import Plan
from cadenza.music.etudes.band.rhythm_section import MEDIUM
from cadenza.music.etudes.sheet import Tone
from cadenza.music.score import Note, PedalEvent

_ENERGY = {"intro": -8, "verse": -4, "chorus": 6, "bridge": 1, "solo": 2, "outro": -4, "ending": 0}
"""Velocities by which sections are louder than others."""
# In percent of songs.
_HUMAN = 60  # notes are not quite in time
_FLAT = 12  # all notes of a player are equally loud
_JITTER = 0.01  # [s] by which notes are early or late, at most
_SPREAD = 5  # velocities by which notes are louder or softer at random, at most
_RELEASE, _RELEASE_SHARE = 20, 8  # [ticks] by which notes end early; at most one in so many
_PEDAL_DOWN = 60  # [ticks] after a change of harmony
_LOUDEST = 127


@dataclass(slots=True)
class _Event:
    """A note in ticks."""

    start: int
    end: int
    pitch: int
    velocity: int
    role: Role


@dataclass(frozen=True)
class Hand:
    """How all players of a song play: with jitter of `late` ticks at most, or `flat`, all alike."""

    late: int
    flat: bool


def random_hand(rng: np.random.Generator, plan: Plan) -> Hand:
    """Players who are in time or not quite, and mostly with dynamics."""
    late = ticks(_JITTER, plan.tempo) if happens(rng, _HUMAN) else 0
    return Hand(late, happens(rng, _FLAT))


def played(rng: np.random.Generator, plan: Plan, player: Player, hand: Hand) -> Part:
    """The part of a player, in which no two notes of a pitch, or of a melody, overlap."""
    events = [_event(rng, plan, player, tone, role, hand) for tone, role in player.tones]
    events = sorted(_apart(events), key=attrgetter("start", "pitch"))
    notes = (
        Note(seconds(e.start, plan.tempo), seconds(e.end, plan.tempo), e.pitch, e.velocity)
        for e in events
    )
    roles = tuple(event.role for event in events)
    pedal = _pedal(plan) if player.pedal else ()
    return Part(player.name, player.program, player.channel, tuple(notes), roles, pedal)


def _event(
    rng: np.random.Generator, plan: Plan, player: Player, tone: Tone, role: Role, hand: Hand
) -> _Event:
    start, end = plan.ticks(tone.at), plan.ticks(tone.at + player.legato * tone.length)
    length = max(end - start - min(_RELEASE, (end - start) // _RELEASE_SHARE), 1)
    velocity = player.loud
    if not hand.flat:
        velocity += tone.velocity - MEDIUM + _ENERGY[plan.passage(tone.at).kind]
        velocity += int(rng.integers(-_SPREAD, _SPREAD, endpoint=True))
    start = max(start + int(rng.integers(-hand.late, hand.late, endpoint=True)), 0)
    return _Event(start, start + length, tone.pitch, min(velocity, _LOUDEST), role)


def _apart(events: list[_Event]) -> list[_Event]:
    """The events with those cut at which the next of their pitch, or of the melody, begins.

    Of equal pitches that begin together one is left, that of the melody first.
    """
    kept: list[_Event] = []
    latest: dict[int | str, _Event] = {}
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


def _pedal(plan: Plan) -> tuple[PedalEvent, ...]:
    """A pedal that is lifted where harmonies change, and goes down right after."""
    events = []
    for passage, start in plan.placed:
        for harmony in passage.harmonies:
            at = plan.ticks(start + harmony.at)
            events.append(PedalEvent(seconds(at, plan.tempo), 0))
            events.append(PedalEvent(seconds(at + _PEDAL_DOWN, plan.tempo), _LOUDEST))
    end = plan.starts[-1] + plan.passages[-1].length
    return (*events, PedalEvent(plan.seconds(end), 0))
