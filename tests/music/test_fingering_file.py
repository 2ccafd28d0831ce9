import pytest
from hypothesis import HealthCheck, given, settings

from cadenza.errors import CadenzaError
from cadenza.music.formats.fingering_file import read_fingering, write_fingering
from cadenza.music.score import Note, Score
from music_strategies import monophonic_per_key, scores
from numbered import finger, numbers

SCORE = Score((Note(0.0, 0.5, 60), Note(0.0, 0.5, 64), Note(0.5, 1.0, 60), Note(0.53, 1.0, 72)))


def fingers(tmp_path, text, score=SCORE):
    path = tmp_path / "song.fingering"
    path.write_text(text, encoding="utf-8")
    return numbers(read_fingering(path, score))


def test_lines_find_their_notes_in_any_order(tmp_path):
    text = "# my fingering\n\n0.5 60 1  # second C\n0.0 64 2\n0 60 0\n"
    assert fingers(tmp_path, text) == [0, 2, 1, -1]


def test_the_nearest_start_within_the_tolerance_counts(tmp_path):
    assert fingers(tmp_path, "0.46 60 1\n0.049 60 4\n0.5 72 3\n") == [4, -1, 1, 3]


def test_windows_line_ends_tabs_and_byte_order_mark(tmp_path):
    assert fingers(tmp_path, "\ufeff0\t60\t0\r\n0.5\t60\t9\r\n") == [0, -1, 9, -1]


def test_an_unknown_finger_takes_a_finger_away(tmp_path):
    score = Score((Note(0, 1, 60, finger=finger(3)),))
    assert fingers(tmp_path, "0 60 -1", score) == [-1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 60 0\n0 60", "line 2: '0 60' is not 'start pitch finger'"),
        ("\n\n0 60 0 1", "line 3: '0 60 0 1' is not"),
        ("zero 60 0", r"line 1: start \[s\] 'zero'; expected a number"),
        ("nan 60 0", r"line 1: start \[s\] 'nan'"),
        ("-1 60 0", r"line 1: start \[s\] '-1'"),
        ("0 128 0", "line 1: pitch '128'; expected a whole number, 0 to 127"),
        pytest.param(f"0 {'6' * 5000} 0", r"pitch '6+\.\.\.; expected", id="digits"),
        ("0 60 thumb", "line 1: there is no finger 'thumb'"),
        ("0 60 10", "line 1: there is no finger '10'"),
        ("0 60 -2", "line 1: there is no finger '-2'"),
        ("0 61 0", "line 1: no note of pitch 61 starts"),
        ("0.3 60 0", "line 1: no note of pitch 60 starts within 0.05 s of 0.3 s"),
        ("0 60 0\n0.01 60 1", "line 2: line 1 gives the same note another finger"),
    ],
)
def test_errors_name_the_line(tmp_path, text, message):
    with pytest.raises(CadenzaError, match=message) as caught:
        fingers(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "bytes").write_bytes(b"\xff\xfe\x00")
    for name, message in (
        ("missing", "there is no such file"),
        (".", "cannot"),
        ("bytes", "UTF-8"),
    ):
        with pytest.raises(CadenzaError, match=message):
            read_fingering(tmp_path / name, SCORE)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(score=scores())
def test_what_is_written_is_read_back(tmp_path, score):
    score = monophonic_per_key(score)
    write_fingering(score, tmp_path / "a.fingering")
    bare = Score(tuple(Note(n.start, n.end, n.pitch, n.velocity) for n in score.notes), score.pedal)
    assert read_fingering(tmp_path / "a.fingering", bare) == score
