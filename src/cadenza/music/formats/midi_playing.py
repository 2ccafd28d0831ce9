"""Plays the tracks of a MIDI file: what its channels and pedals do, in order of time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from itertools import accumulate, groupby
from operator import attrgetter, itemgetter
from typing import NamedTuple

import mido

from cadenza.music.formats.general_midi import (
    ALL_OFF,
    BANK,
    EXPRESSION,
    LARGEST,
    RESET,
    SOFT,
    SOSTENUTO,
    SUSTAIN,
    VOLUME,
)
from cadenza.music.formats.midi_channels import Channel, Part, Port
from cadenza.music.formats.midi_synthesizers import Sets, Setting, are_for_roland, setting_of
from cadenza.music.formats.midi_tuning import CONTROLS, NO_PARAMETER
from cadenza.music.repair import RawNote
from cadenza.music.score import PEDAL_DOWN

_SETTINGS = CONTROLS | {BANK, VOLUME, EXPRESSION, RESET}
_PLAYING = "note_on", "note_off", "control_change", "program_change"
_WHEEL = 1 << 13  # positions of the pitch wheel on either side
_RESETS, _SETS_UP, _SETS, _PLAYED = range(4)  # ranks of what happens at one tick


class Playing:
    """Plays the tracks of a file, in which each channel of a port is one stream of messages.

    Args:
        chunks: the tracks of the file.
        at: converts ticks to times, in the unit of notes.
    """

    def __init__(self, chunks: Sequence[mido.MidiTrack], at: Callable[[int], int]) -> None:
        self.moves: list[tuple[int, Channel, int]] = []
        """Movements of the sustain pedals of channels without drums: times, channels, values."""
        self.soft: set[Channel] = set()
        """The channels whose soft pedal goes down."""
        self._ports = defaultdict[int, Port](Port.new)
        self._parts: dict[tuple[int, Channel, bool], Part] = {}
        system = [each.data for chunk in chunks for each in chunk if each.type == "sysex"]
        self._is_roland = are_for_roland(system)
        events = (event for track, chunk in enumerate(chunks) for event in _events(track, chunk))
        # At one time, what sets up a channel comes first, in whichever track it is.
        for event in sorted(events, key=attrgetter("tick", "rank")):
            now, port = at(event.tick), self._ports[event.port]
            if isinstance(event.content, Setting):
                port.set_up(event.content, now)
            elif event.rank < _PLAYED:
                self._set(event.content, port, now)
            else:
                self._play(event.content, event, now)
        by_track: list[list[Part]] = [[] for _ in chunks]
        for (track, *_), part in self._parts.items():
            by_track[track].append(part)
        for chunk, here in zip(chunks, by_track, strict=True):
            end = at(sum(message.time for message in chunk))
            for part in here:
                part.finish(end, self._ports[part.channel.port].states[part.channel.number])
            if len(here) == 1:  # else it names the song, or none of them in particular
                here[0].name = next((m.name for m in chunk if m.type == "track_name"), "")
        self.parts = [part for here in by_track for part in here]
        """The music of each channel in each track of the file, by tracks."""

    def _set(self, message: mido.Message, port: Port, now: int) -> None:
        """Changes how a channel sounds."""
        number = message.channel
        state = port.states[number]
        if message.type == "pitchwheel":
            port.turn_wheel(number, message.pitch / _WHEEL, now)
        elif message.control == VOLUME:
            state.set_volume(message.value, state.expression, now)
        elif message.control == EXPRESSION:
            state.set_volume(state.volume, message.value, now)
        elif message.control == BANK:
            port.select_bank(number, message.value, self._is_roland)
        elif message.control == RESET:
            state.set_volume(state.volume, LARGEST, now)
            state.tuning.chosen = NO_PARAMETER
            port.turn_wheel(number, 0.0, now)
        else:
            port.set_parameter(number, message.control, message.value, now)

    def _play(self, message: mido.Message, event: _Event, now: int) -> None:
        """Plays a message of a channel."""
        port, channel = self._ports[event.port], Channel(event.port, message.channel)
        state, kind = port.states[channel.number], message.type
        if kind == "control_change":
            self._move(message, channel, now)
        elif kind == "program_change":
            part = self._part(channel, event.track)
            part.program = message.program if part.program is None else part.program
        elif kind == "note_on" and message.velocity > 0:
            pitch = message.note + port.shift(channel.number)
            note = RawNote(now, now, pitch, message.velocity)
            self._part(channel, event.track).notes.append(note)
            state.begin(event.track, message.note, note)
        else:
            state.release(event.track, message.note, now)

    def _move(self, message: mido.Message, channel: Channel, now: int) -> None:
        """Moves a pedal, or ends all notes."""
        port, control, value = self._ports[channel.port], message.control, message.value
        state = port.states[channel.number]
        if control == SUSTAIN or (control == RESET and state.pedal):
            state.pedal = value if control == SUSTAIN else 0
            if not port.is_drums(channel.number):
                self.moves.append((now, channel, state.pedal))
        if control in (SOSTENUTO, RESET):
            state.move_sostenuto(value if control == SOSTENUTO else 0, now)
        elif control == SOFT and value >= PEDAL_DOWN:
            self.soft.add(channel)
        elif control in ALL_OFF:
            state.release_all(now)

    def _part(self, channel: Channel, track: int) -> Part:
        is_drums = self._ports[channel.port].is_drums(channel.number)
        return self._parts.setdefault((track, channel, is_drums), Part(channel, is_drums))


class _Event(NamedTuple):
    """A message of a track to a port, or the setting that it makes; at one tick, by ranks."""

    tick: int
    rank: int
    track: int
    port: int
    content: mido.Message | Setting


def _events(track: int, chunk: mido.MidiTrack) -> Iterator[_Event]:
    """Yields what is played of a track; twice what both sets up a channel and moves its pedals."""
    port = 0
    for tick, message in timed(chunk):
        kind = message.type
        if kind == "midi_port":
            port = message.port
        elif kind == "sysex":
            if setting := setting_of(message.data):
                rank = _RESETS if setting.what is Sets.ALL else _SETS_UP
                yield _Event(tick, rank, track, port, setting)
        elif kind == "pitchwheel" or (kind == "control_change" and message.control in _SETTINGS):
            yield _Event(tick, _SETS, track, port, message)
            if kind == "control_change" and message.control == RESET:
                yield _Event(tick, _PLAYED, track, port, message)
        elif kind in _PLAYING:
            yield _Event(tick, _PLAYED, track, port, message)


def timed(chunk: mido.MidiTrack) -> Iterator[tuple[int, mido.Message]]:
    """Yields the messages of a track with their times [ticks] since its beginning."""
    return zip(accumulate(message.time for message in chunk), chunk, strict=True)


def merged_pedal(moves: Iterable[tuple[int, Hashable, int]]) -> Iterator[tuple[int, int]]:
    """Yields times and values of the one pedal of a piano: the lowest that any channel holds it.

    Where several channels change the pedal at one time, it goes up before it goes down again.

    Args:
        moves: times, channels and values, in order of time.
    """
    held: dict[Hashable, int] = {}
    channels_at = [0] * (LARGEST + 1)  # how many hold the pedal at each value

    def lowest_after(changes: Iterable[tuple[Hashable, int]]) -> int:
        for channel, value in changes:
            if channel in held:
                channels_at[held[channel]] -= 1
            held[channel] = value
            channels_at[value] += 1
        return next(value for value in range(LARGEST, -1, -1) if channels_at[value])

    for time, together in groupby(moves, key=itemgetter(0)):
        changes = [(channel, value) for _, channel, value in together]
        between = lowest_after(sorted(changes, key=itemgetter(1), reverse=True))
        after = lowest_after(changes)
        if len(held) == 1:  # no other has one
            yield from ((time, value) for _, value in changes)
        else:
            yield from ((time, value) for value in dict.fromkeys((between, after)))
