"""Song libraries: bundled, of a folder, imported."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.music.etudes import make_etude
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.library import libraries, load_score, open_library
from cadenza.music.score import Note, Score
from mutations import at_most_refused, other_bytes

TUNE = Score((Note(0.0, 0.5, 60), Note(0.5, 1.0, 64)), title="Of the file")


@pytest.fixture
def folder(tmp_path):
    """With an index of two of its three files."""
    place = tmp_path / "music"
    for name in ("midi/one.mid", "midi/Two.MID", "three.mid", ".hidden/no.mid", "midi/._one.mid"):
        write_midi(TUNE, place / name)
    (place / "index.csv").write_bytes(
        b"\xef\xbb\xbfID, Title ,composer,split,seconds,difficulty\r\n"
        b'one,"One, or the first",Anna,train,1.5,3.5\r\n'
        b"midi/Two.MID,,Bert,valid,nan,hard\r\n\r\n"
    )
    return place


@pytest.mark.parametrize("name", ["bundled", "debug"])
def test_bundled_songs_load_under_their_names(name):
    library = open_library(name)
    assert (library.name, library.splits) == (name, ())
    assert 5 <= len(library.songs) <= 24
    for song in library.songs:
        score = song.load()
        assert score == load_score(song.name) == load_score(f"{name}/{song.name}")
        assert (score.title, score.total_time) == (
            song.title,
            pytest.approx(song.seconds, abs=0.01),
        )
    assert all(song.seconds <= 20 for song in open_library("debug").songs)


def test_a_folder_with_an_index(folder):
    library = open_library(folder)
    by_file = {Path(song.name).name: song for song in library.songs}
    one, two, three = (by_file.pop(name) for name in ("one.mid", "Two.MID", "three.mid"))
    assert not by_file
    assert (one.title, one.composer, one.split) == ("One, or the first", "Anna", "train")
    assert (one.seconds, one.difficulty) == (1.5, 3.5)
    assert (two.title, two.composer, two.seconds, two.difficulty) == ("", "Bert", None, None)
    assert (three.title, three.split) == ("", "")
    assert one.load().title == "One, or the first"
    assert two.load() == load_score(two.name) == TUNE
    assert pickle.loads(pickle.dumps(two)).load() == TUNE


def test_splits(folder):
    assert open_library(folder).splits == ("train", "valid")
    (song,) = open_library(f"{folder}:valid").songs
    assert song.composer == "Bert"
    with pytest.raises(CadenzaError, match=r"no split 'test'; choose from train, valid"):
        open_library(f"{folder}:test")
    for split in "valid", "":  # "bundled:" is no way to say all of it
        with pytest.raises(
            CadenzaError, match=rf"bundled: there is no split {split!r}; it has none"
        ):
            open_library(f"bundled:{split}")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("title,composer\na,b\n", r"index\.csv:1: no column says which file"),
        ("", r"index\.csv: the file is empty"),
        ("file,title\none,\n,x\n", r"index\.csv:3: names no file"),
        ("file\none\ntwo\none\n", r"index\.csv:4: a second line for 'one'"),
        ('file\n"one\n', r"index\.csv:2: not a table as CSV"),
        ("file\none\n\udcff\n", r"index\.csv:3: not text in UTF-8"),
    ],
)
def test_an_index_that_is_wrong_is_said_to_be(folder, content, message):
    (folder / "index.csv").write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(CadenzaError, match=message):
        open_library(folder)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_a_damaged_index_is_at_most_refused(tmp_path_factory, seed):
    place = tmp_path_factory.mktemp("music")
    (place / "a.mid").write_bytes(b"")
    rows = b'file,title,seconds,notes\r\na.mid,"A, ""B""",1.5,3\r\nb,,,\r\n'
    rng = np.random.default_rng(seed)
    (place / "index.csv").write_bytes(other_bytes(rng, other_bytes(rng, rows) or b"x"))
    with at_most_refused():
        open_library(place)


def test_etudes():
    library = open_library("etudes:30:7")
    assert len({song.name for song in library.songs}) == len(library.songs) == 30
    assert library.songs == open_library("etudes:40:7").songs[:30]
    assert library.songs != open_library("etudes:30").songs
    alike = open_library("etudes:notes-6:3").songs
    assert [song.load() for song in alike] == [make_etude("notes", 6, seed) for seed in range(3)]
    song = pickle.loads(pickle.dumps(library.songs[0]))
    assert song.load() == load_score(song.name)
    assert {song.difficulty for song in library.songs} <= {float(i) for i in range(1, 11)}
    with pytest.raises(CadenzaError, match="has no tracks to choose from"):
        song.load((1,))
    for wrong in ("", "x", "1:2:3", "notes-6:0", 5000 * "9"):
        with pytest.raises(CadenzaError, match="give how many, such as etudes:300"):
            open_library(f"etudes:{wrong}")
    with pytest.raises(CadenzaError, match="no etude named 'etudes/scales'"):
        load_score("etudes/scales")
    with pytest.raises(CadenzaError, match="no etude named"):
        load_score("etudes/scales-3-" + 5000 * "9")


def test_a_song_is_a_library_of_one(folder):
    (song,) = open_library("odetojoy").songs
    assert song.name == "OdeToJoy"
    (song,) = open_library(folder / "three.mid").songs
    assert song.load().notes == TUNE.notes


def test_libraries_that_there_are_not(folder):
    with pytest.raises(CadenzaError, match="no song library 'bundle': did you mean bundled"):
        open_library("bundle")
    with pytest.raises(CadenzaError, match="no song library '/nowhere:valid'"):
        open_library("/nowhere:valid")
    (folder / "empty").mkdir()
    with pytest.raises(CadenzaError, match="there is no file of music in it"):
        open_library(folder / "empty")


@pytest.mark.parametrize("name", ["etude-12", "repertoire-150"])
def test_a_dataset_that_is_not_there_says_how_to_get_it(name):
    assert name in libraries()
    for ask in (lambda: open_library(name), lambda: load_score(f"{name}/GolliwoggsCakewalk")):
        with pytest.raises(CadenzaError, match=r"https://.*`cadenza import pig FILE\.zip`"):
            ask()


def test_the_list_of_libraries(capsys):
    main(["libraries"])
    output = capsys.readouterr()
    rows = {line.split()[0]: line.split()[1:3] for line in output.out.splitlines()}
    assert rows["bundled"] == ["24", "songs"]
    assert rows["etude-12"] == ["not", "there"]
    assert output.err.count("\n") == 1


def test_songs_are_listed_and_sorted(folder, capsys):
    main(["songs", "bundled", "--sort", "length"])
    lines = capsys.readouterr().out.splitlines()
    seconds = [float(line.split(" s ")[0].split()[-1]) for line in lines]
    assert seconds == sorted(seconds)
    main(["songs", str(folder), "--sort", "difficulty"])
    assert "One, or the first (Anna)" in capsys.readouterr().out.splitlines()[0]
    main(["songs", f"{folder}:valid"])
    assert "Two.MID" in capsys.readouterr().out
