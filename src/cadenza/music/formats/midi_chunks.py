"""The tracks in the bytes of a MIDI file, which may be cut off."""

from __future__ import annotations

from dataclasses import dataclass

import mido
from mido.midifiles.meta import build_meta_message

from cadenza.errors import CadenzaError
from cadenza.music.formats.general_midi import AMOUNTS, LARGEST
from cadenza.music.formats.midi_synthesizers import MAKERS
from cadenza.music.repair import counted_remarks

LONGEST = 2**28 - 1
"""The most ticks from one event to the next that the format can say."""
_TRACK = b"MTrk"
_NAME, _PORT, _END, _TEMPO, _TIME = 0x03, 0x21, 0x2F, 0x51, 0x58
_WANTED = (_NAME, _PORT, _END, _TEMPO, _TIME)
_META = 0xFF
_SYSEX = (0xF0, 0xF7)
_END_OF_SYSEX = b"\xf7"
_CHANNELS = range(0x80, 0xF0)  # the status bytes of messages to a channel
_NOTES, _CONTROL = (0x8, 0x9), 0xB  # their upper halves
_LENGTHS = {0xC: 1, 0xD: 1}  # bytes after the status, by its upper half; else two
_SYSTEM_LENGTHS = {0xF1: 1, 0xF2: 2, 0xF3: 1}  # else none
_MAX_DIGITS = 8  # bytes; the format allows numbers of 4
_MAC_BINARY = 128  # bytes of a header that old Macintosh programs put before a file
_PREFIX, _HEADER = 8, 6  # bytes: name and size of any chunk; format, tracks and division


@dataclass(frozen=True, slots=True)
class MidiFile:
    """Messages to channels and synthesizers, names, ports, tempos, metres and ends, by tracks."""

    format: int
    division: int
    tracks: list[mido.MidiTrack]
    remarks: list[str]


def parsed(data: bytes) -> MidiFile:
    """The tracks of a Standard MIDI file, bare or wrapped, with remarks on missing parts.

    Where the length of a track is wrong, or something stands between tracks, the next one begins
    where it is found.

    Raises:
        CadenzaError: it is no MIDI file, or damaged otherwise than by an early end.
    """
    data = _unwrapped(data)
    if not data.startswith(b"MThd"):
        raise CadenzaError("not a MIDI file (it does not begin with MThd)")
    if min(len(data), _chunk_end(data, 0)) < _PREFIX + _HEADER:
        raise CadenzaError("the MIDI file is incomplete; download or export it again")
    form, said, division = (
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
    remarks = (
        (max(0, said - len(tracks)), "track", f"of {said} missing: the file may be incomplete"),
        (sum(track.is_cut for track in tracks), "track", "cut off: its end is missing"),
        (beyond, "byte", "after the end of a track left out"),
        (sum(track.clipped for track in tracks), "value", "over 127 taken for 127"),
        (sum(track.dropped for track in tracks), "setting", "with a value over 127 left out"),
        (sum(track.unread for track in tracks), "unreadable tempo or time signature", "left out"),
    )
    return MidiFile(form, division, [track.messages for track in tracks], counted_remarks(remarks))


def _unwrapped(data: bytes) -> bytes:
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


def _after(data: bytes, left: int, end: int) -> int:
    """Where the chunk after another begins, which was read up to `left` and should end at `end`."""
    is_end = left <= end and _begins_chunk(data, end) and data.find(_TRACK, left, end) < 0
    return end if is_end else _next_track(data, left)


def _next_track(data: bytes, at: int) -> int:
    """Where the next track begins, or all ends."""
    found = data.find(_TRACK, at)
    return len(data) if found < 0 else found


def _track(data: bytes, begin: int, end: int) -> _Track:
    """The track from one byte to another, or beyond where this is not its end.

    Raises:
        CadenzaError: the track is damaged.
    """
    track = _Track(data, begin, end)
    if track.has_ended or _begins_chunk(data, end):
        return track
    following = _next_track(data, end)
    try:
        longer = _Track(data, begin, following)
    except CadenzaError:  # what comes then is none of its messages
        return track
    is_whole = longer.has_ended or (following < len(data) and not longer.is_cut)
    return longer if is_whole or not track.messages else track


class _Track:
    """Reads the messages of a track up to its end, to the beginning of another, or to a byte."""

    def __init__(self, data: bytes, begin: int, end: int) -> None:
        """Reads the messages.

        Raises:
            CadenzaError: the track is damaged.
        """
        self.messages = mido.MidiTrack()
        self.clipped = 0  # data bytes over 127 that are taken for 127
        self.dropped = 0  # messages that are left out because of such bytes
        self.unread = 0  # names, tempos and time signatures that cannot be read
        self._data = data
        self._at = begin
        self._end = min(end, len(data))
        try:
            self._read()
            self.is_cut = self._at == len(data) < end and not self.has_ended
        except EOFError:
            self.is_cut = True
            self._at = self._end
        except Exception as error:  # damaged bytes make mido raise almost anything
            reason = " ".join(str(error).split()) or type(error).__name__
            raise CadenzaError(f"the MIDI file is damaged ({reason})") from error

    @property
    def end(self) -> int:
        """Where the messages end."""
        return self._at

    @property
    def has_ended(self) -> bool:
        """Whether the last message says that the track ends."""
        return bool(self.messages) and self.messages[-1].type == "end_of_track"

    def _read(self) -> None:
        running = None  # the status of the latest message to a channel, which holds until another
        delta = 0  # since the latest message that is kept
        while self._at < self._end and not self.has_ended:
            if self._data.startswith(_TRACK, self._at):
                return
            delta += (after := self._number())
            if after > LONGEST:
                raise ValueError("a time is too long")
            status = self._bytes(1)[0]
            if status == _META:
                kind = self._bytes(1)[0]
                content = self._bytes(self._number())
                message = self._meta_message(kind, content) if kind in _WANTED else None
            elif status in _SYSEX:
                content = self._bytes(self._number())
                message = self._sysex(content) if status == _SYSEX[0] else None
            elif status >= _CHANNELS.stop:
                self._bytes(_SYSTEM_LENGTHS.get(status, 0))
                continue
            else:
                if status < _CHANNELS.start:
                    if running is None:
                        raise ValueError("a message without a status byte")
                    self._at -= 1
                    status = running
                running = status
                message = self._channel_message(status, self._bytes(_LENGTHS.get(status >> 4, 2)))
            if message is not None:
                message.time, delta = delta, 0
                self.messages.append(message)

    def _channel_message(self, status: int, content: bytes) -> mido.Message | None:
        """The message to a channel; None if it sets something to a value that is damaged."""
        if not content.isascii():
            is_amount = status >> 4 in _NOTES or (status >> 4 == _CONTROL and content[0] in AMOUNTS)
            if not is_amount:
                self.dropped += 1
                return None
            self.clipped += sum(byte > LARGEST for byte in content)
            content = bytes(min(byte, LARGEST) for byte in content)
        return mido.Message.from_bytes([status, *content])

    def _meta_message(self, kind: int, content: bytes) -> mido.MetaMessage | None:
        """The meta message of a name, port, end, tempo or metre; None if it cannot be read."""
        try:
            message = build_meta_message(kind, content)
            if kind == _TEMPO and not message.tempo:
                raise ValueError("a tempo of zero")
            return message
        except Exception:  # mido raises almost anything
            self.unread += 1
            return None

    @staticmethod
    def _sysex(content: bytes) -> mido.Message | None:
        """The message to a synthesizer of a maker that is understood, if it is whole."""
        data = content.removesuffix(_END_OF_SYSEX)
        if data[:1] not in MAKERS or not data.isascii():
            return None
        return mido.Message("sysex", data=data)

    def _bytes(self, size: int) -> bytes:
        """The next bytes.

        Raises:
            EOFError: fewer are left.
        """
        begin, self._at = self._at, self._at + size
        if self._at > self._end:
            raise EOFError
        return self._data[begin : self._at]

    def _number(self) -> int:
        """The next number: seven bits a byte, of which the last has its highest bit unset."""
        number = 0
        for _ in range(_MAX_DIGITS):
            byte = self._bytes(1)[0]
            number = number << 7 | byte & 0x7F
            if byte < 0x80:
                return number
        raise ValueError("a number has too many bytes")
