"""Which notes can be played, against every way to play them written out."""

from __future__ import annotations

import itertools
import time

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.fingering.playable import playable
from cadenza.fingering.presses import Press, onsets, outer_first
from cadenza.fingering.reach import LEAST, MOST, OUTWARD
from cadenza.fingering.search import find_fingering
from cadenza.music.keyboard import KEY_Y
from cadenza.music.score import LETTING_GO, Note, Score
from music_strategies import monophonic_per_key, scores


def together(low: tuple[Press, int], high: tuple[Press, int]) -> bool:
    """Whether a lower and a higher key can be pressed by fingers 0..9 at once."""
    (below, a), (above, b) = low, high
    distance = KEY_Y[above.key] - KEY_Y[below.key]
    if a < 5 <= b:
        return False
    if a >= 5 > b:
        return distance + OUTWARD[a - 5] + OUTWARD[b] > 0.149
    nearer, farther = (a, b) if a < 5 else (b - 5, a - 5)
    return nearer < farther and LEAST[nearer, farther] <= distance <= MOST[nearer, farther]


def possible(way: dict[Press, int]) -> bool:
    keys = sorted(way.items(), key=lambda item: item[0].key)
    return all(together(low, high) for low, high in itertools.combinations(keys, 2))


def written_out(score: Score, sides) -> set[int]:
    """The indices of the notes that are played."""
    fingers = [f for f in range(10) if ("right", "left")[f // 5] in sides]
    ways: list[dict[Press, int]] = [{}]
    played: set[int] = set()
    for moment, begin in onsets(score):
        struck = [press.key for press in begin]
        held = [p for p in ways[0] if p.end > moment + LETTING_GO and p.key not in struck]
        ways = [dict(w) for w in {tuple((p, way[p]) for p in held) for way in ways}]
        for press in outer_first(begin, held):
            able = fingers if press.finger < 0 else {press.finger} & set(fingers)
            more = [way | {press: finger} for way in ways for finger in able]
            if more := [way for way in more if possible(way)]:
                ways = more
                played |= set(press.notes)
    return played


crowded = st.builds(
    lambda notes: monophonic_per_key(
        Score(tuple(Note(t / 8, (t + d) / 8, p) for t, d, p in notes))
    ),
    st.lists(
        st.tuples(st.integers(0, 16), st.integers(1, 16), st.integers(50, 75)),
        min_size=1,
        max_size=12,
    ),
)
hands = st.sampled_from([("right", "left"), ("right",), ("left",)])


@settings(deadline=None)
@given(score=st.one_of(crowded, scores()), sides=hands)
def test_the_same_notes_as_written_out(score: Score, sides) -> None:
    found = playable(score, sides)
    played = {i for i in range(len(score.notes)) if i not in found.reasons | found.unheeded}
    assert played == written_out(score, sides)


@settings(deadline=None)
@given(score=crowded, sides=hands)
def test_what_begins_is_pressed_until_it_ends(score: Score, sides) -> None:
    found = playable(score, sides)
    assert [moment.begun for moment in found.moments][-1] == len(score.notes)
    for moment in found.moments:
        keys = [press.key for press in moment.presses]
        assert keys == sorted(set(keys))
        sounding = {
            i
            for i, note in enumerate(score.notes)
            if i not in found.reasons
            and note.start <= moment.time
            and (note.start == moment.time or note.end > moment.time + LETTING_GO)
        }
        assert {i for press in moment.presses for i in press.notes} == sounding


def test_deciding_takes_little_of_the_time_of_fingering() -> None:
    """Also where hardly anything can be played: notes all over the keyboard."""
    rng = np.random.default_rng(0)
    starts, pitches = rng.uniform(0, 40, 500), rng.integers(21, 109, 500)
    score = monophonic_per_key(
        Score(
            tuple(
                Note(float(t), float(t) + 0.6, int(p)) for t, p in zip(starts, pitches, strict=True)
            )
        )
    )
    playable(score, ("right", "left"))  # makes tables
    begin = time.process_time()
    found = playable(score, ("right", "left"))
    decided = time.process_time()
    _, dropped = find_fingering(score)
    assert len(dropped) == len(found.reasons) > 100
    assert decided - begin < (time.process_time() - decided) / 3
