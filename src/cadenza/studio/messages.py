"""What a process that plays says: JSON, and rows of the episode.

A message is a kind, its length, and bytes. The page hears the same over a WebSocket, JSON as text
and rows as binary frames. All numbers are little-endian. An empty one of the third kind tells the
server that the process has put its song down and waits for another.

Rows: each (J,) float32 joints of the hands [m, rad]; (K,) uint8 how far keys are down, 255 all the
way; (K,) uint8 what sounds: 0 nothing, 1 what sounded before, else a key struck now, and its MIDI
velocity; uint8 whether the pedal is down; zeros up to a multiple of four bytes.

It is told an order (see `cadenza.studio.request.Order`) as a line of JSON, and while it plays that,
to `WAIT` and to `GO_ON`; any other line has it put the song down.
"""

from __future__ import annotations

import struct
from typing import IO, NamedTuple

JSON, ROWS, READY = b"J", b"R", b"W"
WAIT, GO_ON = b"wait\n", b"go on\n"
HEADER = struct.Struct("<cI")
MOST_BYTES = 1 << 26  # of a message


class Message(NamedTuple):
    """Its kind and what it says."""

    kind: bytes
    content: bytes

    def write(self, stream: IO[bytes]) -> None:
        """To a process that reads it."""
        stream.write(HEADER.pack(self.kind, len(self.content)) + self.content)
        stream.flush()


def row_bytes(num_joints: int, num_keys: int) -> int:
    """The size of a row."""
    size = 4 * num_joints + 2 * num_keys + 1
    return size + -size % 4
