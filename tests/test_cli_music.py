"""Which music the commands play, and which etudes they write, as a person asks for it."""

import json
import os
import re
import shlex
from dataclasses import asdict

import mido
import numpy as np
import pytest

from cadenza import load_song
from cadenza.cli import main
from cadenza.music.arrangement import Arrangement, load
from cadenza.music.etudes import KINDS, make_etude
from cadenza.music.expression import performed
from cadenza.music.expression_rules import ExpressionRules
from cadenza.music.formats.midi import read_midi, write_midi
from cadenza.music.formats.reading import name_without_ending
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.performing.arranging import arrange_song
from cadenza.scene.scene import build_scene
from refusals import refused, refused_in_a_line

QUICK = ("--agent", "zero", "--no-video")


@pytest.fixture
def trio(tmp_path):
    """Three instruments play four quarters each."""
    file = mido.MidiFile(ticks_per_beat=480)
    for channel, (name, pitch) in enumerate((("Flute", 76), ("Harp", 60), ("Cello", 45))):
        track = mido.MidiTrack([mido.MetaMessage("track_name", name=name)])
        track.append(mido.Message("program_change", channel=channel, program=73 - channel))
        for k in range(4):
            track.append(mido.Message("note_on", channel=channel, note=pitch + k))
            track.append(mido.Message("note_off", channel=channel, note=pitch + k, time=240))
        file.tracks.append(track)
    file.save(tmp_path / "trio.mid")
    return tmp_path / "trio.mid"


@pytest.fixture
def held(tmp_path):
    """A whole note of 4 s with a fermata."""
    note = (
        "<note><pitch><step>C</step><octave>4</octave></pitch><duration>4</duration>"
        "<notations><fermata/></notations></note>"
    )
    text = (
        "<score-partwise><part-list><score-part id='P1'><part-name/></score-part></part-list>"
        "<part id='P1'><measure><attributes><divisions>1</divisions></attributes>"
        f"<sound tempo='60'/>{note}</measure></part></score-partwise>"
    )
    path = tmp_path / "held.musicxml"
    path.write_text(text)
    return path


def test_plain_plays_the_notes_of_a_score_as_they_stand(held, capsys):
    for options, seconds in (([], "8.0 s"), (["--plain"], "4.0 s")):
        main(["info", str(held), *options])
        assert seconds in capsys.readouterr().out
    main(["play", str(held), "--plain", *QUICK, "-o", str(held.parent / "out")])
    metrics = json.loads((held.parent / "out/metrics.json").read_text())
    assert metrics["steps"] == 91  # half a second before the note, and 4 s


@pytest.mark.parametrize(
    ("song", "name"),
    [
        ("a/song.mid", "song"),
        ("b.c.MXL", "b.c"),
        ("OdeToJoy", "OdeToJoy"),
        ("library/Op. 28 No. 4", "Op. 28 No. 4"),
    ],
)
def test_results_are_called_as_the_song(song, name):
    assert name_without_ending(song) == name


def test_arrange_says_what_it_did(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main(["arrange", "cmajorscaleonehand"])  # the file has the letters of the piece's own name
    line = capsys.readouterr().out.splitlines()[-1]
    assert line.startswith("CMajorScaleOneHand.musicxml: 15 notes for the right hand, grade ")
    assert line.endswith(": as written, which hands can play")
    main(["arrange", "cmajorscaleonehand", "--arrange", "always"])
    assert capsys.readouterr().out.endswith(": all notes kept\n")


@pytest.mark.parametrize("how", [(), ("--arrange", "off"), ("--arrange", "always")])
def test_what_hands_can_play_is_arranged_only_if_one_asks(how, tmp_path, capsys):
    melody = [Note(n / 2, n / 2 + 0.25, 72) for n in range(8)]
    leaps = [Note(n / 2, n / 2 + 0.5, 48 if n % 2 else 36) for n in range(8)]
    inner = [Note(n / 2 + 0.25, n / 2 + 0.5, 60) for n in range(8)]
    write_midi(Score((*melody, *leaps, *inner)), tmp_path / "song.mid")
    main(["arrange", str(tmp_path / "song.mid"), *how, "-o", str(tmp_path / "sheet.mid")])
    kept = len(read_midi(tmp_path / "sheet.mid").notes)
    assert (kept < 24) == ("always" in how)
    assert ("as written" in capsys.readouterr().out) == ("always" not in how)


def test_info_lists_the_tracks(trio, capsys):
    main(["info", str(trio)])
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    heading = lines.index(["track", "notes", "range", "channel", "instrument", "name"])
    assert lines[heading + 1] == ["1", "4", "E5", "to", "G5", "1", "flute", "Flute"]
    assert lines[heading + 3] == ["3", "4", "A2", "to", "C3", "3", "clarinet", "Cello"]


def test_chords_that_follow_one_another_within_a_step_are_not_at_once(tmp_path, capsys):
    chords = [Note(0.33 * i, 0.33 * (i + 1), pitch + i) for i in range(3) for pitch in (60, 64, 90)]
    write_midi(Score(tuple(chords)), tmp_path / "song.mid")
    main(["info", str(tmp_path / "song.mid")])
    assert "at once    up to 3 keys" in capsys.readouterr().out


def test_info_tells_of_the_tracks_that_are_chosen(trio, capsys):
    main(["info", str(trio), "--tracks", "1", "3"])
    output = capsys.readouterr().out
    assert "MIDI 45 to 79" in output
    assert "notes      8" in output


def test_a_song_for_a_band_is_arranged_for_the_hands(tmp_path, capsys):
    play = ["play", "benchmark/band-1007", *QUICK, "--first-seconds", "6", "-o", str(tmp_path)]
    main(play)
    message = capsys.readouterr().err
    assert "benchmark/band-1007: arranged for both hands: " in message
    assert "; as written: --arrange off" in message
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["melody_kept"] > 0.9
    assert 0 < metrics["original_f1"] < 1
    remarks = json.loads((tmp_path / "settings.json").read_text())["remarks"]
    assert any("arranged for both hands" in remark for remark in remarks)
    fates = json.loads((tmp_path / "arrangement.json").read_text())
    moved = [fate for fate in fates if fate["played"] not in (None, fate["pitch"])]
    assert len(moved) == metrics["notes_moved"]
    left_out = [fate for fate in fates if fate["played"] is None and fate["part"] == "harmony"]
    assert left_out
    main([*play, "--arrange", "off"])
    assert "arranged" not in capsys.readouterr().err
    assert "melody_kept" not in json.loads((tmp_path / "metrics.json").read_text())
    assert not (tmp_path / "arrangement.json").exists()  # of the other performance


def test_music_that_the_hands_can_play_stays_as_it_is_unless_a_level_is_given(tmp_path, capsys):
    play = ["play", "MoonlightOpening", *QUICK, "--first-seconds", "6", "-o", str(tmp_path)]
    main(play)
    assert "arranged" not in capsys.readouterr().err
    expected = read_midi(tmp_path / "wanted.mid")
    written = load_song("MoonlightOpening").beginning(6.0)
    assert [n.pitch for n in expected.notes] == [n.pitch for n in written.notes]
    main([*play, "--level", "2"])
    assert "arranged for both hands: " in capsys.readouterr().err
    easy = read_midi(tmp_path / "wanted.mid")
    assert 0 < len(easy.notes) < len(written.notes)


def test_what_is_too_wide_for_two_hands_is_moved_by_octaves(trio, tmp_path, capsys):
    main(["play", str(trio), *QUICK, "-o", str(tmp_path)])
    message = capsys.readouterr().err
    assert "melody and bass whole, 100% of the other notes, 4 moved by octaves" in message
    assert len(read_midi(tmp_path / "wanted.mid").notes) == 12


def test_a_song_is_arranged_as_sheet_music(tmp_path, capsys):
    sheet, midi, pages = (tmp_path / f"song.{ending}" for ending in ("musicxml", "mid", "pdf"))
    for path in (sheet, midi, pages):
        how = "--first-seconds", "8", "--level", "5", "-o", str(path)
        main(["arrange", "benchmark/band-1007", *how])
        output = capsys.readouterr().out
        assert f"{path}: " in output
        assert " for both hands, grade " in output
    read = load_song(sheet)
    assert {note.finger.hand for note in read.notes if note.finger} == {0, 1}
    assert sorted(n.pitch for n in read.notes) == sorted(n.pitch for n in load_song(midi).notes)
    assert pages.read_bytes().startswith(b"%PDF-")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--level", "0"], "level 0: choose 1 to 10"),
        (["--level", "11"], "level 11: choose 1 to 10"),
        (["--arrange", "off", "--level", "3"], "as written, a song has no level"),
        (["-o", "song.txt"], "song.txt: sheet music is a .musicxml, .pdf, .svg or .mid file"),
    ],
)
def test_what_cannot_be_arranged_is_told_in_a_line(options, message, capsys):
    assert message in refused(capsys, "arrange", "benchmark/band-1007", *options)


def test_without_hands_no_level_is_ignored(capsys):
    message = refused(capsys, "play", "OdeToJoy", *QUICK, "--hands", "none", "--level", "2")
    assert "without hands, nothing can be arranged" in message


@pytest.mark.parametrize("option", [("--level", "3"), ("--arrange", "always")])
def test_what_is_learnt_is_not_arranged(option, tmp_path, capsys):
    folder = tmp_path / "run"
    message = refused(capsys, "train", "OdeToJoy", *option, "-o", folder)
    assert "songs are learnt as written: write an arrangement with cadenza arrange" in message
    assert not folder.exists()


def test_expression_is_that_of_the_arrangement():
    how = Arrangement(expression=1.0, first_seconds=6.0)
    scene = build_scene()
    written = arrange_song(load("benchmark/band-1007"), scene)
    played = arrange_song(load("benchmark/band-1007", how), scene)
    assert played.arranged.score == performed(written.arranged.score).beginning(6.0)
    assert played.original.total_time <= played.arranged.score.total_time
    assert len(played.original.notes) > len(played.arranged.score.notes)


def test_a_plan_of_some_tracks_is_replayed_with_them_and_no_others(trio, tmp_path, capsys):
    plan = tmp_path / "plan.safetensors"
    main(["plan", str(trio), "--tracks", "1", "3", "--planner.method", "none", "-o", str(plan)])
    _, *arguments = shlex.split(capsys.readouterr().out.strip().splitlines()[-1])
    assert arguments[-3:] == ["--tracks", "1", "3"]
    main([*arguments, "--no-video", "-o", str(tmp_path)])
    message = refused(capsys, *arguments[:-3], "-o", tmp_path)
    assert "was planned with tracks [1, 3], but here it is []" in message


def test_a_plan_with_expression_is_replayed_with_its_rules(tmp_path, capsys):
    plan, rules = tmp_path / "plan.safetensors", ["--expression", "0.5", "--rules.phrase-arch", "3"]
    main(["plan", "CMajorScaleOneHand", *rules, "--planner.method", "none", "-o", str(plan)])
    _, *arguments = shlex.split(capsys.readouterr().out.strip().splitlines()[-1])
    assert arguments[-4:] == ["--expression", "0.5", "--rules.phrase-arch", "3.0"]
    main([*arguments, "--no-video", "-o", str(tmp_path)])
    arrangement = json.loads((tmp_path / "settings.json").read_text())["arrangement"]
    assert arrangement["expression"] == 0.5
    assert arrangement["rules"] == asdict(ExpressionRules(phrase_arch=3.0))
    scale = load_song("CMajorScaleOneHand")
    expected = performed(scale, 0.5, ExpressionRules(phrase_arch=3.0))
    target = read_midi(tmp_path / "wanted.mid")
    assert [note.velocity for note in target.notes] == [note.velocity for note in expected.notes]
    message = refused(capsys, *arguments[:-2], "-o", tmp_path)
    assert "was planned with rules" in message


def test_rules_without_expression_are_refused(capsys):
    message = refused(capsys, "play", "OdeToJoy", "--rules.melody-lead", "2")
    assert "rules change nothing without expression: give --expression 1, too" in message
    assert "choose 0 to 10" in refused(
        capsys, "play", "OdeToJoy", "--expression", "1", "--rules.melody-lead", "11"
    )


def test_a_track_that_is_not_there(trio, capsys):
    assert "no track 4; the file has tracks 1 to 3" in refused(capsys, "info", trio, "--tracks", 4)
    message = refused(capsys, "play", "OdeToJoy", "--tracks", 2)
    assert "no track 2; the file has one track" in message


def test_a_file_whose_name_is_no_text_is_played(trio, tmp_path):
    path = trio.rename(tmp_path / os.fsdecode(b"pr\xe4ludium.mid"))
    arguments = ["play", str(path), *QUICK, "-o", str(tmp_path / "out"), "--tracks", "1"]
    main(arguments)
    assert (tmp_path / "out" / "report.html").is_file()


def test_musicxml_is_played_as_well(tmp_path, capsys):
    pitch = "<pitch><step>C</step><octave>4</octave></pitch>"
    measure = f"<measure><note>{pitch}<duration>1</duration></note></measure>"
    names = '<part-list><score-part id="P1"><part-name>Piano</part-name></score-part></part-list>'
    score = f'{names}<part id="P1">{measure}</part>'
    (tmp_path / "c.musicxml").write_text(f"<score-partwise>{score}</score-partwise>")
    main(["info", str(tmp_path / "c.musicxml")])
    assert "MIDI 60 to 60" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--stretch", "1e12"], "minutes; the longest is 60"),
        (["--stretch", "1e6"], "minutes; the longest is 60"),
        (["--stretch", "2000", "--random-stretch", "0.9"], "minutes; the longest is 60"),
        (["--initial-buffer-time", "3600"], "minutes; the longest is 60"),
        (["--control-timestep", "1e-9"], "control steps; the maximum is 720000"),
    ],
)
def test_songs_of_hours_are_refused(options, message, trio, tmp_path, capsys):
    line = refused(capsys, "play", trio, "--tracks", 1, *QUICK, *options, "-o", tmp_path / "out")
    assert message in line


def test_notes_too_fast_for_control_steps_are_told(tmp_path, capsys):
    song = tmp_path / "trill.mid"
    notes = tuple(Note(round(0.08 * i, 9), round(0.08 * i, 9) + 0.04, 60) for i in range(10))
    write_midi(Score(notes), song)
    command = ["play", str(song), "--agent", "zero", "--no-video", "-o", str(tmp_path / "out")]
    main(command)
    message = capsys.readouterr().err
    assert (
        message.count(f"{song}: 3 notes repeat too fast for control steps of 0.05 s, and are") == 1
    )
    main([*command, "--control-timestep", "0.02"])
    assert "too fast" not in capsys.readouterr().err


def test_remarks_on_a_file_are_counted_and_shown_if_one_asks(tmp_path, capsys):
    file, song = mido.MidiFile(), tmp_path / "twice.mid"
    track = mido.MidiTrack([mido.Message("control_change", control=67, value=127)])
    track += [mido.Message("note_on", note=60)] * 2 + [mido.Message("note_off", note=60, time=480)]
    file.tracks.append(track)
    file.save(song)
    command = ["play", str(song), *QUICK, "-o", str(tmp_path / "out")]
    main(command)
    assert capsys.readouterr().err == "2 remarks on the file (--verbose shows them)\n"
    main([*command, "--verbose"])
    assert f"{song}: the soft pedal is left out\n" in capsys.readouterr().err
    assert "the soft pedal is left out" in (tmp_path / "out" / "report.html").read_text()


def test_a_pedal_that_is_hardly_lifted_is_told(tmp_path, capsys):
    moves = ((0.0, 127), (0.5, 0), (0.51, 127), (0.9, 0))
    song = tmp_path / "pedal.mid"
    write_midi(Score((Note(0, 1, 60),), tuple(PedalEvent(*move) for move in moves)), song)
    options = ("--agent", "zero", "--no-video", "-q", "-o", str(tmp_path / "out"))
    main(["play", str(song), *options, "--repeats", "published"])
    message = "1 change of the pedal within a control step of 0.05 s is left out"
    assert message in capsys.readouterr().err
    assert message in (tmp_path / "out" / "report.html").read_text()
    main(["play", str(song), *options])
    assert "pedal" not in capsys.readouterr().err
    assert "pedal within" not in (tmp_path / "out" / "report.html").read_text()


def check_same(read: Score, made: Score) -> None:
    """To half a tick of the file."""
    table = [[(n.start, n.end, n.pitch, n.velocity) for n in s.notes] for s in (read, made)]
    np.testing.assert_allclose(*table, atol=2e-5, rtol=0)


def test_an_etude_is_written_and_read_back(tmp_path, capsys):
    path = tmp_path / "new" / "etude.mid"
    main(["etude", "--kind", "arpeggios", "--difficulty", "3", "--seed", "7", "-o", str(path)])
    expected = make_etude("arpeggios", 3, 7)
    output = capsys.readouterr().out
    assert f"{path}: {expected.title} (" in output
    name = output.split("cadenza play ")[1].strip()
    assert load_score(name).notes == expected.notes
    assert load_score(path).title == expected.title
    check_same(load_score(path), expected)


def test_what_is_not_given_is_drawn_and_said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main(["etude"])
    match = re.match(r"([a-z-]+)-3-(\d+)\.mid: ", capsys.readouterr().out)
    assert match
    kind, seed = match[1], match[2]
    check_same(load_score(f"{kind}-3-{seed}.mid"), make_etude(kind, 3, int(seed)))
    main(["etude", "--seed", seed])
    assert capsys.readouterr().out.startswith(f"{kind}-3-{seed}.mid: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--kind", "waltz"], f"no etudes of kind 'waltz': choose from {', '.join(KINDS)}"),
        (["--difficulty", "11"], "difficulty 11: choose 1 to 10"),
        (["--seed", "-1"], "seed -1: choose 0 or more"),
        (["-o", "etude.mp3"], "etude.mp3: an etude is a .mid file"),
    ],
)
def test_what_cannot_be_made_is_said_in_a_line(arguments, message, capsys):
    assert message in refused_in_a_line(capsys, "etude", *arguments)
