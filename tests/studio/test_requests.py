"""Requests of a visitor, and files that a visitor drops."""

import json
import os
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from cadenza.agents.agent import silent
from cadenza.errors import CadenzaError
from cadenza.files import write_json
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.imported import new_library
from cadenza.music.score import Note, Score
from cadenza.studio import storage, upload_reader
from cadenza.studio.player import error_text, set_up_order
from cadenza.studio.request import AGENTS, Order, PlayRequest, practice_folder, read_request
from cadenza.studio.storage import KeptPerformance, Storage, Upload

SCORE = Score(tuple(Note(0.2 * i, 0.2 * i + 0.2, 60 + i) for i in range(4)), title="Four")


def read(content: object) -> PlayRequest:
    return read_request(content, AGENTS, ["shadow"])


@pytest.mark.parametrize(
    ("hands", "playing", "as_written"),
    [("both", "both", False), ("written", "both", True), ("left", "left", False)],
)
def test_a_request_says_which_hand_plays_what(hands, playing, as_written, tmp_path):
    request = read({"song": "CMajorScaleTwoHands", "hands": hands})
    order = Order(request, "", request.song, False, "0" * 16, str(tmp_path))
    with set_up_order(order, silent) as setup:
        assert setup.task.scene.config.hands == playing
        assert setup.task.config.hands_as_written is as_written
        (track,) = setup.task.tracks
        assert len(track.score.notes) == (15 if playing == "left" else 30)


def test_a_request_says_what_is_to_be_played():
    request = read({"song": "OdeToJoy", "tempo": 2, "tracks": [1, 2], "plain": True})
    assert request == PlayRequest("OdeToJoy", tempo=2.0, tracks=(1, 2), plain=True)
    assert request.arrangement == Arrangement((1, 2), plain=True)
    assert read({"song": "OdeToJoy", "level": 4}).arrangement == Arrangement(level=4)
    assert read({"song": "OdeToJoy", "arrange": "off"}).arrangement == Arrangement(arrange="off")
    assert read({"song": "OdeToJoy", "expression": True}).arrangement.expression == 1.0


@pytest.mark.parametrize(
    "content",
    [
        {},
        {"song": 1},
        {"song": "OdeToJoy", "agent": "os:system"},
        {"song": "OdeToJoy", "agent": "policy/../../etc"},
        {"song": "OdeToJoy", "hand": "os:system"},
        {"song": "OdeToJoy", "hands": "none"},
        {"song": "OdeToJoy", "tempo": 0},
        {"song": "OdeToJoy", "transpose": 1000},
        {"song": "OdeToJoy", "seed": -1},
        {"song": "OdeToJoy", "expression": 1},
        {"song": "OdeToJoy", "tracks": list(range(1000))},
        {"song": "OdeToJoy", "arrange": "perhaps"},
        {"song": "OdeToJoy", "level": 11},
        {"song": "OdeToJoy", "level": 3, "arrange": "off"},
        {"song": "OdeToJoy", "video": "/etc/passwd"},
    ],
)
def test_what_cannot_be_asked_for_is_refused_in_a_line(content):
    with pytest.raises(CadenzaError) as refused:
        read(content)
    assert "\n" not in str(refused.value)
    assert "another version" not in str(refused.value)  # as is said of files


@pytest.fixture
def songs(tmp_path):
    return Storage(tmp_path)


def add(songs: Storage, content: bytes, name: str) -> Upload:
    path, id, title, ending = songs.write_upload(content, name)
    assert path.read_bytes() == content
    assert path.resolve().is_relative_to(songs.folder.resolve())
    upload = Upload(id, title, ending, 1.0, 1)
    songs.list_upload(upload)
    return upload


@pytest.mark.parametrize("name", ["../../evil.mid", "/etc/passwd", "a\0b.mid", "", "é" * 5000])
def test_names_are_shown_but_lead_nowhere(songs, name):
    upload = add(songs, b"MThd", name)
    (listed, *_) = songs.songs()
    assert listed["title"] == upload.title
    assert upload.title.isprintable()
    assert 0 < len(upload.title) <= 100
    assert len(list(songs.folder.rglob("*"))) == 3  # the folder of uploads, the file, what it holds


@pytest.mark.parametrize("song", ["../uploads/x", "/etc/passwd", "0" * 16, "no such"])
def test_a_song_that_is_not_there_is_refused(songs, song):
    with pytest.raises(CadenzaError, match="no such song"):
        songs.source(song)


def test_no_upload_is_lost_for_another(songs, monkeypatch):
    monkeypatch.setattr(storage, "MAX_UPLOADS", 2)
    first, second = (add(songs, b"MThd%d" % i, f"{i}.mid") for i in range(2))
    with pytest.raises(CadenzaError, match="2 files of yours already; delete some"):
        songs.write_upload(b"MThd2", "2.mid")
    add(songs, b"MThd0", "0.mid")  # again
    listed = [song["id"] for song in songs.songs() if song["uploaded"]]
    assert sorted(listed) == sorted([first.id, second.id])
    songs.remove_upload(first.id)
    add(songs, b"MThd2", "2.mid")


def test_uploads_that_nobody_has_read_do_not_stay(songs):
    """The studio was killed meanwhile; a file that another studio just reads stays."""
    listed = add(songs, b"MThd0", "0.mid")
    killed = songs.write_upload(b"MThd1", "1.mid")[0]
    now, *_ = songs.write_upload(b"MThd2", "2.mid")
    begun, theirs = songs.uploads / ".cadenza-1", songs.uploads / "mine.mid"
    for path in killed, begun, theirs:
        path.touch()
        os.utime(path, (0, 0))
    left = {f"{listed.id}.json", f"{listed.id}.mid", now.name, theirs.name}
    assert {path.name for path in Storage(songs.folder).uploads.iterdir()} == left


def test_practice_is_of_what_a_song_holds_now():
    request, score = PlayRequest("library/song"), Score((Note(0.0, 1.0, 60),))
    folder = practice_folder(Path("x"), request, score)
    assert folder == practice_folder(Path("x"), request, replace(score, title="renamed"))
    assert folder != practice_folder(Path("x"), request, score.transposed(1))


def test_performances_are_found_again_and_removed(songs):
    id = "0123456789abcdef"
    kept = KeptPerformance("Ode", PlayRequest("OdeToJoy"), "Well.", 8.0, 1.0)
    (songs.folder / id).mkdir()
    write_json(songs.folder / id / "studio.json", asdict(kept))
    (songs.folder / id / "report.html").write_text("report")
    (songs.folder / "fedcba9876543210").mkdir()  # somebody else's
    again = Storage(songs.folder)
    (performance,) = again.performances()
    assert (performance["id"], performance["title"], performance["files"]) == (
        id,
        "Ode",
        ["report.html"],
    )
    assert again.file(id, "report.html").read_text() == "report"
    for wrong in (id, "settings.json"), (id, "../x"), ("..", "report.html"), ("x", "report.html"):
        with pytest.raises(CadenzaError, match="there is no such"):
            again.file(*wrong)
    again.remove_performance(id)
    assert again.performances() == []
    with pytest.raises(CadenzaError, match="no such performance"):
        again.remove_performance("uploads")


def test_a_file_is_read_by_a_process_that_says_what_it_holds(tmp_path):
    path = tmp_path / "a.mid"
    write_midi(Score((Note(0.0, 1.0, 60), Note(1.0, 2.0, 62))), path)
    command = [sys.executable, "-P", "-m", "cadenza.studio.upload_reader", str(path)]
    answer = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    assert (answer["notes"], answer["seconds"]) == (2, 2.0)


@pytest.mark.parametrize("content", [b"MThd", b"", b"<score", b"PK\3\4", b"\x89PNG" * 100])
def test_what_is_no_music_is_refused_in_a_line(songs, capsys, monkeypatch, content):
    path, *_ = songs.write_upload(content, "song.mid")
    monkeypatch.setattr(sys, "argv", ["upload_reader", str(path)])
    monkeypatch.setattr(upload_reader, "limit", lambda _: None)  # not on the process of the tests
    upload_reader.main()
    error = json.loads(capsys.readouterr().out)["error"]
    assert error
    assert "\n" not in error
    assert str(path) not in error


def test_what_fails_says_where_no_upload_lies_and_what_a_piece_is_called():
    def said(source: str, uploaded: bool) -> str:
        order = Order(PlayRequest("x"), "", source, uploaded, "0" * 16, "")
        return error_text(CadenzaError(f"{source}: nobody\nknows '{source}'"), order)

    assert said("/home/me/x.mid", True) == "nobody knows 'the file'"
    assert said("OdeToJoy", False) == "OdeToJoy: nobody knows 'OdeToJoy'"


@pytest.mark.parametrize(
    ("notes", "why"),
    [
        ((), "no notes"),
        ((Note(3600.0, 3601.0, 60),), "half an hour"),
        (tuple(Note(0.01 * i, 0.01 * i + 0.01, 60) for i in range(40_001)), "40001 notes"),
    ],
)
def test_there_is_a_limit_to_what_is_played(notes, why):
    with pytest.raises(CadenzaError, match=why):
        upload_reader.check_size(Score(notes))


def test_imported_libraries_are_listed(songs, tmp_path, monkeypatch):
    monkeypatch.setenv("CADENZA_DATA", str(tmp_path / "data"))
    with new_library("mine") as library:
        write_midi(SCORE, library.folder / "four.mid")
        library.add("four.mid", SCORE, {"title": "Four notes"})
    (song,) = (song for song in songs.songs() if song["id"] == "mine/four")
    assert (song["title"], song["seconds"]) == ("Four notes", SCORE.total_time)
    assert songs.source("mine/four") == ("Four notes", "mine/four", False)
    with pytest.raises(CadenzaError, match="no such song"):
        songs.source("mine/../four")
