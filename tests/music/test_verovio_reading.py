"""Humdrum and MEI, against what they say."""

import random
from contextlib import suppress

import pytest

from cadenza.errors import CadenzaError
from cadenza.music.formats.reading import ending_of, read_score

# Two staves, a tie, a chord, a repeat, and a tempo of 60 quarters a minute.
HUMDRUM = """!!!OTL: A tune
**kern\t**kern
*staff2\t*staff1
*clefF4\t*clefG2
*M2/4\t*M2/4
*MM60\t*MM60
=1\t=1
4C\t4c
4D\t[4e
=2\t=2
2E 2G\t4e]
.\t4f#
=:|!\t=:|!
*-\t*-
"""
ONCE = [(0, 1, 48), (0, 1, 60), (1, 1, 50), (1, 2, 64), (2, 2, 52), (2, 2, 55), (3, 1, 66)]

MEI = """<?xml version="1.0" encoding="{encoding}"?>
<mei xmlns="http://www.music-encoding.org/ns/mei" meiversion="5.0"><music><body><mdiv><score>
<scoreDef meter.count="2" meter.unit="4" midi.bpm="60">
<staffGrp><staffDef n="1" lines="5" clef.shape="G" clef.line="2"/></staffGrp></scoreDef>
<section><measure n="1"><staff n="1"><layer n="1">
<note dur="4" pname="c" oct="4"/><note dur="4" pname="f" oct="4" accid="s"/>
</layer></staff></measure></section></score></mdiv></body></music></mei>"""


def played(path):
    return [(round(n.start, 3), round(n.end - n.start, 1), n.pitch) for n in read_score(path).notes]


@pytest.mark.parametrize("name", ["tune.krn", "tune.txt"])
def test_humdrum_is_played_with_its_repeats(tmp_path, name):
    path = tmp_path / name
    path.write_text(HUMDRUM)
    again = [(start + 4, length, pitch) for start, length, pitch in ONCE]
    assert played(path) == ONCE + again
    score = read_score(path)
    assert [bar.number for bar in score.bars] == [1, 2, 3, 4]
    assert [track.notes for track in score.tracks] == [6, 8]
    assert "Humdrum" in score.remarks[0]
    upper = read_score(path, [1])
    lower = read_score(path, [2])
    assert sorted(upper.notes + lower.notes, key=lambda n: (n.start, n.pitch)) == list(score.notes)


@pytest.mark.parametrize("name", ["tune.mei", "tune.xml"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_mei_is_played(tmp_path, name, encoding):
    path = tmp_path / name
    path.write_bytes(MEI.format(encoding=encoding).encode(encoding))
    assert played(path) == [(0, 1, 60), (1, 1, 66)]


def test_files_without_music_are_refused_in_a_line(tmp_path):
    for name, text in (
        ("a.krn", "**kern\t**kern\n4c\n*-\n"),
        ("b.mei", "<mei/>"),
        ("c.xml", '<mei xmlns="http://www.music-encoding.org/ns/mei"><music/></mei>'),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(CadenzaError, match=r"cannot be read as .*MuseScore"):
            read_score(tmp_path / name)


def test_damaged_files_are_read_or_refused(tmp_path):
    rng = random.Random(0)
    for i in range(6):
        content = bytearray((HUMDRUM if i % 2 else MEI.format(encoding="utf-8")).encode())
        for _ in range(20):
            content[rng.randrange(len(content))] = rng.randrange(256)
        path = tmp_path / ("a.krn" if i % 2 else "a.mei")
        path.write_bytes(content)
        with suppress(CadenzaError):
            assert read_score(path).notes


@pytest.mark.parametrize(
    ("content", "ending"),
    [
        (b"MThd", ".mid"),
        (b"PK\x03\x04", ".mxl"),
        (b"\xef\xbb\xbf<?xml?><score-partwise>", ".musicxml"),
        (b"<?xml?>\n<!-- <meinong> -->", ".musicxml"),
        ("<?xml?><mei xmlns='a'>".encode("utf-16"), ".mei"),
        (b"<?xml?><mei:mei>", ".mei"),
        (b"!!!COM: Bach\n**kern", ".krn"),
        (b"", ".mid"),
    ],
)
def test_the_first_bytes_say_what_a_file_is(content, ending):
    assert ending_of(content) == ending
