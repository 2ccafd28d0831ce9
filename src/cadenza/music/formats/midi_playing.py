"""What the channels and pedals of a MIDI file play, in order of time."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

from cadenza.music.formats.midi_channels import (
    ALL,
    SETTINGS,
    Channel,
    Port,
    Setting,
    drum_banks,
    setting_of,
)
from cadenza.music.formats.midi_messages import (
    ALL_OFF,
    CONTROL,
    NAME,
    NOTE_OFF,
    NOTE_ON,
    PORT,
    PROGRAM,
    RESET,
    SOFT,
    SOSTENUTO,
    SUSTAIN,
    SYSEX,
    WHEEL,
    Message,
)
from cadenza.music.repair import RawNote
from cadenza.music.score import PEDAL_DOWN, PITCHES

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
        """Whether any of its notes lasts, unlike those that only switch something."""
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
        """Play a message of a track to a channel."""
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
