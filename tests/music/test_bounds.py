"""No song asks for more memory than there is, and no note is too short to be moved."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.music.formats.midi import read_midi, write_midi
from cadenza.music.goals import MAX_STEPS, score_to_goals
from cadenza.music.score import MAX_SCORE_LENGTH, MAX_SECONDS, Bar, Note, PedalEvent, Score
from players import find_fingering

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


def test_a_note_shorter_than_a_nanosecond_is_written_and_read(tmp_path):
    write_midi(Score((Note(0.5, 0.5 + 1e-10, 60),)), tmp_path / "short.mid")
    assert len(read_midi(tmp_path / "short.mid").notes) == 1
