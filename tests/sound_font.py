"""A sound font of one wave, written by hand."""

import struct

import numpy as np

RATE, PITCH, PERIODS = 44_100, 69, 440  # one second of a sine of 440 Hz, which is looped
_SILENCE = 46  # samples that have to follow a wave
_KEY_RANGE, _LOOPED, _INSTRUMENT, _SAMPLE = 43, 54, 41, 53  # generators


def sine_font() -> bytes:
    """A sound font (SF2) whose only instrument is a sine."""
    wave = np.sin(2 * np.pi * PERIODS * np.arange(RATE) / RATE)
    samples = np.append((16_000 * wave).astype("<i2"), np.zeros(_SILENCE, "<i2"))

    def name(text: str) -> bytes:
        return text.encode().ljust(20, b"\0")

    def bags(generators: int) -> bytes:
        return struct.pack("<4H", 0, 0, generators, 0)

    def generators(*pairs: tuple[int, int]) -> bytes:
        return b"".join(struct.pack("<2H", *pair) for pair in (*pairs, (0, 0)))

    sample = struct.pack("<5I2B2H", 0, RATE, 0, RATE, RATE, PITCH, 0, 0, 1)
    presets = name("Sine") + struct.pack("<3H3I", 0, 0, 0, 0, 0, 0)
    presets += name("EOP") + struct.pack("<3H3I", 0, 0, 1, 0, 0, 0)
    data = {
        b"phdr": presets,
        b"pbag": bags(1),
        b"pmod": bytes(10),
        b"pgen": generators((_INSTRUMENT, 0)),
        b"inst": name("Sine") + struct.pack("<H", 0) + name("EOI") + struct.pack("<H", 1),
        b"ibag": bags(3),
        b"imod": bytes(10),
        b"igen": generators((_KEY_RANGE, 127 << 8), (_LOOPED, 1), (_SAMPLE, 0)),
        b"shdr": name("Sine") + sample + name("EOS") + bytes(26),
    }
    info = _chunk(b"ifil", struct.pack("<2H", 2, 1))
    info += _chunk(b"isng", b"EMU8000\0") + _chunk(b"INAM", b"Sine\0\0")
    parts = (
        (b"INFO", info),
        (b"sdta", _chunk(b"smpl", samples.tobytes())),
        (b"pdta", b"".join(_chunk(kind, content) for kind, content in data.items())),
    )
    return _chunk(b"RIFF", b"sfbk" + b"".join(_chunk(b"LIST", kind + c) for kind, c in parts))


def _chunk(kind: bytes, content: bytes) -> bytes:
    return kind + struct.pack("<I", len(content)) + content + bytes(len(content) % 2)
