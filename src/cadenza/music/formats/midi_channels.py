"""What the channels of a MIDI file play: their notes, drums, pedals and volumes."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, groupby
from math import inf
from operator import itemgetter

import mido

from cadenza.music.repair import RawNote
from cadenza.music.score import PEDAL_DOWN, PITCHES

SUSTAIN = 64
"""The controller number of the sustain pedal."""
_SOSTENUTO, _SOFT = 66, 67
_BANK, _VOLUME, _EXPRESSION = 0, 7, 11  # controllers
_SETTINGS = (_BANK, _VOLUME, _EXPRESSION)
_RESET = 121  # controller that lifts the pedals of a channel, among others
_ALL_OFF = 120, 123  # controllers that end all notes of a channel
_FULL = 127
_DRUM_CHANNEL = 9  # channel 10 of General MIDI, counted from 0
_MELODIC_BANK, _DRUM_BANK = 121, 120  # of General MIDI 2
_XG_DRUM_BANKS = (126, 127)
# Messages of Roland (GS) and Yamaha (XG), without their addresses and values: those that say
# whether the part of a channel plays drums, and the one by which XG's banks have other meanings.
_ROLAND, _GS, _SET, _PATCH, _RHYTHM = 0x41, 0x42, 0x12, 0x40, 0x15
_GS_RESET = (0x40, 0x00, 0x7F, 0x00)
_GS_CHANNELS = (_DRUM_CHANNEL, *range(_DRUM_CHANNEL), *range(_DRUM_CHANNEL + 1, 16))  # of parts
_YAMAHA, _XG, _PART, _MODE = 0x43, 0x4C, 0x08, 0x07
_MISSING = (-1,) * 8  # in place of the bytes of a message that ends early
_PLAYED = ("note_on", "note_off", "control_change", "program_change", "sysex")


@dataclass(slots=True)
class Part:
    """The music of one channel in one track of the file.

    `muted` are notes during which the channel has no volume. `outside` counts notes that no key
    plays.
    """

    channel: int
    is_drums: bool = False
    name: str = ""
    program: int | None = None
    notes: list[RawNote] = field(default_factory=list)
    muted: list[RawNote] = field(default_factory=list)
    outside: int = 0

    @property
    def sounds(self) -> bool:
        """Whether any of its notes lasts, unlike those that only switch something."""
        return any(note.end > note.start for note in (*self.notes, *self.muted))

    def finish(self, end: int, silences: Sequence[Sequence[float]]) -> None:
        """Ends notes that nothing has released, and sets those apart that are not heard."""
        found, self.notes = self.notes, []
        for note in found:
            note.end = note.end if note.released else end
            span = bisect_right(silences, note.start, key=itemgetter(0)) - 1
            is_muted = span >= 0 and note.start < silences[span][1] >= note.end
            (self.muted if is_muted else self.notes).append(note)


@dataclass(slots=True)
class _Channel:
    """A channel while the file is played.

    Whether it plays drums, a message to the synthesizer says, or else its bank of sounds.
    `silences` are the spans without volume. `sounding` are notes in the order in which they began,
    by pitch, and `of_track` the same by track and pitch; those released by way of the other are
    still there. The sostenuto pedal went down at the time `sostenuto`, None if it is up, and goes
    on to hold `captured`, notes that were released since.
    """

    has_drum_bank: bool = False
    is_drum_part: bool | None = None
    pedal: int = 0
    volume: int = _FULL
    expression: int = _FULL
    silences: list[list[float]] = field(default_factory=list)
    sounding: defaultdict[int, deque[RawNote]] = field(default_factory=lambda: defaultdict(deque))
    of_track: defaultdict[tuple[int, int], deque[RawNote]] = field(
        default_factory=lambda: defaultdict(deque)
    )
    sostenuto: int | None = None
    captured: list[RawNote] = field(default_factory=list)

    @property
    def is_drums(self) -> bool:
        """Whether the channel plays drums."""
        return self.has_drum_bank if self.is_drum_part is None else self.is_drum_part

    def begin(self, track: int, note: RawNote) -> None:
        """Begins a note."""
        self.sounding[note.pitch].append(note)
        self.of_track[track, note.pitch].append(note)

    def release(self, track: int, pitch: int, now: int) -> None:
        """Ends the oldest note of this pitch in a track; if there is none, the oldest of all."""
        for waiting in (self.of_track[track, pitch], self.sounding[pitch]):
            while waiting:
                note = waiting.popleft()
                if not note.released:
                    self._end(note, now)
                    return

    def release_all(self, now: int) -> None:
        """Ends all notes."""
        for waiting in self.sounding.values():
            for note in waiting:
                if not note.released:
                    self._end(note, now)
        self.sounding.clear()
        self.of_track.clear()

    def _end(self, note: RawNote, now: int) -> None:
        note.release(now)
        if self.sostenuto is not None and note.start <= self.sostenuto:
            self.captured.append(note)

    def move_sostenuto(self, value: int, now: int) -> None:
        """Moves the sostenuto pedal, which holds what sounds when it goes down."""
        if value >= PEDAL_DOWN and self.sostenuto is None:
            self.sostenuto = now
        elif value < PEDAL_DOWN:
            for note in self.captured:
                note.end = now
            self.sostenuto, self.captured = None, []

    def set_volume(self, volume: int, expression: int, now: int) -> None:
        """Changes the volume, which is the product of both."""
        was_silent = self.volume * self.expression == 0
        self.volume, self.expression = volume, expression
        is_silent = volume * expression == 0
        if is_silent and not was_silent:
            self.silences.append([now, inf])
        elif was_silent and not is_silent:
            self.silences[-1][1] = now


class Playing:
    """Plays the tracks of a file, in which each channel is one stream of messages.

    Args:
        chunks: the tracks of the file.
        at: converts ticks to times, in the unit of notes.
    """

    def __init__(self, chunks: Sequence[mido.MidiTrack], at: Callable[[int], int]) -> None:
        self.moves: list[tuple[int, int, int]] = []
        """Movements of the sustain pedals of channels without drums: times, channels, values."""
        self.soft: set[int] = set()
        """The channels whose soft pedal goes down."""
        self._channels = defaultdict[int, _Channel](_Channel)
        self._channels[_DRUM_CHANNEL].has_drum_bank = True
        self._parts: dict[tuple[int, int, bool], Part] = {}
        self._is_gs = False
        events = (
            (tick, track, message)
            for track, chunk in enumerate(chunks)
            for tick, message in timed(chunk)
            if message.type in _PLAYED
        )
        # At one time, what sets up a channel comes first, in whichever track it is.
        for tick, track, message in sorted(events, key=lambda each: (each[0], _plays(each[2]))):
            if message.type == "sysex":
                self._set_up(message.data)
            else:
                self._play(message, track, at(tick))
        by_track: list[list[Part]] = [[] for _ in chunks]
        for (track, *_), part in self._parts.items():
            by_track[track].append(part)
        for chunk, here in zip(chunks, by_track, strict=True):
            end = at(sum(message.time for message in chunk))
            for part in here:
                part.finish(end, self._channels[part.channel].silences)
            if len(here) == 1:  # else it names the song, or none of them in particular
                here[0].name = next((m.name for m in chunk if m.type == "track_name"), "")
        self.parts = [part for here in by_track for part in here]
        """The music of each channel in each track of the file, by tracks."""

    def _play(self, message: mido.Message, track: int, now: int) -> None:
        """Plays a message of a channel at a time."""
        channel, kind = self._channels[message.channel], message.type
        if kind == "control_change":
            self._control(message, channel, now)
        elif kind == "program_change":
            part = self._part(message.channel, track)
            part.program = message.program if part.program is None else part.program
        elif kind == "note_on" and message.velocity > 0:
            part = self._part(message.channel, track)
            if message.note not in PITCHES:
                part.outside += 1
                return
            note = RawNote(now, now, message.note, message.velocity)
            part.notes.append(note)
            channel.begin(track, note)
        else:
            channel.release(track, message.note, now)

    def _control(self, message: mido.Message, channel: _Channel, now: int) -> None:
        """Moves a controller."""
        control, value = message.control, message.value
        if control == SUSTAIN or (control == _RESET and channel.pedal):
            channel.pedal = value if control == SUSTAIN else 0
            if not channel.is_drums:
                self.moves.append((now, message.channel, channel.pedal))
        if control == _SOSTENUTO:
            channel.move_sostenuto(value, now)
        elif control == _SOFT and value >= PEDAL_DOWN:
            self.soft.add(message.channel)
        elif control == _VOLUME:
            channel.set_volume(value, channel.expression, now)
        elif control == _EXPRESSION:
            channel.set_volume(channel.volume, value, now)
        elif control == _RESET:
            channel.move_sostenuto(0, now)
            channel.set_volume(channel.volume, _FULL, now)
        elif control in _ALL_OFF:
            channel.release_all(now)
        elif control == _BANK:
            self._select_bank(message.channel, value)

    def _select_bank(self, number: int, bank: int) -> None:
        """Has a channel play drums, or no longer, as its bank of sounds is one of them or not."""
        channel = self._channels[number]
        if bank == _DRUM_BANK or (bank in _XG_DRUM_BANKS and not self._is_gs):
            channel.has_drum_bank = True
        elif bank == _MELODIC_BANK or number != _DRUM_CHANNEL:
            channel.has_drum_bank = False

    def _set_up(self, data: Sequence[int]) -> None:
        """Sets up the parts of a Roland or Yamaha synthesizer as a system message says."""
        maker, _, model, command, *content = (*data, *_MISSING)
        if (maker, model, command) == (_ROLAND, _GS, _SET):
            high, middle, low, value = content[: len(_GS_RESET)]
            if (high, middle, low, value) == _GS_RESET:
                self._is_gs = True
            elif (high, low) == (_PATCH, _RHYTHM) and middle >> 4 == 1 and value >= 0:
                self._channels[_GS_CHANNELS[middle & 0xF]].is_drum_part = value > 0
        elif (maker, model, command) == (_YAMAHA, _XG, _PART):
            number, address, value, *_ = content
            if address == _MODE and value >= 0:
                self._channels[number].is_drum_part = value > 0

    def _part(self, channel: int, track: int) -> Part:
        is_drums = self._channels[channel].is_drums
        return self._parts.setdefault((track, channel, is_drums), Part(channel, is_drums))


def _plays(message: mido.Message) -> bool:
    """Whether a message is more than a setting of how a channel sounds."""
    is_setting = message.type == "control_change" and message.control in _SETTINGS
    return not is_setting and message.type != "sysex"


def timed(chunk: mido.MidiTrack) -> Iterator[tuple[int, mido.Message]]:
    """Yields the messages of a track with their times [ticks] since its beginning."""
    return zip(accumulate(message.time for message in chunk), chunk, strict=True)


def merged_pedal(moves: Iterable[tuple[int, int, int]]) -> Iterator[tuple[int, int]]:
    """Yields times and values of the one pedal of a piano: the lowest that any channel holds it.

    Where several channels change the pedal at one time, it goes up before it goes down again.

    Args:
        moves: times, channels and values, in order of time.
    """
    held: dict[int, int] = {}
    for time, together in groupby(moves, key=itemgetter(0)):
        changes = [(channel, value) for _, channel, value in together]
        if {*held, *(channel for channel, _ in changes)} == {changes[0][0]}:  # no other has one
            yield from ((time, value) for _, value in changes)
        else:
            lifted = held | dict(sorted(changes, key=itemgetter(1), reverse=True))
            between, after = max(lifted.values()), max((held | dict(changes)).values())
            yield from ((time, value) for value in dict.fromkeys((between, after)))
        held.update(changes)
