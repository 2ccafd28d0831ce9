import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.music.formats.midi import write_midi
from cadenza.music.goals import score_to_goals
from cadenza.music.libraries.library import load_score, songs
from cadenza.music.score import Note, Score
from numbered import FIVE, recorded_note

ROOT = Path(__file__).parents[2]
RECORDED = json.loads((ROOT / "tests/data/songs.json").read_text())
PIECES = ROOT / "src/cadenza/music/libraries/pieces"
TUNE = Score((Note(0.0, 1.0, 60), Note(1.0, 2.0, 64)))
NAMES = [piece.name for piece in songs()]


def hand(note: Note) -> int:
    return note.finger.hand


@pytest.fixture(params=NAMES)
def score(request):
    return load_score(request.param)


def at_once(score: Score):
    """Pairs of notes that sound at the same time, the lower pitch first."""
    for a, b in combinations(score.notes, 2):
        if a.start < b.end and b.start < a.end:
            yield (a, b) if a.pitch < b.pitch else (b, a)


def test_there_are_pieces_from_easy_to_hard():
    grades = [piece.difficulty for piece in songs()]
    assert len(grades) >= 16
    assert min(grades) < 2 < 5 < max(grades)


@pytest.mark.parametrize("piece", songs(), ids=NAMES)
def test_the_index_tells_the_truth(piece):
    score = load_score(piece.name)
    assert score.title == piece.title
    assert score.total_time == pytest.approx(piece.seconds, abs=0.01)
    assert {hand(note) for note in score.notes} == set(range(piece.hands))
    assert 4 <= piece.seconds <= 30
    assert piece.name.isidentifier()  # it is part of an environment's id
    assert piece.composer
    assert "public domain" in piece.source or "belongs to nobody" in piece.source


def test_every_note_has_a_finger_and_needs_no_repair(score):
    assert all(note.finger for note in score.notes)
    assert score.remarks == ()
    assert score.notes[0].start <= 1


def test_no_finger_plays_two_keys_at_once(score):
    assert all(low.finger != high.finger for low, high in at_once(score))
    fingers = score_to_goals(score, 0.05, hands=FIVE).fingers
    for step in fingers:
        used = step[step >= 0]
        assert len(used) == len(np.unique(used))


def test_hands_neither_overlap_nor_cross(score):
    for low, high in at_once(score):
        assert low.pitch < high.pitch
        assert hand(low) >= hand(high)  # the left hand, 1, is below the right, 0


def test_chords_lie_in_one_hand_without_crossed_fingers(score):
    for low, high in at_once(score):
        if hand(low) == hand(high):
            assert high.pitch - low.pitch <= 12
            assert (high.finger.index > low.finger.index) == (hand(low) == 0)


@pytest.mark.parametrize("name", RECORDED)
def test_six_songs_are_those_of_the_published_system(name):
    expected = Score(tuple(recorded_note(*values) for values in RECORDED[name]["notes"]))
    assert load_score(name).notes == expected.notes
    assert load_score(name).pedal == ()


# The contour of the melody after its first note: Up, Down or Repeat (Parsons, 1975).
@pytest.mark.parametrize(
    ("name", "contour"),
    [
        ("TwinkleTwinkleLittleStar", "RURURDDRDRDRD"),
        ("OdeToJoy", "RUURDDDDRUURDRURUURDDDDRUUDDR"),
        ("MaryHadALittleLamb", "DDUURRDRRUURDDDUURRRDRUDD"),
        ("FrereJacques", "UUDRUUDUUUDUURUDDDDUUDDDDRDURDU"),
        ("AuClairDeLaLune", "RRUUDDUDRDRRRUUDDUDRD"),
        ("JingleBells", "RRRRRRUDUUURRRRDRRRRDRUDU"),
        ("InTheHallOfTheMountainKing", "UUUUDUDDUDDUDUUUUDUUDDDUU"),
        ("FurEliseOpening", "DUDUDUDDDUUUDUUUDUDUDUDUDDDUUUDUDD"),
        ("MinuetInG", "DUUUUDRUDUUUUDRUUDDDUUDDDDUUUDU"),
        ("Greensleeves", "UUUUDDDDUUUDRDUUDDU"),
    ],
)
def test_melodies_go_up_and_down_as_they_should(name, contour):
    melody = [note.pitch for note in load_score(name).notes if hand(note) == 0]
    steps = np.sign(np.diff(melody))[: len(contour)]
    assert "".join("RUD"[step] for step in steps) == contour


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        ("OdeToJoy", "C D E F G"),
        ("CanonInDOpening", "D E F# G A B C#"),
        ("MinuetInG", "G A B C D E F#"),
        ("GymnopedieOpening", "D E F# G A B C#"),
        ("HarmonicMinorScale", "A B C D E F G#"),
        ("MoonlightOpening", "C# D# E F# G# A B C D"),  # with B sharp and the Neapolitan's D
        ("FurEliseOpening", "A B C D D# E G#"),
        ("SonataFacileOpening", "C D E F G A B"),
    ],
)
def test_no_note_is_foreign_to_the_piece(name, scale):
    letters = ["C", "C#", "D", "D#", "E", "F", "F#", "G", "G#", "A", "A#", "B"]
    used = {letters[note.pitch % 12] for note in load_score(name).notes}
    assert used <= set(scale.split())


def test_some_pieces_use_the_pedal():
    held = [name for name in NAMES if score_to_goals(load_score(name), 0.05).sustain.any()]
    assert {"MoonlightOpening", "GymnopedieOpening", "FurEliseOpening"} <= set(held)
    assert "BachPreludeInCMajor" not in held


def test_names_may_be_written_in_any_case():
    assert load_score("odetojoy") == load_score("OdeToJoy")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("OdeToJoi", "did you mean OdeToJoy.*cadenza songs"),
        ("minuet", "did you mean MinuetInG"),
        ("qqqqqq", "no song named 'qqqqqq': run `cadenza songs`"),
        ("", "no song named ''"),
        ("../secret", "no song named"),
        ("null\0character", "no song named"),
        ("long" * 1000, "no song named"),
    ],
)
def test_unknown_names_get_a_suggestion(wrong, message):
    with pytest.raises(CadenzaError, match=message) as caught:
        load_score(wrong)
    assert "\n" not in str(caught.value)


def test_a_file_brings_its_fingering_along(tmp_path):
    shutil.copy(PIECES / "OdeToJoy.mid", tmp_path / "mine.MID")
    path = tmp_path / "mine.MID"
    assert not load_score(str(path)).has_fingering
    shutil.copy(PIECES / "OdeToJoy.fingering", tmp_path / "mine.fingering")
    assert load_score(str(path)).notes == load_score("OdeToJoy").notes
    assert load_score(path) == load_score(str(path))


def test_a_fingering_that_does_not_fit_is_an_error(tmp_path):
    write_midi(Score((Note(0, 1, 60),)), tmp_path / "a.mid")
    shutil.copy(PIECES / "OdeToJoy.fingering", tmp_path / "a.fingering")
    with pytest.raises(CadenzaError, match=re.escape("a.fingering, line 2: no note of pitch 48")):
        load_score(tmp_path / "a.mid")


@pytest.mark.parametrize("name", ["song", "song.kar", "song.mid.backup"])
def test_any_file_that_is_there_is_read_whatever_its_suffix(tmp_path, monkeypatch, name):
    shutil.copy(PIECES / "OdeToJoy.mid", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    notes = [(note.start, note.pitch) for note in load_score("OdeToJoy").notes]
    for path in (name, Path(name), tmp_path / name):
        assert [(note.start, note.pitch) for note in load_score(path).notes] == notes


def test_a_file_that_is_no_midi_is_refused_and_a_folder_hides_no_piece(tmp_path, monkeypatch):
    (tmp_path / "OdeToJoy").mkdir()
    (tmp_path / "words.txt").write_text("hello")
    monkeypatch.chdir(tmp_path)
    assert load_score("OdeToJoy").title
    with pytest.raises(CadenzaError, match="not a MIDI file"):
        load_score("words.txt")


def test_listing_songs_does_not_load_the_midi_or_metrics_libraries():
    code = (
        "import sys; from cadenza.music.libraries.library import songs; songs(); "
        "sys.exit(' '.join({'mido', 'mir_eval', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.strip() == ""


def test_a_missing_file_is_guessed_at(tmp_path):
    write_midi(TUNE, tmp_path / "Nocturne.mid")
    with pytest.raises(CadenzaError, match=r"no such file; did you mean .*Nocturne\.mid\?"):
        load_score(tmp_path / "nocturn.mid")
    with pytest.raises(CadenzaError, match="no such file; there is no folder"):
        load_score(tmp_path / "nowhere" / "Nocturne.mid")


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("song.mscz", "MuseScore"),
        ("song.gp5", "MuseScore"),
        ("song.SIB", "MuseScore"),
        ("song.abc", "abc2midi"),
        ("song.ly", "LilyPond"),
        ("song.mp3", "transcription"),
        ("song.wav", "transcription"),
        ("song.pdf", "recognition"),
    ],
)
def test_formats_that_are_not_read_say_how_to_get_one_that_is(name, advice, tmp_path):
    (tmp_path / name).write_bytes(b"something")
    with pytest.raises(CadenzaError, match=f"files cannot be read; .*{advice}"):
        load_score(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "title"),
    [
        (b"pr\xe4ludium.mid", "pr\ufffdludium"),
        (b"n" * 251 + b".mid", "n" * 251),
        (b"...mid", ".."),
        (b"a\nb\x1b[31m.mid", "a b [31m"),
    ],
)
def test_names_that_no_terminal_can_print_and_names_as_long_as_can_be(name, title, tmp_path):
    path = tmp_path / os.fsdecode(name)
    untitled = replace(TUNE, title="")
    write_midi(untitled, tmp_path / "song.mid")
    (tmp_path / "song.mid").rename(path)
    assert load_score(path).title == title
