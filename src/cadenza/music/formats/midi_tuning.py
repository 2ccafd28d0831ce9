"""How far the notes of a channel of a MIDI file are from the pitches of their keys."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from math import inf
from operator import itemgetter

from cadenza.music.formats.general_midi import LARGEST

_DATA, _DATA_FINE, _INCREMENT, _DECREMENT = 6, 38, 96, 97  # controllers that set a parameter
_OTHERS, _LOW, _HIGH = (98, 99), 100, 101  # those that choose it; _OTHERS choose one of makers
CONTROLS = frozenset((_DATA, _DATA_FINE, _INCREMENT, _DECREMENT, *_OTHERS, _LOW, _HIGH))
"""The controllers that choose and set registered parameters."""
BEND_RANGE, _COARSE, ZONE = (0, 0), (0, 2), (0, 6)
"""Registered parameters: high and low bytes. The last says how many channels an MPE zone has."""
NO_PARAMETER = (LARGEST, LARGEST)
_KEEPS = 64  # the coarse tuning that moves nothing
USUAL_RANGE, MEMBER_RANGE = 2, 48
"""The bend range of channels, and of members of an MPE zone, until the file says otherwise."""
_CENTS = 100  # in a semitone
_EXACT = 0.1  # [semitones] by which a bend may miss whole ones: wheels of 7 bits miss 2 by 0.03


@dataclass(slots=True)
class Tuning:
    """The tuning of a channel.

    Controllers set the registered parameter `chosen`: `coarse` [semitones], or `bend_range`
    [semitones], as far as the pitch `wheel`, from -1 to 1, bends. Fine tuning is left out, as no
    key has it. `key_shift` [semitones] is what a synthesizer adds. `bends` are the times at which
    the bend changes, and its sizes [semitones].
    """

    chosen: tuple[int, int] = NO_PARAMETER
    coarse: int = 0
    key_shift: int = 0
    bend_range: float = USUAL_RANGE
    wheel: float = 0.0
    bends: list[tuple[int, float]] = field(default_factory=list)

    @property
    def bend(self) -> float:
        """The bend of the pitch wheel [semitones]."""
        return self.wheel * self.bend_range

    def control(self, control: int, value: int) -> tuple[int, int] | None:
        """Chooses a registered parameter, or sets and returns the one that is chosen."""
        high, low = self.chosen
        if control in (_LOW, _HIGH, *_OTHERS):
            chosen = {_HIGH: (value, low), _LOW: (high, value)}
            self.chosen = chosen.get(control, NO_PARAMETER)
            return None
        if self.chosen == _COARSE and control != _DATA_FINE:
            steps = {_INCREMENT: 1, _DECREMENT: -1}
            tuned = self.coarse + steps[control] if control in steps else value - _KEEPS
            self.coarse = min(max(tuned, -_KEEPS), LARGEST - _KEEPS)
        elif self.chosen == BEND_RANGE and control == _DATA:
            self.bend_range = value
        elif self.chosen == BEND_RANGE and control == _DATA_FINE:
            self.bend_range = int(self.bend_range) + value / _CENTS
        return self.chosen if control == _DATA or self.chosen == BEND_RANGE else None

    def record(self, now: int, of_zone: float) -> None:
        """Records the bend, if it changes at a time, with that of its MPE zone [semitones]."""
        bend = self.bend + of_zone
        if abs(bend - (self.bends[-1][1] if self.bends else 0.0)) > _EXACT:
            self.bends.append((now, bend))

    def bend_of(self, start: float, end: float) -> tuple[int, bool]:
        """The transposition of a note that begins under a bend [semitones]; whether it is exact.

        A bend that does not last for half of the note moves nothing.
        """
        latest = bisect_right(self.bends, start, key=itemgetter(0)) - 1
        bend = self.bends[latest][1] if latest >= 0 else 0.0
        until = self.bends[latest + 1][0] if latest + 1 < len(self.bends) else inf
        semitones = round(bend) if 2 * (until - start) >= end - start else 0
        return semitones, abs(bend - semitones) <= _EXACT
