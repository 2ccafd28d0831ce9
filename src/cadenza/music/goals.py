"""Goals: the keys and the pedal that should be down at each control step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.fingers import NO_FINGER, Fingers
from cadenza.music.performance import key_runs
from cadenza.music.score import PEDAL_DOWN, PITCHES, Score

MAX_STEPS = 720_000  # an hour in steps of 5 ms
NO_HANDS = Fingers(per_hand=0)


class Onsets(NamedTuple):
    """The beginnings of N notes, by control step and then by key, (N,) each."""

    step: NDArray[np.intp]  # the first step after which the key should be down
    key: NDArray[np.intp]
    time: NDArray[np.float64]  # when the note begins, from the beginning of the step on [s]
    velocity: NDArray[np.intp]  # the MIDI velocity of the note

    def delayed(self, steps: int) -> Onsets:
        """These onsets, moved later by a number of steps."""
        return self._replace(step=self.step + steps)

    def between(self, first: int, last: int) -> Onsets:
        """The onsets in the steps from `first` to before `last`, which are counted from `first`."""
        first_row, end_row = np.searchsorted(self.step, (first, last))
        return Onsets._make(values[first_row:end_row] for values in self).delayed(-first)

    def at(self, steps: NDArray[np.integer]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The onsets in steps (M,), in any order: (P,) indices of the steps, and of the onsets."""
        since = np.searchsorted(self.step, steps)
        count = np.searchsorted(self.step, steps, "right") - since
        which = np.repeat(np.arange(len(steps)), count)
        return which, np.arange(len(which)) + np.repeat(since - (np.cumsum(count) - count), count)


_NONE = np.zeros(0, np.intp)
NO_ONSETS = Onsets(step=_NONE, key=_NONE, time=np.zeros(0), velocity=_NONE)


@dataclass(frozen=True)
class Goals:
    """The keys and pedal that should be down after each of T control steps, on K keys.

    keys (T, K) bool        keys that should be down
    fingers (T, K) int8     the number of the finger that should press the key, -1 none or unknown
    sustain (T,) bool       whether the pedal should be down
    num_fingers             F, how many numbers of fingers there are
    onsets                  when the notes begin within their steps, and how loud they are
    """

    keys: NDArray[np.bool_]
    fingers: NDArray[np.int8]
    sustain: NDArray[np.bool_]
    num_fingers: int
    onsets: Onsets = NO_ONSETS

    @property
    def num_steps(self) -> int:
        """T, the number of control steps."""
        return len(self.keys)

    @cached_property
    def active_fingers(self) -> NDArray[np.bool_]:
        """(T, F) whether each finger has a key to press."""
        fingers = np.zeros((self.num_steps, self.num_fingers), bool)
        step, key = (self.fingers >= 0).nonzero()
        fingers[step, self.fingers[step, key]] = True
        return fingers

    def at(self, steps: NDArray[np.intp]) -> tuple[NDArray[np.bool_], NDArray[np.int8]]:
        """Keys (S, K) and fingers (S, K) of `steps` (S,); past the end there is silence."""
        inside = (steps < self.num_steps)[:, None]
        rows = np.minimum(steps, self.num_steps - 1)
        fingers = np.where(inside, self.fingers[rows], np.int8(NO_FINGER))
        return self.keys[rows] & inside, fingers


def silence(num_keys: int, num_fingers: int) -> Goals:
    """The goals of a single step in which nothing should sound."""
    fingers = np.full((1, num_keys), NO_FINGER, np.int8)
    return Goals(np.zeros((1, num_keys), bool), fingers, np.zeros(1, bool), num_fingers)


def score_to_goals(
    score: Score,
    dt: float,
    shorten: bool = False,
    pitches: range = PITCHES,
    hands: Fingers = NO_HANDS,
) -> Goals:
    """The goals of `score` on control steps of `dt` [s], as the published RoboPianist makes them.

    The keys have these `pitches`, as MIDI numbers; those of a piano by default. Fingers get the
    numbers that they have on `hands`, and none without hands.

    A song of T seconds has `int(T * (1 / dt) + 1)` steps. A note sounds from step `int(start / dt)`
    up to, not including, `ceil(end / dt)`, and for one step at least. A repeated note may follow
    without a gap: its key is then up for the first step, so the note begins a step late. With
    `shorten`, the key is up for the step before instead, and the note begins in time, unless the
    previous note lasts only that step. If notes share a key and a step, the later note's finger
    counts. A pedal event (down from value 64) acts from step `int(time / dt)` until the next; the
    last of several on one step counts. So a pedal that is lifted and pressed again on one step
    stays down; with `shorten`, it is up for that step. Raises CadenzaError if the score has no
    notes or one without a key, `dt` is not a positive number, or there would be more than
    `MAX_STEPS`.
    """
    if not score.notes:
        raise CadenzaError("the score has no notes, so there is nothing to play; choose another")
    if not 0 < dt < float("inf"):
        raise CadenzaError(f"control step of {dt} s: give a positive number")
    check_pitches(score, pitches)
    fps = 1 / dt
    check_steps(score.total_time * fps)
    num_steps = int(score.total_time * fps + 1)
    keys = np.zeros((num_steps, len(pitches)), bool)
    struck = np.zeros((num_steps, len(pitches)), bool)
    fingers = np.full((num_steps, len(pitches)), NO_FINGER, np.int8)
    for note in score.notes:
        first = int(note.start * fps)
        last = max(first + 1, ceil(note.end * fps))
        key = note.pitch - pitches.start
        keys[first:last, key] = True
        struck[first, key] = True
        fingers[first:last, key] = hands.number(note.finger)
    struck_again = np.zeros_like(keys)
    struck_again[1:] = struck[1:] & keys[:-1]
    for step, key in np.argwhere(struck_again):
        can_shorten = shorten and not struck[step - 1, key] and keys[step - 2, key]
        lifted = step - 1 if can_shorten else step
        keys[lifted, key], fingers[lifted, key] = False, NO_FINGER

    moves = [int(event.time * fps) for event in score.pedal]
    down = np.array([False, *(event.value >= PEDAL_DOWN for event in score.pedal)])
    sustain = down[np.searchsorted(moves, np.arange(num_steps), side="right")]
    if shorten:
        sustain &= ~_hidden_lifts(score, dt, sustain)
    return Goals(keys, fingers, sustain, hands.count, _onsets(score, keys, fps, pitches))


def _onsets(score: Score, keys: NDArray[np.bool_], fps: float, pitches: range) -> Onsets:
    """The onsets of the notes that begin in `keys` (T, K).

    A note that begins a step late, because its key is struck again, begins with that step.
    """
    begins = keys & ~np.pad(keys, ((1, 0), (0, 0)))[:-1]
    onsets = dict[tuple[int, int], tuple[float, int]]()
    for note in score.notes:
        step, key = int(note.start * fps), note.pitch - pitches.start
        if begins[step, key]:
            onsets[step, key] = note.start - step / fps, note.velocity
        elif step + 1 < len(keys) and begins[step + 1, key]:
            onsets.setdefault((step + 1, key), (0.0, note.velocity))
    if not onsets:
        return NO_ONSETS
    places = np.array(sorted(onsets), np.intp)
    times, velocities = zip(*(onsets[step, key] for step, key in places.tolist()), strict=True)
    step, key = places.T
    return Onsets(step, key, np.array(times), np.array(velocities, np.intp))


def _hidden_lifts(score: Score, dt: float, sustain: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(T,) steps on which the pedal is lifted, and yet down as on the step before."""
    moves = [int(event.time * (1 / dt)) for event in score.pedal if event.value < PEDAL_DOWN]
    lifted = np.isin(np.arange(len(sustain)), moves)
    return lifted & sustain & np.append(False, sustain[:-1])


def held_pedal_changes(score: Score, dt: float, sustain: NDArray[np.bool_]) -> int:
    """The number of times that the pedal stays down in `sustain` (T,) though `score` lifts it."""
    return int(_hidden_lifts(score, dt, sustain).sum())


def merged_notes(score: Score, goals: Goals) -> int:
    """The number of notes of `score` that run into the note before on the same key in `goals`.

    Notes of one key that begin at the same time count as one.
    """
    strokes, *_ = key_runs(goals.keys)
    return len({(note.start, note.pitch) for note in score.notes}) - len(strokes)


def check_pitches(score: Score, pitches: range) -> None:
    """Check that all notes are on a keyboard of these pitches; raises CadenzaError if not."""
    if outside := sum(note.pitch not in pitches for note in score.notes):
        raise CadenzaError(
            f"{score.title or 'the score'}: {outside} of {len(score.notes)} notes are not on the "
            f"keyboard, whose pitches are {pitches.start} to {pitches.stop - 1}; transpose the song"
        )


def check_steps(steps: float) -> None:
    """Check a number of control steps; raises CadenzaError if memory has no room for them."""
    if steps > MAX_STEPS:
        raise CadenzaError(
            f"the song would have {steps:.3g} control steps; the maximum is {MAX_STEPS}: "
            "choose a longer control step"
        )
