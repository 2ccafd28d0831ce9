"""Whatever a MIDI file has many of, reading it takes time in proportion."""

import struct
from collections import Counter
from functools import partial

import pytest

from cadenza.music.formats.midi import read_midi
from cadenza.music.repair import RawNote, repaired_notes
from proportion import grows_in_proportion

QUARTER = 960  # ticks: songs are short, however much they have

NOTE = bytes([0, 0x90, 60, 80, 10, 0x80, 60, 0])
END = bytes([0, 0xFF, 0x2F, 0])
ON, OFF = bytes([0, 0x90, 60, 80]), bytes([0, 0x80, 60, 0])
ZONE = bytes([0, 0xB0, 101, 0, 0, 0xB0, 100, 6, 0, 0xB0, 6, 15])


def meta(kind, content, wait=0):
    return bytes([wait, 0xFF, kind, len(content), *content])


def system(text):
    data = bytes.fromhex(text)
    return bytes([0, 0xF0, len(data) + 1, *data, 0xF7])


def track(events):
    return b"MTrk" + struct.pack(">L", len(events + END)) + events + END


def many(events, before=b"", after=b""):
    """A file of one track that repeats `events`."""
    return lambda n: track(before + events * n + after + NOTE)


def controllers(*numbers):
    return b"".join(bytes([1, 0xB0, k, value]) for value in (0, 127) for k in numbers)


def channels_of_ports(n):
    """A pedal in each of 16 channels of up to 256 ports, then a pedal that moves."""
    ports = (meta(0x21, [p]) + b"".join(bytes([0, 0xB0 + c, 64, 1]) for c in range(16))
             for p in range(min(n // 16, 256)))  # fmt: skip
    return b"".join(map(track, ports)) + track(controllers(64) * n + NOTE)


KINDS = {
    "notes that begin together": lambda n: track(ON * n + bytes([10]) + OFF[1:] + OFF * (n - 1)),
    "notes of one pitch that overlap": lambda n: track((b"\x01" + ON[1:]) * n + OFF * n),
    "notes that nothing ends": many(b"\1" + ON[1:]),
    "notes all ended at once": many(ON * 2 + bytes([1, 0xB0, 123, 0])),
    "notes after each other": many(NOTE),
    "notes of no length": many(ON + OFF),
    "notes outside the keyboard": many(NOTE.replace(bytes([60]), bytes([2]))),
    "note-offs": many(OFF),
    "controllers": many(controllers(1, 7, 11, 91)),
    "pedals of two channels": many(controllers(64) + bytes([1, 0xB1, 64, 90])),
    "sostenuto": many(ON + controllers(66) + OFF),
    "captured notes": lambda n: track(bytes([0, 0xB0, 66, 127]) + NOTE * n + controllers(66)),
    "resets": many(controllers(121)),
    "banks": many(bytes([1, 0xB0, 0, 120, 0, 0xB0, 0, 0]) + NOTE),
    "tunings": many(controllers(101, 100, 6) + NOTE),
    "bends": many(bytes([1, 0xE0, 0, 127, 1, 0xE0, 0, 0]) + NOTE),
    "bends of an MPE zone": many(bytes([1, 0xE0, 0, 127, 1, 0xE0, 0, 0]), before=ZONE + ON),
    "MPE zones": many(ZONE),
    "tempo changes": many(meta(0x51, [7, 0xA1, 0x20], wait=1)),
    "metres": many(meta(0x58, [255, 2, 24, 8], wait=1)),
    "programs": many(bytes([1, 0xC0, 5])),
    "lyrics": many(meta(0x05, b"la " * 9)),
    "texts of a track": many(meta(0x01, b"MTrk")),
    "names": many(meta(0x03, b"piano")),
    "ports": many(meta(0x21, [1]) + NOTE + meta(0x21, [2])),
    "system messages": many(system("41 10 42 12 40 00 05 45 76") + system("7E 7F 09 01")),
    "a long system message": lambda n: track(
        bytes([0, 0xF0, 0x80 | n >> 14, 0x80 | n >> 7 & 0x7F, n & 0x7F]) + b"A" * n + NOTE
    ),
    "tracks": lambda n: track(NOTE) * n,
    "tracks without an end": lambda n: (b"MTrk" + struct.pack(">L", 2**31) + NOTE) * n,
    "tracks of no length": lambda n: (b"MTrk" + bytes(4) + NOTE + b"\xf9") * n,
    "chunks of other kinds": lambda n: (b"XFIH" + struct.pack(">L", 4) + NOTE[:4]) * n
    + track(NOTE),
    "bytes between tracks": lambda n: (track(NOTE) + b"\0\1\2\3" * 4) * n,
    "channels of ports": channels_of_ports,
}  # fmt: skip


@pytest.mark.parametrize("few", [400, pytest.param(4_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_reading_takes_time_in_proportion(tmp_path, kind, few):
    def work(n):
        header = b"MThd" + struct.pack(">LHHH", 6, 1, 1, QUARTER)
        (tmp_path / "a.mid").write_bytes(header + KINDS[kind](n))
        return partial(read_midi, tmp_path / "a.mid")

    assert grows_in_proportion(work, few)


@pytest.mark.parametrize("tracks", [1, 1_000_000])
def test_merging_doubled_notes_takes_time_in_proportion(tracks):
    def work(n):
        notes = [RawNote(0, 1, 60, 80, True, tracks=(i % tracks,)) for i in range(n)]
        return partial(repaired_notes, notes, Counter(), ())

    assert grows_in_proportion(work, 6_000)
