"""The songs of the experiment on multitask cloning, and its picture."""

import xml.etree.ElementTree as ET

import pytest

from benchmarks.multitask import FIRST, NOT_LEARNT, drawn, means, order, to_learn, write_songs
from cadenza.errors import CadenzaError
from cadenza.music.libraries.library import open_library


def test_sets_of_songs_grow_and_leave_the_last_out():
    songs = to_learn(20, "etudes:6")
    assert len(set(songs)) == 20
    assert songs[0] == FIRST
    assert songs[:4] == to_learn(4, None)
    assert songs[:16] == to_learn(16, "etudes:6")
    assert not set(songs) & set(order()[-NOT_LEARNT:])
    assert set(songs[16:]) <= {song.name for song in open_library("etudes:6").songs}


def test_says_how_many_songs_there_are():
    with pytest.raises(CadenzaError, match=r"17 songs to learn, but there are 16: .* --more"):
        to_learn(17, None)


def test_writes_songs_under_short_names_of_their_own(tmp_path):
    (song,) = open_library("etudes:1").songs
    seen, unseen = write_songs(tmp_path, [FIRST, song.name], [song.name])
    short = song.name.split("/")[1]
    assert [path.stem for path in (*seen, *unseen)] == [FIRST, short, f"{short}-2"]
    assert all(path.exists() for path in (*seen, *unseen))


def rows_of(songs: int, width: int, learnt: bool, *f1: float) -> list[dict[str, object]]:
    about = {"songs": songs, "width": width, "song": "A", "learnt": learnt}
    return [
        {**about, "seed": seed, "f1": value, "note_onset_f1": value / 2}
        for seed, value in enumerate(f1)
    ]


def test_means_and_their_picture():
    rows = rows_of(1, 256, True, 0.9, 1.0) + rows_of(2, 256, False, 0.2, 0.4)
    one, other = means(rows)
    assert (one.songs, one.learnt, one.f1) == (2, False, pytest.approx(0.3))
    assert (other.songs, other.learnt, other.f1) == (1, True, pytest.approx(0.95))
    assert other.low < 0.9  # Student's t of two values
    assert other.high > 1.0
    assert other.note_onset_f1 == pytest.approx(0.475)
    picture = ET.fromstring("".join(drawn([one, other])))
    assert "0.95 songs learnt, 256 units" in "".join(picture.itertext())


def test_widths_have_lines_of_their_own_and_labels_apart():
    rows = [
        row
        for width, f1 in ((256, 0.3), (1024, 0.31))
        for songs in (1, 2)
        for row in rows_of(songs, width, True, f1, f1)
    ]
    assert [(mean.width, mean.songs) for mean in means(rows)] == [
        (256, 1),
        (256, 2),
        (1024, 1),
        (1024, 2),
    ]
    picture = ET.fromstring("".join(drawn(means(rows))))
    svg = "{http://www.w3.org/2000/svg}"
    labels = {
        text.text: float(text.get("y", "nan"))
        for text in picture.iterfind(f".//{svg}g/{svg}text")
        if text.text
    }
    assert labels["0.30 songs learnt, 256 units"] - labels["0.31 songs learnt, 1024 units"] >= 16
