"""The channels of a port that a MIDI file plays: their notes, drums, tuning and volume."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf
from operator import itemgetter
from typing import NamedTuple

from cadenza.music.formats.general_midi import CHANNELS, DRUM_CHANNEL, LARGEST
from cadenza.music.formats.midi_synthesizers import Sets, Setting
from cadenza.music.formats.midi_tuning import BEND_RANGE, MEMBER_RANGE, USUAL_RANGE, ZONE, Tuning
from cadenza.music.repair import RawNote
from cadenza.music.score import PEDAL_DOWN, PITCHES

_MELODIC_BANK, _DRUM_BANK = 121, 120  # of General MIDI 2
_XG_DRUM_BANKS = (126, 127)
_MANAGERS = CHANNELS[0], CHANNELS[-1]  # of MPE zones of the channels above and below them


class Channel(NamedTuple):
    """A channel of a port, which another port has as well; both count from 0."""

    port: int
    number: int


@dataclass(slots=True)
class Part:
    """The music of one channel in one track of the file.

    `muted` are notes during which the channel has no volume. `outside` counts notes that no key
    plays, and `bent` those that the pitch wheel takes between keys.
    """

    channel: Channel
    is_drums: bool = False
    name: str = ""
    program: int | None = None
    notes: list[RawNote] = field(default_factory=list)
    muted: list[RawNote] = field(default_factory=list)
    outside: int = 0
    bent: int = 0

    @property
    def sounds(self) -> bool:
        """Whether any of its notes lasts, unlike those that only switch something."""
        return any(note.end > note.start for note in (*self.notes, *self.muted))

    def finish(self, end: int, state: State) -> None:
        """Ends notes that nothing has released, bends them, and sets apart what is not heard."""
        found, self.notes = self.notes, []
        for note in found:
            note.end = note.end if note.released else end
            if not self.is_drums:
                semitones, is_exact = state.tuning.bend_of(note.start, note.end)
                note.pitch += semitones
                self.bent += not is_exact
            if note.pitch not in PITCHES:
                self.outside += 1
                continue
            span = bisect_right(state.silences, note.start, key=itemgetter(0)) - 1
            is_muted = span >= 0 and note.start < state.silences[span][1] >= note.end
            (self.muted if is_muted else self.notes).append(note)


@dataclass(slots=True)
class State:
    """A channel while the file is played.

    Whether it plays drums, a message to the synthesizer says, or else its bank of sounds.
    `silences` are the spans without volume. `sounding` are notes in the order in which they began,
    by key, and `of_track` the same by track and key; those released by way of the other are
    still there. The sostenuto pedal went down at the time `sostenuto`, None if it is up, and goes
    on to hold `captured`, notes that were released since.
    """

    has_drum_bank: bool = False
    is_drum_part: bool | None = None
    tuning: Tuning = field(default_factory=Tuning)
    pedal: int = 0
    volume: int = LARGEST
    expression: int = LARGEST
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

    def begin(self, track: int, key: int, note: RawNote) -> None:
        """Begins the note of a key."""
        self.sounding[key].append(note)
        self.of_track[track, key].append(note)

    def release(self, track: int, key: int, now: int) -> None:
        """Ends the oldest note of this key in a track; if there is none, the oldest of all."""
        for waiting in (self.of_track[track, key], self.sounding[key]):
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


@dataclass(slots=True)
class Port:
    """The channels of a port, and what holds for all of them.

    All melodies are transposed by `key_shift` [semitones]. `managers` are those of the members of
    MPE zones, by the numbers of channels.
    """

    states: list[State]
    key_shift: int = 0
    managers: dict[int, int] = field(default_factory=dict)

    @classmethod
    def new(cls) -> Port:
        """A port after its synthesizer is switched on."""
        return cls([State(number == DRUM_CHANNEL) for number in CHANNELS])

    def is_drums(self, number: int) -> bool:
        """Whether a channel plays drums."""
        return self.states[number].is_drums and number not in self.managers

    def shift(self, number: int) -> int:
        """The transposition of the notes of a channel [semitones]."""
        tuning = self.states[number].tuning
        own = tuning.coarse + tuning.key_shift
        return 0 if self.is_drums(number) else own + self.key_shift

    def set_up(self, setting: Setting, now: int) -> None:
        """Sets up the synthesizer."""
        what, value, channel = setting
        if what is Sets.ALL:
            self.key_shift, self.managers = 0, {}
            for number, state in enumerate(self.states):
                state.has_drum_bank, state.is_drum_part = number == DRUM_CHANNEL, None
                state.tuning = Tuning(bends=state.tuning.bends)
        elif channel is None:
            self.key_shift = value
        elif what is Sets.DRUMS:
            self.states[channel].is_drum_part = value > 0
        elif what is Sets.KEY_SHIFT:
            self.states[channel].tuning.key_shift = value
        else:
            self.states[channel].tuning.bend_range = value
        self._record_bends(now)

    def set_parameter(self, number: int, control: int, value: int, now: int) -> None:
        """Chooses or sets a registered parameter of a channel, or of its MPE zone."""
        parameter = self.states[number].tuning.control(control, value)
        if parameter == ZONE and number in _MANAGERS:
            members = {other for other in CHANNELS if 0 < abs(other - number) <= value}
            taken = members | {number}
            kept = {of: by for of, by in self.managers.items() if not taken.intersection((of, by))}
            self.managers = kept | dict.fromkeys(members, number)
            for other in taken:
                usual = USUAL_RANGE if other == number else MEMBER_RANGE
                self.states[other].tuning.bend_range = usual
        elif parameter == BEND_RANGE and number in self.managers:
            for other, manager in self.managers.items():
                if manager == self.managers[number]:
                    same = self.states[number].tuning.bend_range
                    self.states[other].tuning.bend_range = same
        if parameter in (ZONE, BEND_RANGE):
            self._record_bends(now)

    def turn_wheel(self, number: int, wheel: float, now: int) -> None:
        """Turns the pitch wheel of a channel, and with that of a manager all of its MPE zone."""
        if wheel != self.states[number].tuning.wheel:
            self.states[number].tuning.wheel = wheel
            members = (other for other, manager in self.managers.items() if manager == number)
            self._record_bends(now, (number, *members))

    def _record_bends(self, now: int, numbers: Iterable[int] = CHANNELS) -> None:
        for number in numbers:
            manager = self.managers.get(number)
            of_zone = 0.0 if manager is None else self.states[manager].tuning.bend
            self.states[number].tuning.record(now, of_zone)

    def select_bank(self, number: int, bank: int, is_roland: bool) -> None:
        """Has a channel play drums, or no longer, as its bank of sounds is one of them or not."""
        state = self.states[number]
        if bank == _DRUM_BANK or (bank in _XG_DRUM_BANKS and not is_roland):
            state.has_drum_bank = True
        elif bank == _MELODIC_BANK or number != DRUM_CHANNEL:
            state.has_drum_bank = False
