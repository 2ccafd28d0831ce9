"""What system exclusive messages of a MIDI file say of drums and tuning: universal, GS and XG."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from enum import Enum, auto
from typing import NamedTuple

from cadenza.music.formats.general_midi import CHANNELS, DRUM_CHANNEL

_ROLAND, _YAMAHA, _ANY_TIME, _REAL_TIME = 0x41, 0x43, 0x7E, 0x7F
MAKERS = frozenset(bytes([maker]) for maker in (_ROLAND, _YAMAHA, _ANY_TIME, _REAL_TIME))
"""The first bytes of the messages that are understood."""
_GS, _XG = (_ROLAND, 0x42, 0x12), (_YAMAHA, 0x4C)  # messages that set the value of an address
_SIZES = {_ROLAND: 6, _YAMAHA: 5, _ANY_TIME: 2, _REAL_TIME: 4}  # bytes of maker and address
_KEEPS, _MOST = 0x40, 24  # the value that transposes by nothing; semitones by which GS and XG do
_GS_CHANNELS = (DRUM_CHANNEL, *(number for number in CHANNELS if number != DRUM_CHANNEL))


class Sets(Enum):
    """What a message sets."""

    ALL = auto()
    """Everything, to what it was at first."""
    DRUMS = auto()
    """Whether a channel plays drums."""
    KEY_SHIFT = auto()
    """The transposition of a channel, or of all of them [semitones]."""
    BEND_RANGE = auto()
    """The largest bend of the pitch wheel of a channel [semitones]."""


class Setting(NamedTuple):
    """A setting of one channel, or of all where `channel` is None."""

    what: Sets
    value: int
    channel: int | None


_ADDRESSES: dict[tuple[int, ...], tuple[Sets, int | None]] = {
    (_ANY_TIME, 0x09): (Sets.ALL, None),
    (_REAL_TIME, 0x04, 0x04, 0x00): (Sets.KEY_SHIFT, None),
    (*_GS, 0x40, 0x00, 0x7F): (Sets.ALL, None),
    (*_GS, 0x40, 0x00, 0x05): (Sets.KEY_SHIFT, None),
    **{(*_GS, 0x40, 0x10 + part, 0x15): (Sets.DRUMS, n) for part, n in enumerate(_GS_CHANNELS)},
    **{(*_GS, 0x40, 0x10 + part, 0x16): (Sets.KEY_SHIFT, n) for part, n in enumerate(_GS_CHANNELS)},
    **{
        (*_GS, 0x40, 0x20 + part, 0x10): (Sets.BEND_RANGE, n) for part, n in enumerate(_GS_CHANNELS)
    },
    (*_XG, 0x00, 0x00, 0x7E): (Sets.ALL, None),
    (*_XG, 0x00, 0x00, 0x7F): (Sets.ALL, None),
    (*_XG, 0x00, 0x00, 0x06): (Sets.KEY_SHIFT, None),
    **{(*_XG, 0x08, n, 0x07): (Sets.DRUMS, n) for n in CHANNELS},
    **{(*_XG, 0x08, n, 0x08): (Sets.KEY_SHIFT, n) for n in CHANNELS},
    **{(*_XG, 0x08, n, 0x23): (Sets.BEND_RANGE, n) for n in CHANNELS},
}


def setting_of(data: Sequence[int]) -> Setting | None:
    """The setting of a system exclusive message, without its first and last byte; None if none."""
    maker = data[0]
    address, value = (maker, *data[2 : _SIZES[maker] + 1]), data[_SIZES[maker] + 1 :][:1]
    if not value or address not in _ADDRESSES:
        return None
    what, channel = _ADDRESSES[address]
    if what in (Sets.ALL, Sets.DRUMS):
        return Setting(what, value[0], channel)
    semitones = value[0] - _KEEPS
    is_valid = maker == _REAL_TIME or abs(semitones) <= _MOST
    return Setting(what, semitones, channel) if is_valid else None


def are_for_roland(messages: Collection[Sequence[int]]) -> bool:
    """Whether system messages are for synthesizers of Roland, and none for XG ones of Yamaha."""
    is_xg = any((data[0], *data[2:3]) == _XG for data in messages)
    return not is_xg and any(data[0] == _ROLAND for data in messages)
