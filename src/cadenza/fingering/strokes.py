"""Strokes: the keys that a score presses, and their times."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from cadenza.fingers import LEFT, RIGHT, Finger
from cadenza.music.score import RELEASE_TIME, Note, Score, chords


@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """A key pressed from `start` to `end` [s] for one or several of the `notes` (indices).

    It has a given `finger`, or else a given `hand`, if any.
    """

    key: int
    start: float
    end: float
    velocity: int
    finger: Finger | None
    notes: tuple[int, ...]
    hand: int | None = None


def onsets(
    score: Score, lowest_pitch: int, as_written: bool = False
) -> Iterator[tuple[float, list[Stroke]]]:
    """The moments at which notes begin [s], with the strokes that begin then.

    A stroke ends when its key is struck again. Key 0 has the `lowest_pitch`. Strokes `as_written`
    have the hands for which notes are written, unless these cross, which our hands cannot.
    """
    moments: list[tuple[float, dict[int, list[int]]]] = []
    for chord in chords(range(len(score.notes)), start=lambda i: score.notes[i].start):
        indices_of: dict[int, list[int]] = {}
        for i in chord:
            indices_of.setdefault(score.notes[i].pitch - lowest_pitch, []).append(i)
        moments.append((score.notes[chord[0]].start, indices_of))
    struck_again: dict[int, float] = {}
    ends: dict[int, float] = {}
    for time, keys in reversed(moments):
        for key, indices in keys.items():
            end = max(score.notes[i].end for i in indices)
            ends[indices[0]] = min(end, struck_again.get(key, end))
            struck_again[key] = time
    crossing = _crossing(score.notes) if as_written else set()
    for time, keys in moments:
        strokes = []
        for key, indices in keys.items():
            notes = [score.notes[i] for i in indices]
            finger = next((n.finger for n in notes if n.finger is not None), None)
            loudest = max(note.velocity for note in notes)
            hands = {hand for note in notes for hand in note.hands}
            is_bound = as_written and finger is None and crossing.isdisjoint(indices)
            hand = hands.pop() if is_bound and len(hands) == 1 else None
            end = ends[indices[0]]
            strokes.append(Stroke(key, time, end, loudest, finger, tuple(indices), hand))
        yield time, strokes


def _crossing(notes: Sequence[Note]) -> set[int]:
    """Indices of notes that sound together with notes of the other hand on the wrong side."""
    crossing: set[int] = set()
    sounding: list[int] = []
    for i, note in enumerate(notes):
        sounding = [k for k in sounding if notes[k].end > note.start + RELEASE_TIME]
        for k in sounding:
            lower, upper = sorted((note, notes[k]), key=lambda n: n.pitch)
            if (lower.hands, upper.hands) == ((RIGHT,), (LEFT,)) and lower.pitch < upper.pitch:
                crossing |= {i, k}
        sounding.append(i)
    return crossing


def outer_first(begin: Sequence[Stroke], held: Sequence[Stroke]) -> list[Stroke]:
    """`begin` by priority: strokes with given fingers, then from outside to inside."""
    keys = sorted({stroke.key for stroke in (*begin, *held)})
    place = {key: min(i, len(keys) - 1 - i) for i, key in enumerate(keys)}
    return sorted(
        begin, key=lambda p: (p.finger is None, place[p.key], -p.velocity, p.start - p.end, -p.key)
    )
