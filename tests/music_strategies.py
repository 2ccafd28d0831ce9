"""Random scores for property tests."""

from hypothesis import strategies as st

from cadenza.music.score import Note, PedalEvent, Score
from numbered import finger

times = st.integers(0, 400).map(lambda k: k / 40)  # on and between steps of 0.05 s
lengths = st.integers(1, 80).map(lambda k: k / 40)
seconds = st.floats(0, 20, allow_subnormal=False)


@st.composite
def notes(draw: st.DrawFn, start=times) -> Note:
    begin = draw(start)
    return Note(
        begin,
        begin + draw(lengths),
        draw(st.integers(21, 108)),
        draw(st.integers(1, 127)),
        finger(draw(st.integers(-1, 9))),
    )


@st.composite
def scores(draw: st.DrawFn, start=times, min_size: int = 1) -> Score:
    played = draw(st.lists(notes(start), min_size=min_size, max_size=12))
    moved = draw(st.lists(st.builds(PedalEvent, start, st.integers(0, 127)), max_size=6))
    return Score(tuple(played), tuple(moved))


def monophonic_per_key(score: Score) -> Score:
    """`score` without the notes that start before an earlier note of their pitch has ended."""
    kept: list[Note] = []
    free_from: dict[int, float] = {}
    for note in score.notes:
        if note.start >= free_from.get(note.pitch, 0.0):
            kept.append(note)
            free_from[note.pitch] = note.end + 1e-3
    return Score(tuple(kept), score.pedal)
