import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.fingers import LEFT, RIGHT
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.goals import MAX_STEPS, score_to_goals
from cadenza.music.score import MAX_SCORE_LENGTH, MAX_SECONDS, Bar, Note, PedalEvent, Score
from music_strategies import scores, seconds
from numbered import finger, numbers
from players import find_fingering

TWO = Score(
    (Note(1.0, 2.0, 60, finger=finger(0)), Note(1.5, 3.0, 64, finger=finger(2))),
    (PedalEvent(0.5, 127), PedalEvent(2.5, 0), PedalEvent(3.5, 127)),
    "two",
)


def test_notes_and_pedal_come_out_sorted():
    late, early, high = Note(1, 2, 60), Note(0, 1, 70), Note(1, 2, 62)
    score = Score((high, late, early), (PedalEvent(2, 0), PedalEvent(1, 127)))
    assert score.notes == (early, late, high)
    assert [event.time for event in score.pedal] == [1, 2]


@pytest.mark.parametrize(
    "values",
    [
        {"start": -1.0},
        {"end": 0.0},
        {"end": float("inf")},
        {"start": float("nan")},
        {"pitch": -1},
        {"pitch": 128},
        {"pitch": 60.0},
        {"velocity": 80.5},
        {"velocity": 0},
        {"velocity": 128},
        {"finger": 1},
        {"finger": -1},
        {"hands": (2,)},
    ],
)
def test_impossible_notes_are_refused(values):
    with pytest.raises(CadenzaError):
        Note(**{"start": 0.0, "end": 1.0, "pitch": 60} | values)


def test_impossible_pedal_events_are_refused():
    for time, value in ((-1.0, 0), (0.0, 0.5), (0.0, 128), (0.0, -1), (float("nan"), 0)):
        with pytest.raises(CadenzaError):
            PedalEvent(time, value)


def test_stretching_scales_every_time_and_keeps_the_rest():
    slow = TWO.stretched(2)
    assert slow.notes == (Note(2, 4, 60, finger=finger(0)), Note(3, 6, 64, finger=finger(2)))
    assert [event.time for event in slow.pedal] == [1, 5, 7]
    assert slow.title == "two"


@pytest.mark.parametrize("factor", [0, -1, float("nan"), float("inf"), "2"])
def test_stretching_needs_a_positive_number(factor):
    with pytest.raises(CadenzaError, match="positive"):
        TWO.stretched(factor)


def test_transposing_moves_every_pitch_and_keeps_fingers():
    assert [n.pitch for n in TWO.transposed(-3).notes] == [57, 61]
    assert numbers(TWO.transposed(-3)) == [0, 2]


def test_transposing_beyond_midi_is_refused():
    with pytest.raises(CadenzaError, match="transpose by 64"):
        TWO.transposed(64)
    assert TWO.transposed(63).notes[-1].pitch == 127


def test_written_hands_are_kept_and_exchanged_in_the_mirror():
    notes = (Note(1.0, 2.0, 60, hands=(RIGHT,)), Note(1.5, 3.0, 64, hands=(RIGHT, LEFT)))
    score = Score(notes)
    changed = score.stretched(2).transposed(1).with_silence_trimmed().with_initial_silence(1)
    for same in (changed, WrittenScore.of(score).score):
        assert [note.hands for note in same.notes] == [(RIGHT,), (RIGHT, LEFT)]
    assert [set(note.hands) for note in score.mirrored.notes] == [{LEFT}, {RIGHT, LEFT}]


def test_trimming_keeps_a_held_pedal_and_drops_what_comes_after_the_notes():
    trimmed = TWO.with_silence_trimmed()
    assert [(n.start, n.end) for n in trimmed.notes] == [(0, 1), (0.5, 2)]
    assert trimmed.pedal == (PedalEvent(0, 127), PedalEvent(1.5, 0))


def test_trimming_does_not_push_notes_onto_an_earlier_step():
    score = Score((Note(0.05, 0.1, 60), Note(0.15, 0.2, 60))).with_silence_trimmed()
    assert score.notes[1].start == 0.1  # 0.15 - 0.05 is 0.09999999999999999


def test_initial_silence_delays_everything():
    assert TWO.with_initial_silence(0.5).notes[0].start == 1.5
    assert TWO.with_initial_silence(0.5).pedal[0].time == 1.0
    for wrong in (-0.1, float("nan"), float("inf")):
        with pytest.raises(CadenzaError, match="initial silence"):
            TWO.with_initial_silence(wrong)


@given(scores(), st.floats(0, 10))
def test_what_is_heard_until_a_time_is_what_begins_before_it(score, seconds):
    until = score.until(seconds)
    for note, original in zip(until.notes, score.notes, strict=False):
        assert note.start == original.start < seconds
        assert note.end == min(original.end, seconds)
    assert all(note.start >= seconds for note in score.notes[len(until.notes) :])
    assert list(until.pedal) == [event for event in score.pedal if event.time < seconds]
    assert score.until(score.total_time + 1).notes == score.notes


def test_an_empty_score_survives_every_change():
    empty = Score(())
    assert empty.total_time == 0
    assert not empty.has_fingering
    assert (
        empty.stretched(2)
        == empty.transposed(5)
        == empty.until(1)
        == empty.with_silence_trimmed()
        == empty
    )


@given(scores())
def test_a_trimmed_score_starts_at_zero_and_ends_with_its_last_note(score):
    trimmed = score.with_silence_trimmed()
    assert trimmed.notes[0].start == 0
    length = score.total_time - score.notes[0].start
    assert trimmed.total_time == pytest.approx(length, abs=1e-8)
    assert all(0 <= event.time <= trimmed.total_time for event in trimmed.pedal)
    assert trimmed.with_silence_trimmed() == trimmed


@given(scores(seconds), st.floats(0.25, 4))
def test_stretching_back_restores_the_times(score, factor):
    """Notes that begin less than a rounding error apart may change places."""
    back = score.stretched(factor).stretched(1 / factor)
    for pitch in {note.pitch for note in score.notes}:
        for time in ("start", "end"):
            restored, original = (
                sorted(getattr(note, time) for note in each.notes if note.pitch == pitch)
                for each in (back, score)
            )
            assert restored == pytest.approx(original, abs=1e-7)


@given(scores(), st.floats(0, 5))
def test_initial_silence_is_what_trimming_takes_away(score, silence):
    trimmed = score.with_silence_trimmed()
    later = trimmed.with_initial_silence(silence).with_silence_trimmed()
    for note, original in zip(later.notes, trimmed.notes, strict=True):
        assert note.start == pytest.approx(original.start, abs=1e-8)


def test_the_beginning_counts_from_the_first_note_and_ends_what_goes_on():
    notes = (Note(2, 3, 60), Note(2.5, 4, 64), Note(3.0, 3.5, 67))
    pedal = (PedalEvent(0, 127), PedalEvent(2.9, 0), PedalEvent(3.2, 127))
    beginning = Score(notes, pedal, "song").beginning(1.0)
    assert beginning == Score((Note(2, 3, 60), Note(2.5, 3, 64)), pedal[:2], "song")
    assert Score(()).beginning(1.0) == Score(())
    with pytest.raises(CadenzaError, match="--first-seconds 0"):
        Score(notes).beginning(0)


SHORT = Score((Note(0.0, 10.0, 60),), (PedalEvent(1.0, 127),))


@pytest.mark.parametrize("factor", [361, 1e6, 1e12, 1e300])
def test_no_song_is_stretched_beyond_an_hour(factor):
    with pytest.raises(CadenzaError, match=r"would last .* minutes; the longest is 60"):
        SHORT.stretched(factor)


def test_no_song_begins_after_more_than_an_hour():
    with pytest.raises(CadenzaError, match="the longest is 60"):
        SHORT.with_initial_silence(MAX_SECONDS)


@pytest.mark.parametrize(
    "parts",
    [
        {"notes": (Note(46e6, 46e6 + 1, 60),)},
        {"pedal": (PedalEvent(46e6, 127),)},
        {"bars": (Bar(-46e6, 1),)},
        {"bars": (Bar(0.0, 1, (0.0, 46e6)),)},
    ],
)
def test_no_score_lasts_longer_than_memory_has_room_for_its_bars(parts):
    with pytest.raises(CadenzaError, match=r"a score of 1\.278e.04 hours; the longest is 4"):
        Score(**{"notes": (Note(0.0, 1.0, 60),), **parts})


@pytest.mark.parametrize(
    ("seconds", "step"), [(10.0, 1e-9), (10.0, 1e-320), (MAX_SCORE_LENGTH, 0.01)]
)
def test_more_steps_than_memory_has_room_for(seconds, step):
    with pytest.raises(CadenzaError, match=f"control steps; the maximum is {MAX_STEPS}"):
        score_to_goals(Score((Note(0.0, seconds, 60),)), step)


close = st.sampled_from([0.0, 5e-324, 1e-300, 1e-12, 1e-10, 4e-10, 0.25, 0.25 + 1e-10, 1.0, 30.0])


@settings(deadline=None)
@given(st.lists(st.tuples(close, close, st.integers(58, 62)), min_size=1, max_size=6))
def test_notes_of_hardly_any_length_can_be_moved_stretched_and_played(times):
    notes = tuple(Note(min(a, b), max(a, b), pitch) for a, b, pitch in times if a != b)
    score = Score(notes)
    if not notes:
        return
    for changed in (
        score.with_silence_trimmed(),
        score.with_initial_silence(0.5),
        score.stretched(1e-9),
        score.stretched(1.1),
    ):
        assert len(changed.notes) == len(notes)
        assert all(note.start < note.end for note in changed.notes)
        find_fingering(changed)
        score_to_goals(changed, 0.05)
