"""Messages of a process that plays or practises, and lines that the server writes to it.

A message is a kind, its length, and bytes: JSON, or rows of states. The page receives the same over
a WebSocket, JSON as text and rows as binary frames. All numbers are little-endian. An empty message
of the kind `IDLE` tells the server that the process has dropped its song and waits for another.

Rows: each (J,) float32 joints of the hands [m, rad]; (K,) uint8 how far keys are down, 255 all the
way; (K,) uint8 what sounds: 128 if the key sounds after the step, plus the MIDI velocity if it was
struck in the step; (K,) uint8 when it was struck, or else ceased to sound, in 255ths of the step;
uint8 whether the pedal is down; zeros up to a multiple of four bytes.

The process reads an order (see `cadenza.studio.request.Order`) as a line of JSON; a line that comes
while it plays has it drop the song.
"""

import json
import struct
from collections.abc import Callable
from typing import IO, Any, NamedTuple

JSON, ROWS, IDLE = b"J", b"R", b"W"
HEADER = struct.Struct("<cI")
MAX_BYTES = 1 << 26  # bytes of a message
SOUNDS = 128  # in a row, the bit of a key that sounds; lower bits are the velocity of a strike
STEP_PARTS = 255  # parts of a step, the unit of times in a row


class WireMessage(NamedTuple):
    """A message: its kind, and its content."""

    kind: bytes
    content: bytes

    def write(self, stream: IO[bytes]) -> None:
        """Write the message to a pipe at once."""
        stream.write(HEADER.pack(self.kind, len(self.content)) + self.content)
        stream.flush()


Send = Callable[[WireMessage], None]


def json_message(**content: Any) -> WireMessage:
    """A message that holds an object of JSON."""
    return WireMessage(JSON, json.dumps(content, allow_nan=False).encode())
