"""What the channels and pedals of a MIDI file play, in order of time.

Channels have drums, tuning, volume and held notes.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from operator import itemgetter
from typing import NamedTuple

from cadenza.music.formats.midi_messages import (
    ALL_OFF,
    ANY_TIME,
    BANK,
    CHANNELS,
    CONTROL,
    DRUM_CHANNEL,
    EXPRESSION,
    LARGEST,
    NAME,
    NOTE_OFF,
    NOTE_ON,
    PORT,
    PROGRAM,
    REAL_TIME,
    RESET,
    ROLAND,
    SOFT,
    SOSTENUTO,
    SUSTAIN,
    SYSEX,
    VOLUME,
    WHEEL,
    YAMAHA,
    Message,
)
from cadenza.music.repair import RawNote
from cadenza.music.score import PEDAL_DOWN, PITCHES

_DATA, _DATA_FINE, _INCREMENT, _DECREMENT = 6, 38, 96, 97  # controllers that set a parameter
_OTHERS, _LOW, _HIGH = (98, 99), 100, 101  # those that choose it; _OTHERS choose one of makers
_PARAMETERS = (_DATA, _DATA_FINE, _INCREMENT, _DECREMENT, *_OTHERS, _LOW, _HIGH)
SETTINGS = frozenset((BANK, VOLUME, EXPRESSION, RESET, *_PARAMETERS))
"""The controllers that change how the notes of a channel sound."""
_BEND_RANGE, _COARSE, _ZONE = (0, 0), (0, 2), (0, 6)  # parameters: high and low bytes
_NO_PARAMETER = (LARGEST, LARGEST)
_KEEPS = 64  # the value that transposes by nothing
_MAX_SHIFT = 24  # [semitones] by which synthesizers of GS and XG transpose or bend
_USUAL_RANGE, _MEMBER_RANGE = 2, 48  # bend ranges [semitones] of channels, and of members of zones
_CENTS = 100  # in a semitone
_POSITIONS = 1 << 13  # positions of the pitch wheel on either side
_EXACT = 0.1  # [semitones] by which a bend may miss whole ones: wheels of 7 bits miss 2 by 0.03
_MANAGERS = CHANNELS[0], CHANNELS[-1]  # of MPE zones: the channels above and below them
_MELODIC_BANK, _DRUM_BANK = 121, 120  # of General MIDI 2
_XG_DRUM_BANKS = (126, 127)

_XG, _GS = (YAMAHA, 0x4C), (ROLAND, 0x42, 0x12)  # messages that set the value of an address
_ADDRESS_BYTES = {ROLAND: 6, YAMAHA: 5, ANY_TIME: 2, REAL_TIME: 4}  # including the one of the maker
ALL, _DRUMS, _KEY_SHIFT, _RANGE = "all", "is_drum_part", "key_shift", "bend_range"
_GS_CHANNELS = (DRUM_CHANNEL, *(number for number in CHANNELS if number != DRUM_CHANNEL))
_SETTINGS: dict[tuple[int, ...], tuple[str, int | None]] = {  # address -> what, channel
    (ANY_TIME, 0x09): (ALL, None),
    (REAL_TIME, 0x04, 0x04, 0x00): (_KEY_SHIFT, None),
    (*_GS, 0x40, 0x00, 0x7F): (ALL, None),
    (*_GS, 0x40, 0x00, 0x05): (_KEY_SHIFT, None),
    **{(*_GS, 0x40, 0x10 + part, 0x15): (_DRUMS, n) for part, n in enumerate(_GS_CHANNELS)},
    **{(*_GS, 0x40, 0x10 + part, 0x16): (_KEY_SHIFT, n) for part, n in enumerate(_GS_CHANNELS)},
    **{(*_GS, 0x40, 0x20 + part, 0x10): (_RANGE, n) for part, n in enumerate(_GS_CHANNELS)},
    (*_XG, 0x00, 0x00, 0x7E): (ALL, None),
    (*_XG, 0x00, 0x00, 0x7F): (ALL, None),
    (*_XG, 0x00, 0x00, 0x06): (_KEY_SHIFT, None),
    **{(*_XG, 0x08, n, 0x07): (_DRUMS, n) for n in CHANNELS},
    **{(*_XG, 0x08, n, 0x08): (_KEY_SHIFT, n) for n in CHANNELS},
    **{(*_XG, 0x08, n, 0x23): (_RANGE, n) for n in CHANNELS},
}


class Setting(NamedTuple):
    """What a system message sets: an attribute of a channel, or of all where that is None."""

    what: str
    value: int
    channel: int | None


def setting_of(data: bytes) -> Setting | None:
    """The setting that a system message makes, without its first and last byte; None if none."""
    size = _ADDRESS_BYTES[data[0]]
    address, value = (data[0], *data[2 : size + 1]), data[size + 1 :][:1]
    if not value or address not in _SETTINGS:
        return None
    what, channel = _SETTINGS[address]
    if what in (ALL, _DRUMS):
        return Setting(what, value[0], channel)
    semitones = value[0] - _KEEPS
    is_valid = data[0] == REAL_TIME or abs(semitones) <= _MAX_SHIFT
    return Setting(what, semitones, channel) if is_valid else None


def drum_banks(messages: Collection[bytes]) -> tuple[int, ...]:
    """The banks of sounds that are drums; not those of XG if system messages are for Roland's."""
    is_xg = any((data[0], *data[2:3]) == _XG for data in messages)
    is_roland = not is_xg and any(data[0] == ROLAND for data in messages)
    return (_DRUM_BANK,) if is_roland else (_DRUM_BANK, *_XG_DRUM_BANKS)


class Channel:
    """A channel while a file is played.

    Whether it plays drums, a message to the synthesizer says, or else its bank of sounds.
    Controllers set the registered parameter `chosen`: `coarse` tuning [semitones], or `bend_range`
    [semitones], as far as the pitch `wheel`, from -1 to 1, bends. Fine tuning is left out, as no
    key has it. `key_shift` [semitones] is what a synthesizer adds. In an MPE zone, it bends with
    its `manager`.

    Its sustain pedal has the value `pedal`. Notes that sound are kept in the order in which they
    began, by key, and again by track and key; those released by way of the other are still there.
    A sostenuto pedal that is down goes on to hold notes that were released since.
    """

    def __init__(self, port: Port, number: int) -> None:
        self.port, self.number = port, number
        self.pedal = 0
        self._volume = self._expression = LARGEST
        self._silences: list[list[float]] = []  # from when to when there is no volume
        self._bends: list[tuple[int, float]] = []  # times, and sizes from then on [semitones]
        self._sounding = defaultdict[int, deque[RawNote]](deque)
        self._of_track = defaultdict[tuple[int, int], deque[RawNote]](deque)
        self._sostenuto: int | None = None  # the time at which that pedal went down
        self._captured: list[RawNote] = []
        self.switch_on()

    def switch_on(self) -> None:
        """Set up the channel as it is when its synthesizer is switched on."""
        self.has_drum_bank = self.number == DRUM_CHANNEL
        self.is_drum_part: int | None = None
        self.manager: Channel | None = None
        self.chosen = _NO_PARAMETER
        self.coarse = self.key_shift = 0
        self.bend_range, self.wheel = float(_USUAL_RANGE), 0.0

    @property
    def is_drums(self) -> bool:
        """Whether the channel plays drums."""
        is_drums = self.has_drum_bank if self.is_drum_part is None else self.is_drum_part > 0
        return is_drums and self.manager is None

    @property
    def shift(self) -> int:
        """The transposition of the notes that begin [semitones]."""
        return 0 if self.is_drums else self.coarse + self.key_shift + self.port.key_shift

    def change(self, message: Message, drum_banks: Collection[int], now: int) -> None:
        """Change how the channel sounds, as a message says; it may have `drum_banks`."""
        if message.kind == WHEEL:
            low, high = message.data
            self._turn_wheel((high << 7 | low) / _POSITIONS - 1, now)
            return
        control, value = message.data
        if control == VOLUME:
            self._set_volume(value, self._expression, now)
        elif control == EXPRESSION:
            self._set_volume(self._volume, value, now)
        elif control == BANK and value in drum_banks:
            self.has_drum_bank = True
        elif control == BANK:
            self.has_drum_bank &= self.number == DRUM_CHANNEL and value != _MELODIC_BANK
        elif control == RESET:
            self._set_volume(self._volume, LARGEST, now)
            self.chosen = _NO_PARAMETER
            self._turn_wheel(0.0, now)
        elif control in (_LOW, _HIGH, *_OTHERS):
            high, low = self.chosen
            chosen = {_HIGH: (value, low), _LOW: (high, value)}
            self.chosen = chosen.get(control, _NO_PARAMETER)
        else:
            self._set_parameter(control, value, now)

    def _set_volume(self, volume: int, expression: int, now: int) -> None:
        was_silent, is_silent = self._volume * self._expression == 0, volume * expression == 0
        self._volume, self._expression = volume, expression
        if is_silent and not was_silent:
            self._silences.append([now, inf])
        elif was_silent and not is_silent:
            self._silences[-1][1] = now

    def _set_parameter(self, control: int, value: int, now: int) -> None:
        """Set the registered parameter that is chosen, which may be for all of an MPE zone."""
        if self.chosen == _COARSE and control != _DATA_FINE:
            steps = {_INCREMENT: 1, _DECREMENT: -1}
            tuned = self.coarse + steps[control] if control in steps else value - _KEEPS
            self.coarse = min(max(tuned, -_KEEPS), LARGEST - _KEEPS)
        elif self.chosen == _ZONE and control == _DATA and self.number in _MANAGERS:
            self._make_zone(value)
            self.port.record_bends(now)
        elif self.chosen == _BEND_RANGE:
            if control == _DATA:
                self.bend_range = value
            elif control == _DATA_FINE:
                self.bend_range = int(self.bend_range) + value / _CENTS
            for other in self.port.channels if self.manager else ():
                if other.manager is self.manager:
                    other.bend_range = self.bend_range
            self.port.record_bends(now)

    def _make_zone(self, size: int) -> None:
        """Make an MPE zone of the next channels, which is none if its size is 0."""
        members = [c for c in self.port.channels if 0 < abs(c.number - self.number) <= size]
        for channel in self.port.channels:
            if channel in (self, *members) or channel.manager in (self, *members):
                channel.manager = None
        for member in members:
            member.manager, member.bend_range = self, _MEMBER_RANGE
        self.bend_range = _USUAL_RANGE

    def _turn_wheel(self, wheel: float, now: int) -> None:
        """Turn the pitch wheel, which also bends the channels that this one manages."""
        if wheel != self.wheel:
            self.wheel = wheel
            for other in self.port.channels:
                if other is self or other.manager is self:
                    other.record_bend(now)

    def record_bend(self, now: int) -> None:
        """Record the bend, if it changes at a time, with that of the manager [semitones]."""
        bend = self.wheel * self.bend_range
        bend += self.manager.wheel * self.manager.bend_range if self.manager else 0.0
        if abs(bend - (self._bends[-1][1] if self._bends else 0.0)) > _EXACT:
            self._bends.append((now, bend))

    def bend_of(self, note: RawNote) -> tuple[int, bool]:
        """The transposition of a note that begins under a bend [semitones]; whether it is exact.

        A bend that does not last for half of the note moves nothing.
        """
        latest = bisect_right(self._bends, note.start, key=itemgetter(0)) - 1
        bend = self._bends[latest][1] if latest >= 0 else 0.0
        next_bend = self._bends[latest + 1][0] if latest + 1 < len(self._bends) else inf
        semitones = round(bend) if 2 * (next_bend - note.start) >= note.end - note.start else 0
        return semitones, abs(bend - semitones) <= _EXACT

    def is_silent(self, note: RawNote) -> bool:
        """Whether the channel has no volume from the beginning of a note to its end."""
        span = bisect_right(self._silences, note.start, key=itemgetter(0)) - 1
        return span >= 0 and note.start < self._silences[span][1] >= note.end

    def begin(self, track: int, key: int, note: RawNote) -> None:
        """Begin the note of a key."""
        self._sounding[key].append(note)
        self._of_track[track, key].append(note)

    def release(self, track: int, key: int, now: int) -> None:
        """End the oldest note of this key in a track; if there is none, the oldest of all."""
        for waiting in (self._of_track[track, key], self._sounding[key]):
            while waiting:
                note = waiting.popleft()
                if not note.released:
                    self._end(note, now)
                    return

    def release_all(self, now: int) -> None:
        """End all notes."""
        for waiting in self._sounding.values():
            for note in waiting:
                if not note.released:
                    self._end(note, now)
        self._sounding.clear()
        self._of_track.clear()

    def _end(self, note: RawNote, now: int) -> None:
        note.release(now)
        if self._sostenuto is not None and note.start <= self._sostenuto:
            self._captured.append(note)

    def move_sostenuto(self, value: int, now: int) -> None:
        """Move the sostenuto pedal, which holds what sounds when it goes down."""
        if value >= PEDAL_DOWN and self._sostenuto is None:
            self._sostenuto = now
        elif value < PEDAL_DOWN:
            for note in self._captured:
                note.end = now
            self._sostenuto, self._captured = None, []


class Port:
    """The channels of a port; all of their melodies are transposed by `key_shift` [semitones]."""

    def __init__(self) -> None:
        self.channels = [Channel(self, number) for number in CHANNELS]
        self.key_shift = 0

    def set_up(self, setting: Setting, now: int) -> None:
        """Set up the synthesizer."""
        if setting.what == ALL:
            self.key_shift = 0
            for channel in self.channels:
                channel.switch_on()
        else:
            target = self if setting.channel is None else self.channels[setting.channel]
            setattr(target, setting.what, setting.value)
        self.record_bends(now)

    def record_bends(self, now: int) -> None:
        """Record the bends of all channels, where they change."""
        for channel in self.channels:
            channel.record_bend(now)


_PLAYED = frozenset((NOTE_ON, NOTE_OFF, CONTROL, PROGRAM))
_RESETS, _SETS_UP, _CHANGES, _PLAYS = range(4)  # ranks of what happens at one tick


@dataclass(slots=True)
class Part:
    """The music of one channel in one track of the file.

    `muted` are notes during which the channel has no volume. `outside` counts notes that no key
    plays, and `bent` those that the pitch wheel takes between keys.
    """

    channel: Channel
    is_drums: bool = False
    name: bytes = b""
    program: int | None = None
    notes: list[RawNote] = field(default_factory=list)
    muted: list[RawNote] = field(default_factory=list)
    outside: int = 0
    bent: int = 0

    @property
    def sounds(self) -> bool:
        """Whether any of its notes lasts, unlike notes that only switch something."""
        return any(note.end > note.start for note in (*self.notes, *self.muted))

    def finish(self, end: int) -> None:
        """End notes that nothing has released, bend them, and set apart what is not heard."""
        notes, self.notes = self.notes, []
        for note in notes:
            note.end = note.end if note.released else end
            if not self.is_drums:
                semitones, is_exact = self.channel.bend_of(note)
                note.pitch += semitones
                self.bent += not is_exact
            if note.pitch in PITCHES:
                (self.muted if self.channel.is_silent(note) else self.notes).append(note)
            else:
                self.outside += 1


class Playing:
    """The tracks of a file as they are played; each channel of a port is one stream of messages.

    `at` converts ticks to times, in the unit of notes.
    """

    def __init__(self, tracks: Sequence[Sequence[Message]], at: Callable[[int], int]) -> None:
        self.moves: list[tuple[int, Channel, int]] = []
        """Movements of the sustain pedals of channels without drums: times, channels, values."""
        self.soft: set[Channel] = set()
        """The channels whose soft pedal goes down."""
        self._parts: dict[tuple[int, Channel, bool], Part] = {}
        ports = defaultdict[int, Port](Port)
        banks = drum_banks([each.data for track in tracks for each in track if each.kind == SYSEX])
        events = (event for number, track in enumerate(tracks) for event in _events(number, track))
        # At one time, what sets up a channel comes first, in whichever track it is.
        for tick, rank, track, port, content in sorted(events, key=itemgetter(0, 1)):
            now = at(tick)
            if isinstance(content, Setting):
                ports[port].set_up(content, now)
            elif rank == _CHANGES:
                ports[port].channels[content.channel].change(content, banks, now)
            else:
                self._play(content, ports[port].channels[content.channel], track, now)
        by_track = defaultdict[int, list[Part]](list)
        for (track, *_), part in self._parts.items():
            by_track[track].append(part)
        for track, parts in by_track.items():
            for part in parts:
                part.finish(at(tracks[track][-1].tick))
            if len(parts) == 1:  # else it names the song, or none of them in particular
                names = (each.data for each in tracks[track] if each.kind == NAME)
                parts[0].name = next(names, b"")
        self.parts = [part for track in sorted(by_track) for part in by_track[track]]
        """The music of each channel in each track of the file, by tracks."""

    def _play(self, message: Message, channel: Channel, track: int, now: int) -> None:
        if message.kind == CONTROL:
            control, value = message.data
            self._move(channel, control, value, now)
        elif message.kind == PROGRAM:
            part = self._part(channel, track)
            part.program = message.data[0] if part.program is None else part.program
        elif message.kind == NOTE_ON and message.data[1] > 0:
            key, velocity = message.data
            note = RawNote(now, now, key + channel.shift, velocity)
            self._part(channel, track).notes.append(note)
            channel.begin(track, key, note)
        else:
            channel.release(track, message.data[0], now)

    def _move(self, channel: Channel, control: int, value: int, now: int) -> None:
        """Move a pedal, or end all notes."""
        if control == SUSTAIN or (control == RESET and channel.pedal):
            channel.pedal = value if control == SUSTAIN else 0
            if not channel.is_drums:
                self.moves.append((now, channel, channel.pedal))
        if control in (SOSTENUTO, RESET):
            channel.move_sostenuto(value if control == SOSTENUTO else 0, now)
        elif control == SOFT and value >= PEDAL_DOWN:
            self.soft.add(channel)
        elif control in ALL_OFF:
            channel.release_all(now)

    def _part(self, channel: Channel, track: int) -> Part:
        key = track, channel, channel.is_drums
        if key not in self._parts:
            self._parts[key] = Part(channel, channel.is_drums)
        return self._parts[key]


_Event = tuple[int, int, int, int, Message | Setting]


def _events(track: int, messages: Iterable[Message]) -> Iterator[_Event]:
    """Yield what is played of a track: ticks, ranks, the track, ports, messages or settings.

    What both changes a channel and moves its pedals comes twice.
    """
    port = 0
    for message in messages:
        tick, kind, data, _ = message
        if kind == PORT:
            port = data[0] if data else 0
        elif kind == SYSEX:
            if setting := setting_of(data):
                yield tick, _RESETS if setting.what == ALL else _SETS_UP, track, port, setting
        else:
            changes = kind == WHEEL or (kind == CONTROL and data[0] in SETTINGS)
            if changes:
                yield tick, _CHANGES, track, port, message
            if kind in _PLAYED and (not changes or data[0] == RESET):
                yield tick, _PLAYS, track, port, message
