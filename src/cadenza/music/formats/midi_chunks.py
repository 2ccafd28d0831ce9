"""The tracks in the bytes of a MIDI file, which may be cut off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import mido
from mido.midifiles.meta import build_meta_message

from cadenza.errors import CadenzaError
from cadenza.music.repair import counted_remarks

_NAME, _END, _TEMPO, _TIME = 0x03, 0x2F, 0x51, 0x58
_WANTED = (_NAME, _END, _TEMPO, _TIME)
_META = 0xFF
_SYSEX = (0xF0, 0xF7)
_END_OF_SYSEX = b"\xf7"
_MAKERS = (b"\x41", b"\x43")  # Roland and Yamaha
_CHANNELS = range(0x80, 0xF0)  # the status bytes of messages to a channel
_LENGTHS = {0xC: 1, 0xD: 1}  # bytes after the status, by its upper half; else two
_SYSTEM_LENGTHS = {0xF1: 1, 0xF2: 2, 0xF3: 1}  # else none
_LONGEST_NUMBER = 8  # bytes; the format allows numbers of 4
_MAC_BINARY = 128  # bytes of a header that old Macintosh programs put before a file
_HEADER = 6  # bytes


@dataclass(frozen=True, slots=True)
class MidiFile:
    """Messages to channels and synthesizers, names, tempos, time signatures and ends, by tracks."""

    format: int
    division: int
    tracks: list[mido.MidiTrack]
    remarks: list[str]


def parsed(data: bytes) -> MidiFile:
    """The tracks of a Standard MIDI file, bare or wrapped, with remarks on missing parts.

    Raises:
        CadenzaError: it is no MIDI file, or damaged otherwise than by an early end.
    """
    data = _unwrapped(data)
    if not data.startswith(b"MThd"):
        raise CadenzaError("not a MIDI file (it does not begin with MThd)")
    header, *chunks = _chunks(data, "big")
    if len(header.data) < _HEADER:
        raise CadenzaError("the MIDI file is incomplete; download or export it again")
    form, said, division = (
        int.from_bytes(header.data[i : i + 2], "big", signed=i == 4) for i in (0, 2, 4)
    )
    if form not in (0, 1, 2):
        raise CadenzaError(f"MIDI format {form} is unknown; give format 0, 1 or 2")
    tracks = [_Track(chunk) for chunk in chunks if chunk.name == b"MTrk"]
    remarks = (
        (max(0, said - len(tracks)), "track", f"of {said} missing: the file may be incomplete"),
        (sum(track.is_cut for track in tracks), "track", "cut off: its end is missing"),
        (sum(track.beyond for track in tracks), "byte", "after the end of a track left out"),
        (sum(track.clipped for track in tracks), "value", "over 127 taken for 127"),
        (sum(track.unread for track in tracks), "unreadable tempo or time signature", "left out"),
    )
    return MidiFile(form, division, [track.messages for track in tracks], counted_remarks(remarks))


@dataclass(frozen=True, slots=True)
class _Chunk:
    name: bytes
    data: bytes
    is_whole: bool


def _unwrapped(data: bytes) -> bytes:
    if data[_MAC_BINARY:].startswith(b"MThd"):
        return data[_MAC_BINARY:]
    if data.startswith(b"RIFF") and data[8:12] == b"RMID":
        chunks = _chunks(data[12:], "little")
        return next((chunk.data for chunk in chunks if chunk.name == b"data"), b"")
    return data


def _chunks(data: bytes, order: Literal["big", "little"]) -> Iterator[_Chunk]:
    """Yields chunks of a name, a size and as many bytes: big-endian in MIDI, little in RIFF."""
    at = 0
    while at < len(data):
        size = int.from_bytes(data[at + 4 : at + 8], order)
        begin, end = at + 8, at + 8 + size
        yield _Chunk(data[at : at + 4], data[begin:end], end <= len(data))
        at = end + (size % 2 if order == "little" else 0)  # RIFF pads to even sizes


class _Track:
    """Reads the chunk of a track up to its end."""

    def __init__(self, chunk: _Chunk) -> None:
        """Reads the messages.

        Raises:
            CadenzaError: the track is damaged.
        """
        self.messages = mido.MidiTrack()
        self.clipped = 0  # data bytes that are none
        self.unread = 0  # names, tempos and time signatures that cannot be read
        self._data = chunk.data
        self._at = 0
        try:
            self._read()
            self.is_cut = not (chunk.is_whole or self._has_ended)
        except EOFError:
            self.is_cut = True
        except Exception as error:  # damaged bytes make mido raise almost anything
            reason = " ".join(str(error).split()) or type(error).__name__
            raise CadenzaError(f"the MIDI file is damaged ({reason})") from error
        beyond = self._data[self._at :]
        self.beyond = len(beyond) if any(beyond) and not self.is_cut else 0

    @property
    def _has_ended(self) -> bool:
        return bool(self.messages) and self.messages[-1].type == "end_of_track"

    def _read(self) -> None:
        running = None  # the status of the latest message to a channel, which holds until another
        delta = 0  # since the latest message that is kept
        while self._at < len(self._data) and not self._has_ended:
            delta += self._number()
            status = self._bytes(1)[0]
            if status == _META:
                kind = self._bytes(1)[0]
                content = self._bytes(self._number())
                message = self._meta_message(kind, content) if kind in _WANTED else None
                if message is None:
                    continue
            elif status in _SYSEX:
                content = self._bytes(self._number())
                message = self._sysex(content) if status == _SYSEX[0] else None
                if message is None:
                    continue
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
                content = self._bytes(_LENGTHS.get(status >> 4, 2))
                self.clipped += sum(byte > 127 for byte in content)
                message = mido.Message.from_bytes([status, *(min(byte, 127) for byte in content)])
            message.time, delta = delta, 0
            self.messages.append(message)

    def _meta_message(self, kind: int, content: bytes) -> mido.MetaMessage | None:
        """The meta message of a name, end, tempo or time signature; None if it cannot be read."""
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
        if data[:1] not in _MAKERS or not data.isascii():
            return None
        return mido.Message("sysex", data=data)

    def _bytes(self, size: int) -> bytes:
        """The next bytes.

        Raises:
            EOFError: fewer are left.
        """
        begin, self._at = self._at, self._at + size
        if self._at > len(self._data):
            raise EOFError
        return self._data[begin : self._at]

    def _number(self) -> int:
        """The next number: seven bits a byte, of which the last has its highest bit unset."""
        number = 0
        for _ in range(_LONGEST_NUMBER):
            byte = self._bytes(1)[0]
            number = number << 7 | byte & 0x7F
            if byte < 0x80:
                return number
        raise ValueError("a number has too many bytes")
