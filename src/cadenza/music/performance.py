"""The performed score: notes and pedal from the keys that sounded."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.episode import KEY_EVENTS, Episode
from cadenza.errors import CadenzaError, quoted
from cadenza.music.score import LOWEST_PITCH, Note, PedalEvent, Score

SAME_NOTE = 0.2  # [s] within which a note played and one written on the same key are the same
BOUNCE = 0.02
"""A key that sounds again sooner than this [s] after it ceased has bounced, and its note goes on:
the action of a grand piano repeats up to about 15 times a second, once in 67 ms."""
_TIME_DECIMALS = 9  # decimals of times [s]


class KeyEvent(NamedTuple):
    """What happened to a key in a control step; NaN stands for what did not happen."""

    step: int
    key: int
    onset: float  # the time in the step at which the key began to sound [s]
    offset: float  # the time in the step at which the key ceased to sound [s]
    velocity: float  # the MIDI velocity at the onset


def key_events(
    onset: NDArray[np.floating[Any]],
    offset: NDArray[np.floating[Any]],
    velocity: NDArray[np.floating[Any]],
) -> Iterator[KeyEvent]:
    """Yield the events of T control steps in their order; arrays are (T, K), NaN without event."""
    rows = np.nonzero(~(np.isnan(onset) & np.isnan(offset)))
    columns = (*rows, onset[rows], offset[rows], velocity[rows])
    return map(KeyEvent._make, zip(*(column.tolist() for column in columns), strict=True))


@dataclass
class _Sounded:
    start: float
    key: int
    velocity: float
    end: float | None = None  # none as long as the key sounds


class SoundedNotes:
    """The notes of keys, made of the events of one control step of `dt` [s] after the other.

    A key that already sounds does not begin again, and one that sounds again within `BOUNCE` goes
    on as one note, with the velocity of its first onset.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._notes: list[_Sounded] = []
        self._last: dict[int, _Sounded] = {}  # of each key

    def add(self, event: KeyEvent) -> bool:
        """Add what happened to a key; return whether a note has begun."""
        num_before = len(self._notes)
        times = [(event.onset, True), (event.offset, False)]
        for time, sounds in sorted(each for each in times if each[0] == each[0]):
            self._cross(event, event.step * self._dt + time, sounds)
        return len(self._notes) > num_before

    def _cross(self, event: KeyEvent, time: float, sounds: bool) -> None:
        last = self._last.get(event.key)
        if sounds == (last is not None and last.end is None):
            return
        if last is not None and not sounds:
            last.end = time
        elif last is not None and last.end is not None and time - last.end < BOUNCE:
            last.end = None
        else:
            self._last[event.key] = note = _Sounded(time, event.key, event.velocity)
            self._notes.append(note)

    def notes(self, seconds: float, lowest_pitch: int = LOWEST_PITCH) -> Iterator[Note]:
        """Yield the notes of the first `seconds`; then all keys cease to sound."""
        for note in self._notes:
            start = round(note.start, _TIME_DECIMALS)
            end = round(seconds if note.end is None else note.end, _TIME_DECIMALS)
            if start < end:  # not what only touched the threshold
                yield Note(start, end, note.key + lowest_pitch, round(note.velocity))


def key_runs(roll: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The runs of steps over which a key of `roll` (T, K) is on without a break.

    Returns the first step, the step after the last and the key, each (number of runs,), by key and
    then time.
    """
    silence = np.zeros((1, roll.shape[1]), np.int8)
    change = np.diff(roll.astype(bool), axis=0, prepend=silence, append=silence).T
    key, first = np.nonzero(change == 1)
    return first, np.nonzero(change == -1)[1], key


def performed_score(
    key_activation: NDArray[Any],
    sustain: NDArray[Any],
    dt: float,
    events: Iterable[KeyEvent] | None = None,
    lowest_pitch: int = LOWEST_PITCH,
) -> Score:
    """The notes and the pedal that sounded over T control steps of `dt` [s].

    The pedal moves at the beginnings of steps. So do the notes where only steps are known: a key
    that sounds from step i up to, not including, step j is a note from `i * dt` to `j * dt` of
    velocity 80, just as `score_to_goals` places it at the default of 0.05 s.

    Args:
        key_activation: (T, K), whether each key sounds after the step.
        sustain: (T,), whether the pedal is down after the step.
        dt: [s].
        events: of the keys, in the order of steps, if they are known: notes then begin and end at
            the times at which the keys did so, with the velocities of their onsets.
        lowest_pitch: MIDI number of the first key.
    """
    if events is None:
        runs = zip(*key_runs(key_activation), strict=True)
        notes: Iterable[Note] = (
            Note(_time(i, dt), _time(j, dt), int(key) + lowest_pitch) for i, j, key in runs
        )
    else:
        sounded = SoundedNotes(dt)
        for event in events:
            sounded.add(event)
        notes = sounded.notes(len(key_activation) * dt, lowest_pitch)
    moved = np.flatnonzero(np.diff(sustain.astype(np.int8), prepend=0))
    pedal = (PedalEvent(_time(i, dt), 127 if sustain[i] else 0) for i in moved)
    return Score(tuple(notes), tuple(pedal))


def _time(step: np.intp, dt: float) -> float:
    """The beginning of a step [s], rounded, so that goals place it on the same step again."""
    return round(float(step * dt), _TIME_DECIMALS)


def played_in(episode: Episode) -> Score:
    """The notes and the pedal that sounded in an episode.

    Recordings that do not hold `key_onset`, `key_offset` and `key_velocity`, such as those of the
    published system, have notes that begin on steps, see `performed_score`. Raises CadenzaError if
    an onset has no velocity, or a time or a velocity is out of range.
    """
    events = None
    if all(name in episode.arrays for name in KEY_EVENTS):
        onset, offset, velocity = (episode[name] for name in KEY_EVENTS)
        if not np.isfinite(velocity[~np.isnan(onset)]).all():
            raise CadenzaError(
                f"the episode of {quoted(episode.song)} has onsets without velocities"
            )
        events = key_events(onset, offset, velocity)
    return performed_score(
        episode["key_activation"],
        episode["sustain_activation"],
        episode.dt,
        events,
        episode.lowest_pitch,
    )
