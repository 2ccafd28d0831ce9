"""What holds for notes with any signs."""

from dataclasses import replace
from fractions import Fraction as Q

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.fingers import Finger
from cadenza.music.signs.notes import (
    Arpeggio,
    Grace,
    Mark,
    Ornament,
    OrnamentKind,
    Role,
    SignedNote,
    SlurEnd,
    Tremolo,
)
from cadenza.music.signs.realising import realised
from cadenza.music.signs.tempo_map import (
    Caesura,
    Fermata,
    Swing,
    Tempo,
    TempoChange,
    TempoMap,
    TempoWord,
)

END = Q(16)
places = st.integers(0, 48).map(lambda k: Q(k, 3))
lengths = st.sampled_from([Q(1, 12), Q(1, 8), Q(1, 4), Q(1, 3), Q(1, 2), Q(3, 4), Q(1), Q(4)])
maybe = st.none()
ornaments = st.builds(
    Ornament,
    st.sampled_from(OrnamentKind),
    maybe | st.integers(-1, 1),
    maybe | st.integers(-1, 1),
    maybe | st.integers(-1, 1),
    st.booleans(),
    st.booleans(),
)
shares = maybe | st.floats(0, 1)
graces = st.builds(
    Grace, st.integers(0, 3), st.booleans(), shares, shares, maybe | st.just(Q(1, 8)), st.booleans()
)
notes = st.builds(
    SignedNote,
    onset=places,
    duration=lengths,
    pitch=st.integers(40, 80),
    velocity=st.integers(1, 127),
    part=st.integers(1, 2),
    staff=st.integers(1, 2),
    voice=st.sampled_from("12"),
    alter=st.integers(-1, 1),
    fifths=st.integers(-7, 7),
    marks=st.frozensets(st.sampled_from(Mark)),
    ornament=maybe | ornaments,
    tremolo=maybe | st.builds(Tremolo, st.integers(0, 9), st.sampled_from(Role)),
    arpeggio=maybe | st.builds(Arpeggio, maybe | st.integers(1, 2), st.integers(-1, 1)),
    grace=maybe | graces,
    slurs=st.lists(st.builds(SlurEnd, st.booleans(), st.integers(1, 2)), max_size=2).map(tuple),
)
marks = st.lists(
    st.builds(Tempo, places, st.floats(0.1, 3))
    | st.builds(TempoWord, places, st.sampled_from(TempoChange))
    | st.builds(lambda onset, length: Fermata(onset, onset + length), places, lengths)
    | st.builds(Caesura, places),
    max_size=6,
)
scores = st.lists(notes, min_size=1, max_size=12)


@settings(deadline=None)
@given(scores, marks, st.booleans())
def test_every_note_sounds_and_stays_within_its_neighbourhood(score, tempos, swing):
    tempo = TempoMap.of(tempos, END)
    swings = [Swing(Q(0))] if swing else []
    score = [replace(note, finger=Finger(0, index)) for index, note in enumerate(score)]
    sounding = realised(score, tempo, swings)
    assert {note.of.finger for note in sounding} == {note.finger for note in score}
    assert all(note.end > note.start for note in sounding)
    assert all(1 <= note.velocity <= 127 for note in sounding)
    last = max(tempo.onsets([note.end + Q(1, 6) for note in score]))
    assert max(note.end for note in sounding) <= last + 1e-9


@settings(deadline=None)
@given(scores, marks)
def test_without_signs_times_are_those_of_the_tempo_map_to_the_bit(score, tempos):
    tempo = TempoMap.of(tempos, END)
    bare = [SignedNote(n.onset, n.duration, n.pitch, n.velocity) for n in score]
    got = sorted((n.start, n.end, n.pitch, n.velocity) for n in realised(bare, tempo))
    starts = tempo.onsets([n.onset for n in bare]).tolist()
    ends = tempo.ends([n.end for n in bare]).tolist()
    rest = [(n.pitch, n.velocity) for n in bare]
    assert got == sorted((a, b, *c) for a, b, c in zip(starts, ends, rest, strict=True))


@settings(deadline=None)
@given(scores)
def test_plain_is_as_if_there_were_no_signs_but_grace_notes(score):
    tempo = TempoMap.of([])
    written = [note.plain for note in score if note.grace is None]
    got = {(n.start, n.end, n.pitch, n.velocity) for n in realised(written, tempo)}
    assert got == {(float(n.onset) / 2, float(n.end) / 2, n.pitch, n.velocity) for n in written}


@settings(deadline=None)
@given(marks)
def test_time_never_goes_back_and_silence_comes_after_what_ends(tempos):
    tempo = TempoMap.of(tempos, END)
    grid = [Q(k, 6) for k in range(100)]
    onsets, ends = tempo.onsets(grid), tempo.ends(grid)
    assert np.all(np.diff(onsets) > 0)
    assert np.all(ends <= onsets)
    assert np.all(ends[1:] > onsets[:-1])


@settings(deadline=None)
@given(marks, places)
def test_a_piece_that_is_played_twice_lasts_twice_as_long(tempos, middle):
    tempo = TempoMap.of(tempos, END)
    both = tempo.played([(Q(0), END), (Q(0), END)])
    once = float(tempo.onsets([END])[0] - tempo.onsets([Q(0)])[0])
    np.testing.assert_allclose(both.onsets([2 * END]), 2 * once)
    again = both.onsets([END + middle]) - both.onsets([END])
    np.testing.assert_allclose(again, tempo.onsets([middle]) - tempo.onsets([Q(0)]), atol=1e-9)
