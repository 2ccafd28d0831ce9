"""The messages in the bytes of a MIDI file, which may be cut off, and what their numbers mean."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from cadenza.errors import CadenzaError
from cadenza.music.repair import counted_remarks

LARGEST = 127  # the largest value of a controller
BANK, VOLUME, EXPRESSION = 0, 7, 11
SUSTAIN, SOSTENUTO, SOFT = 64, 66, 67  # the pedals of a piano
AMOUNTS = frozenset((VOLUME, EXPRESSION, SUSTAIN, SOSTENUTO, SOFT))
"""The controllers whose values, where too large, can only mean the largest."""
RESET = 121  # the controller that lifts the pedals of a channel, among others
ALL_OFF = frozenset((120, *range(123, 128)))
"""The controllers that end all notes of a channel; the last four change its mode, too."""
CHANNELS, DRUM_CHANNEL = range(16), 9
"""The channels of a port, and the tenth of them, counted from 0."""
ROLAND, YAMAHA, ANY_TIME, REAL_TIME = 0x41, 0x43, 0x7E, 0x7F
"""The first bytes of system exclusive messages: of two makers, and two that are for all."""
MAKERS = frozenset(bytes([maker]) for maker in (ROLAND, YAMAHA, ANY_TIME, REAL_TIME))
"""The first bytes of the system exclusive messages that are understood."""

_NAMES = """
acoustic grand piano, bright acoustic piano, electric grand piano, honky-tonk piano, electric
piano 1, electric piano 2, harpsichord, clavinet, celesta, glockenspiel, music box, vibraphone,
marimba, xylophone, tubular bells, dulcimer, drawbar organ, percussive organ, rock organ, church
organ, reed organ, accordion, harmonica, tango accordion, nylon-string guitar, steel-string
guitar, jazz guitar, clean electric guitar, muted electric guitar, overdriven guitar, distortion
guitar, guitar harmonics, acoustic bass, fingered bass, picked bass, fretless bass, slap bass 1,
slap bass 2, synth bass 1, synth bass 2, violin, viola, cello, contrabass, tremolo strings,
pizzicato strings, orchestral harp, timpani, string ensemble 1, string ensemble 2, synth strings
1, synth strings 2, choir aahs, voice oohs, synth voice, orchestra hit, trumpet, trombone, tuba,
muted trumpet, French horn, brass section, synth brass 1, synth brass 2, soprano sax, alto sax,
tenor sax, baritone sax, oboe, English horn, bassoon, clarinet, piccolo, flute, recorder, pan
flute, blown bottle, shakuhachi, whistle, ocarina, square lead, sawtooth lead, calliope lead,
chiff lead, charang lead, voice lead, fifths lead, bass and lead, new age pad, warm pad, polysynth
pad, choir pad, bowed pad, metallic pad, halo pad, sweep pad, rain effect, soundtrack effect,
crystal effect, atmosphere effect, brightness effect, goblins effect, echoes effect, sci-fi
effect, sitar, banjo, shamisen, koto, kalimba, bagpipe, fiddle, shanai, tinkle bell, agogo, steel
drums, woodblock, taiko drum, melodic tom, synth drum, reverse cymbal, guitar fret noise, breath
noise, seashore, bird tweet, telephone ring, helicopter, applause, gunshot
"""
INSTRUMENTS = tuple(" ".join(name.split()) for name in _NAMES.split(","))
"""(128,) the instruments by their program numbers, which count from 0."""

LONGEST = 2**28 - 1  # the most ticks from one event to the next that the format can say
NOTE_OFF, NOTE_ON, CONTROL, PROGRAM, WHEEL = 0x8, 0x9, 0xB, 0xC, 0xE
"""The kinds of messages to channels: the upper halves of their status bytes."""
SYSEX, TEXT, NAME, MARKER, PORT, END = 0xF0, 0x01, 0x03, 0x06, 0x21, 0x2F
TEMPO, METRE, KEY = 0x51, 0x58, 0x59
"""The kinds of messages to a synthesizer, and of those to a player."""
_MIN_BYTES = {**dict.fromkeys((TEXT, NAME, MARKER, PORT, END, KEY), 0), TEMPO: 3, METRE: 4}
"""Bytes that messages to a player have at least."""
_TRACK = b"MTrk"
_META, _SYSEX_GOES_ON, _SYSTEM, _TO_CHANNELS = 0xFF, 0xF7, 0xF0, 0x80  # status bytes
_SHORT = (PROGRAM, 0xD)  # messages with one byte after the status; others have two
_SYSTEM_LENGTHS = {0xF1: 1, 0xF2: 2, 0xF3: 1}  # else none
_MAX_DIGITS = 8  # bytes; the format allows numbers of 4
_MAC_BINARY = 128  # bytes of a header that old Macintosh programs put before a file
_PREFIX, _HEADER = 8, 6  # bytes: name and size of any chunk; format, tracks and division


class Message(NamedTuple):
    """A message of a track at a time [ticks] since its beginning; most are to a channel, from 0."""

    tick: int
    kind: int
    data: bytes
    channel: int = 0


class MidiFile(NamedTuple):
    """The messages that are understood, by tracks, and remarks on what is missing.

    `division` is the number of ticks in a quarter, or negative if they are parts of SMPTE frames.
    """

    format: int
    division: int
    tracks: list[list[Message]]
    remarks: list[str]


def parsed(data: bytes) -> MidiFile:
    """Parse a Standard MIDI file, bare or wrapped.

    Where the length of a track is wrong, or something stands between tracks, the next one begins at
    the next `MTrk`. Raises CadenzaError if it is no MIDI file, or damaged otherwise than by an
    early end.
    """
    data = _unwrapped(data)
    if not data.startswith(b"MThd"):
        raise CadenzaError("not a MIDI file (it does not begin with MThd)")
    if min(len(data), _chunk_end(data, 0)) < _PREFIX + _HEADER:
        raise CadenzaError("the MIDI file is incomplete; download or export it again")
    form, announced, division = (
        int.from_bytes(data[_PREFIX + i :][:2], "big", signed=i == 4) for i in (0, 2, 4)
    )
    if form not in (0, 1, 2):
        raise CadenzaError(f"MIDI format {form} is unknown; give format 0, 1 or 2")
    tracks, beyond = list[_Track](), 0
    at = _after(data, _PREFIX + _HEADER, _chunk_end(data, 0))
    while at < len(data):
        end, left = _chunk_end(data, at), at + _PREFIX
        if is_track := data.startswith(_TRACK, at):
            tracks.append(track := _track(data, left, end))
            left = track.end
        at = _after(data, left, end)
        if (is_track or at != end) and any(data[left:at]):
            beyond += len(data[left:at])
    damage = sum((track.damage for track in tracks), Counter[str]())
    missing = max(0, announced - len(tracks))
    remarks = (
        (missing, "track", f"of {announced} missing: the file may be incomplete"),
        (damage["cut"], "track", "cut off: its end is missing"),
        (beyond, "byte", "after the end of a track left out"),
        (damage["clipped"], "value", "over 127 taken for 127"),
        (damage["dropped"], "setting", "with a value over 127 left out"),
        (damage["unread"], "unreadable tempo or time signature", "left out"),
    )
    return MidiFile(form, division, [track.messages for track in tracks], counted_remarks(remarks))


def _unwrapped(data: bytes) -> bytes:
    """The MIDI file in a RIFF file, or after a header of old Macintosh programs."""
    if data[_MAC_BINARY:].startswith(b"MThd"):
        return data[_MAC_BINARY:]
    if not (data.startswith(b"RIFF") and data[8:12] == b"RMID"):
        return data
    at = 12
    while at < len(data):
        size = int.from_bytes(data[at + 4 : at + _PREFIX], "little")
        if data.startswith(b"data", at):
            return data[at + _PREFIX :][:size]
        at += _PREFIX + size + size % 2  # RIFF pads to even sizes
    return b""


def _chunk_end(data: bytes, at: int) -> int:
    """Where the chunk that begins at a byte says that it ends."""
    return at + _PREFIX + int.from_bytes(data[at + 4 : at + _PREFIX], "big")


def _begins_chunk(data: bytes, at: int) -> bool:
    """Whether a chunk seems to begin at a byte, or nothing is left there."""
    if at >= len(data) or data.startswith(_TRACK, at):
        return True
    return data[at : at + 4].isalnum() and _chunk_end(data, at) <= len(data)


def _after(data: bytes, position: int, end: int) -> int:
    """Where the next chunk begins, if one was read up to `position` and should end at `end`."""
    is_end = position <= end and _begins_chunk(data, end) and data.find(_TRACK, position, end) < 0
    return end if is_end else _next_track(data, position)


def _next_track(data: bytes, at: int) -> int:
    """Where the next track begins, or all ends."""
    place = data.find(_TRACK, at)
    return len(data) if place < 0 else place


def _track(data: bytes, begin: int, end: int) -> _Track:
    """The track from one byte to another, or to its end; raises CadenzaError if it is damaged."""
    track = _Track(data, begin, end)
    if track.has_ended or _begins_chunk(data, end):
        return track
    following = _next_track(data, end)
    try:
        longer = _Track(data, begin, following)
    except CadenzaError:  # what comes then is none of its messages
        return track
    is_whole = longer.has_ended or (following < len(data) and not longer.damage["cut"])
    return longer if is_whole or not track.messages else track


class _Track:
    """The messages from a byte on: up to the end of the track, the next track, or a last byte.

    `end` is where they end, and `damage` counts what is cut off, clipped to 127, dropped for values
    over 127, or unread. Raises CadenzaError if the track is damaged.
    """

    def __init__(self, data: bytes, begin: int, last: int) -> None:
        self.messages: list[Message] = []
        self.damage = Counter[str]()
        self.end = begin
        self._data = data
        self._last = min(last, len(data))
        try:
            self._read()
            self.damage["cut"] = int(self.end == len(data) < last and not self.has_ended)
        except EOFError:
            self.damage["cut"] = 1
            self.end = self._last

    @property
    def has_ended(self) -> bool:
        """Whether the last message says that the track ends."""
        return bool(self.messages) and self.messages[-1].kind == END

    def _read(self) -> None:
        running = 0  # the status of the latest message to a channel, which holds until another
        tick = 0
        while self.end < self._last and not self.has_ended:
            if self._data.startswith(_TRACK, self.end):
                return
            tick += (wait := self._number())
            if wait > LONGEST:
                raise _damaged("a time is too long")
            status = self._bytes(1)[0]
            if status == _META:
                self._read_meta(tick)
            elif status in (SYSEX, _SYSEX_GOES_ON):
                content = self._bytes(self._number()).removesuffix(b"\xf7")
                if status == SYSEX and content[:1] in MAKERS and content.isascii():
                    self.messages.append(Message(tick, SYSEX, content))
            elif status >= _SYSTEM:
                self._bytes(_SYSTEM_LENGTHS.get(status, 0))
            else:
                if status < _TO_CHANNELS:
                    self.end -= 1
                    status = running
                running = status
                if not running:
                    raise _damaged("a message without a status byte")
                self._read_message(tick, status >> 4, status & 0x0F)

    def _read_meta(self, tick: int) -> None:
        """Read a message to a player: a text, name, port, end, tempo, metre or key."""
        kind = self._bytes(1)[0]
        content = self._bytes(self._number())
        if kind not in _MIN_BYTES:
            return
        if len(content) < _MIN_BYTES[kind] or (kind == TEMPO and not any(content[:3])):
            self.damage["unread"] += 1
        else:
            self.messages.append(Message(tick, kind, content))

    def _read_message(self, tick: int, kind: int, channel: int) -> None:
        """Read a message to a channel, if it does not set something to a value that is damaged."""
        content = self._bytes(1 if kind in _SHORT else 2)
        if not content.isascii():
            is_control = kind == CONTROL and content[0] in AMOUNTS
            if not is_control and kind not in (NOTE_OFF, NOTE_ON):
                self.damage["dropped"] += 1
                return
            self.damage["clipped"] += sum(byte > LARGEST for byte in content)
            content = bytes(min(byte, LARGEST) for byte in content)
        self.messages.append(Message(tick, kind, content, channel))

    def _bytes(self, size: int) -> bytes:
        """The next bytes; raises EOFError if fewer are left."""
        begin, self.end = self.end, self.end + size
        if self.end > self._last:
            raise EOFError
        return self._data[begin : self.end]

    def _number(self) -> int:
        """The next number: seven bits a byte; the last byte has its highest bit unset."""
        number = 0
        for _ in range(_MAX_DIGITS):
            byte = self._bytes(1)[0]
            number = number << 7 | byte & 0x7F
            if byte < 0x80:
                return number
        raise _damaged("a number has too many bytes")


def _damaged(reason: str) -> CadenzaError:
    return CadenzaError(f"the MIDI file is damaged ({reason})")
