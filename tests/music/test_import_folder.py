"""Folders of music that become libraries of the user's."""

import errno
import shutil
import time
from pathlib import Path

import pytest

from cadenza.cli import main
from cadenza.music.formats.midi import write_midi
from cadenza.music.formats.reading import read_score
from cadenza.music.libraries.folder import import_folder
from cadenza.music.libraries.index import write_index
from cadenza.music.libraries.library import libraries, load_score, open_library
from cadenza.music.score import Note, Score
from refusals import refused

ROOT = Path(__file__).parents[2]
PIECES = ROOT / "src/cadenza/music/libraries/pieces"
TUNE = Score((Note(0.0, 0.5, 60), Note(0.5, 1.0, 64)), title="Of the file")
SHEET = """<?xml version="1.0"?><score-partwise version="3.1"><part-list><score-part id="P">
<part-name>P</part-name></score-part></part-list><part id="P"><measure number="1"><attributes>
<divisions>1</divisions></attributes><note><pitch><step>C</step><octave>4</octave></pitch>
<duration>4</duration><type>whole</type></note></measure></part></score-partwise>"""


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch):
    monkeypatch.setenv("CADENZA_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "music"
    for name in ("a/01.mid", "b/01.MIDI", "Prélude: nº 1; $(rm).mid", "a/one.mid", "a/ONE.midi"):
        write_midi(TUNE, place / name)
    for suffix in (".mid", ".fingering"):
        shutil.copy(PIECES / f"OdeToJoy{suffix}", place / f"joy{suffix}")
    (place / "sheet.musicxml").write_text(SHEET)
    (place / "notes.txt").write_text("no music")
    (place / "index.csv").write_text(
        "file,title,composer,split\na/01,First,Anna,train\njoy.mid,,Bert,valid\n"
    )
    return place


def test_karaoke_and_wrapped_midi_files_are_listed(tmp_path):
    for name in ("song.mid", "sung.kar", "wrapped.RMI"):
        write_midi(TUNE, tmp_path / name)
    names = [Path(song.name).name for song in open_library(tmp_path).songs]
    assert names == ["song.mid", "sung.kar", "wrapped.RMI"]


def test_names_are_safe_and_unique_and_facts_come_along(folder):
    imported = import_folder(folder, "mine")
    assert imported.left_out == []
    library = open_library("mine")
    assert [song.name for song in open_library("mine/joy").songs] == ["mine/joy"]
    songs = {song.name.removeprefix("mine/"): song for song in library.songs}
    assert sorted(songs) == sorted(
        ["a-01", "b-01", "a-ONE", "a-one-2", "Prélude-nº-1-rm", "joy", "sheet"]
    )
    assert library.splits == ("train", "valid")
    assert [song.title for song in open_library("mine:train").songs] == ["First"]
    joy = songs["joy"]
    assert (joy.title, joy.composer, joy.notes, joy.hands) == ("Ode to Joy", "Bert", 39, 2)
    assert joy.load().notes == load_score("OdeToJoy").notes
    assert joy.load().has_fingering
    assert songs["b-01"].title == "Of the file"
    assert songs["a-01"].load().title == load_score("mine/A-01").title == "First"
    assert (songs["sheet"].seconds, songs["sheet"].notes) == (2.0, 1)
    for song in library.songs:
        assert song.load().total_time == pytest.approx(song.seconds, abs=0.01)
    shutil.rmtree(folder)
    assert len(load_score("mine/sheet").notes) == 1


def test_a_line_with_the_path_of_a_file_is_of_no_other_of_the_same_name(tmp_path):
    for name in ("one.mid", "a/one.mid"):
        write_midi(TUNE, tmp_path / name)
    (tmp_path / "index.csv").write_text("file,title,split\none.mid,First,train\n")
    for library in open_library(tmp_path), open_library(import_folder(tmp_path, "mine").name):
        assert [song.split for song in library.songs] == ["", "train"]


def test_what_cannot_be_read_is_left_out_and_said(folder, capsys):
    (folder / "bad.mid").write_bytes(b"MThd")
    (folder / "list.xml").write_text("<list/>")
    (folder / "a" / "one.fingering").write_text("0 99 1\n")
    with (folder / "index.csv").open("a") as file:
        file.write("nowhere,,,\n")
    with pytest.raises(SystemExit) as stop:
        main(["import", "midi", str(folder), "--name", "mine"])
    assert stop.value.code == 1
    output = capsys.readouterr()
    assert output.out.startswith("6 songs; ")
    *lines, last = output.err.splitlines()
    assert [line.split(":")[0].removeprefix(f"{folder}/") for line in lines] == [
        "a/one.fingering, line 1",
        "bad.mid",
        "list.xml",
        "index.csv",
    ]
    assert last == "cadenza: mine: 4 of 10 could not be read and were left out"
    assert len(open_library("mine").songs) == 6


@pytest.mark.parametrize(
    "error", [RecursionError("too deep"), MemoryError(), ValueError("4300 digits"), KeyError("a")]
)
def test_no_file_ends_an_import_whatever_it_causes(folder, monkeypatch, error):
    read = read_score

    def fail(path: Path) -> Score:
        if path.name == "joy.mid":
            raise error
        return read(path)

    monkeypatch.setattr("cadenza.music.libraries.folder.read_score", fail)
    imported = import_folder(folder, "mine")
    (line,) = imported.left_out
    assert line.startswith(f"{folder / 'joy.mid'}: ")
    assert line.isprintable()
    assert type(error).__name__ in line
    assert len(imported.rows) == 6


def test_one_that_is_not_there_or_lies_elsewhere_loses_no_other(folder, monkeypatch):
    (folder / "away.mid").symlink_to(folder / "nowhere.mid")
    copy = shutil.copyfile

    def fail(source: Path, to: Path) -> object:
        if Path(source).name == "joy.mid":
            raise OSError(errno.EIO, "Input/output error", str(source))
        return copy(source, to)

    monkeypatch.setattr(shutil, "copyfile", fail)
    imported = import_folder(folder, "mine")
    assert imported.left_out == [
        f"{folder / 'away.mid'}: leads to {folder / 'nowhere.mid'}, where there is no file",
        f"[Errno 5] Input/output error: '{folder / 'joy.mid'}'",
    ]
    assert len(imported.rows) == 6


def test_importing_again(folder, data, capsys):
    again = ["import", "midi", str(folder), "--name", "mine", "--quiet"]
    main(again)
    kept = sorted(data.rglob("*.mid*"))
    (folder / "joy.mid").unlink()
    assert "there is a library mine already; import with --replace" in refused(capsys, *again)
    assert sorted(data.rglob("*.mid*")) == kept
    (folder / "index.csv").write_text("broken")
    refused(capsys, *again, "--replace")
    assert sorted(data.rglob("*.mid*")) == kept
    (folder / "index.csv").unlink()
    main([*again, "--replace"])
    assert len(open_library("mine").songs) == 6
    assert len(list(data.rglob("*.mid*"))) == 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pig", "music", "--name", "x"], "--name: the PIG dataset has a name; leave it out"),
        (["midi", "nowhere"], "nowhere: there is no such folder"),
        (["midi", "music", "--name", "bundled"], "there is a library bundled already"),
        (["midi", "music", "--name", "a/b"], "library name 'a/b': give up to 64 letters"),
        (["midi", "music", "--name", ".."], "library name '..': give up to"),
        (["midi", "music/empty", "--name", "x"], "x: not one piece can be read; none is there"),
    ],
)
def test_imports_that_make_no_sense(folder, data, arguments, message, capsys, monkeypatch):
    (folder / "empty").mkdir()
    monkeypatch.chdir(folder.parent)
    assert message in refused(capsys, "import", *arguments)
    assert "mine" not in libraries()
    assert not list(data.rglob("*.mid"))


def test_a_thousand_songs_are_listed_at_once(data, capsys):
    """From the index alone: there are no files."""
    rows = ((f"files-0/song{i}.mid", {"title": f"Song {i}", "seconds": i}) for i in range(1000))
    write_index(data / "libraries" / "many" / "index.csv", rows)
    began = time.process_time()
    main(["songs", "many", "--sort", "length"])
    took = time.process_time() - began
    assert len(capsys.readouterr().out.splitlines()) == 1000
    assert took < 0.3


def test_progress_is_told_and_difficulty_kept(folder):
    reports: list[tuple[int, int]] = []

    def tell(done: int, total: int) -> None:
        reports.append((done, total))

    import_folder(folder, "mine", progress=tell, grade=lambda score: len(score.notes) / 3)
    assert reports == [(done, 7) for done in range(7)]
    grades = {song.title: song.difficulty for song in open_library("mine").songs}
    assert (grades["Ode to Joy"], grades["First"]) == (13.0, 0.67)


def test_folders_within_each_other_are_read_however_many_there_are(tmp_path):
    for depth, name in (0, "tune.mid"), (60, "inner.mid"), (500, "innermost.mid"):
        write_midi(TUNE, tmp_path.joinpath(*["d"] * depth) / name)
    names = [Path(song.name).name for song in open_library(tmp_path).songs]
    assert sorted(names) == ["inner.mid", "innermost.mid", "tune.mid"]


def test_a_line_for_each_file_whatever_it_is_called(folder, capsys):
    (folder / "a\nb\x1b[31m.mid").write_bytes(b"nothing")
    message = refused(capsys, "import", "midi", folder, "--name", "mine")
    assert "a\\nb\\x1b[31m.mid: not a MIDI file" in message
    assert "\x1b" not in message
