"""How long hands can hold notes, if they are to strike the next ones in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from cadenza.arranging.moments import SHORTEST, TOGETHER
from cadenza.fingering.players import Players
from cadenza.fingers import SIDES, Finger
from cadenza.hands.reach import JumpTimes
from cadenza.music.score import Note, Score, chords, is_black

_RISE = 0.05  # [s] in which a finger gets off its key
_SPARE = 0.05  # [s] since planners release notes on control steps
_LONGEST_JUMP = 1.0  # [s]


def held_as_possible(score: Score, players: Players, times: JumpTimes) -> Score:
    """A score with fingers, of which notes end where their hand has to go to others.

    A hand leaves keys for those that it does not reach from there as early as the jump takes; a
    finger leaves its key for another.

    Args:
        score: the notes; those without a finger stay as they are.
        players: the hands.
        times: how long the hands take to jump.
    """
    notes = list(score.notes)
    for hand in range(len(SIDES)):
        mine = [i for i, n in enumerate(notes) if n.finger is not None and n.finger.hand == hand]
        struck = list(chords(mine, TOGETHER, lambda i: notes[i].start))
        _end_for_jumps(notes, struck, hand, players, times)
        _end_for_other_keys(notes, mine, times)
    return replace(score, notes=tuple(notes))


def _end_for_jumps(
    notes: list[Note], struck: Sequence[list[int]], hand: int, players: Players, times: JumpTimes
) -> None:
    """Ends notes whose hand is to strike what it does not reach from there.

    `struck` are the indices of the notes that it strikes together.
    """
    y, reach = players.key_y(hand), players.reach
    key = [note.pitch - players.keyboard.lowest_pitch for note in notes]
    finger = [_index(note.finger) for note in notes]

    def place(i: int) -> float:
        """The place of the forearm while a note is pressed [m]."""
        return float(y[key[i]] - reach.rest[finger[i]])

    def mean(chord: Sequence[int]) -> float:
        return sum(map(place, chord)) / len(chord)

    def spans(i: int, j: int) -> bool:
        return bool(reach.spans(finger[i], finger[j], y[key[j]] - y[key[i]]))

    held: list[int] = []
    for chord, after in pairwise(struck):
        begins = notes[after[0]].start
        held = [i for i in (*held, *chord) if notes[i].end > begins - _LONGEST_JUMP]
        for i in held:
            holding = notes[i].end > begins + _RISE
            from_place = place(i) if holding or i not in chord else mean(chord)
            distance = abs(mean(after) - from_place)
            jump = float(times.seconds(distance, len(chord), len(after), holding))
            if jump and not all(spans(i, j) for j in after):
                _end(notes, i, begins - jump - _SPARE)


def _end_for_other_keys(notes: list[Note], mine: Sequence[int], times: JumpTimes) -> None:
    """Ends notes whose finger presses another key next."""
    latest: dict[int, int] = {}
    for i in mine:
        finger = _index(notes[i].finger)
        if (before := latest.get(finger)) is not None and notes[before].pitch != notes[i].pitch:
            climbs = is_black(notes[i].pitch) and not is_black(notes[before].pitch)
            _end(notes, before, notes[i].start - (times.climb if climbs else _RISE) - _SPARE)
        latest[finger] = i


def _index(finger: Finger | None) -> int:
    return finger.index if finger else 0


def _end(notes: list[Note], i: int, time: float) -> None:
    """Ends a note at a time, if it is later, but not before it has been heard."""
    note = notes[i]
    if note.end > time:
        notes[i] = replace(note, end=max(time, min(note.start + SHORTEST, note.end)))
