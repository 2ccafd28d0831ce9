"""What Humdrum and MEI say, and in which order they are played, by the rules of these formats.

In the tests of order each bar is a whole note, at 60 quarters a minute, which lasts four seconds.
"""

import random
from contextlib import suppress

import pytest

from cadenza.errors import CadenzaError
from cadenza.music.formats import verovio_reading
from cadenza.music.formats.reading import ending_of, read_score

DOCUMENT = """<mei xmlns="http://www.music-encoding.org/ns/mei" meiversion="5.0"><music><body><mdiv>
<score><scoreDef meter.count="4" meter.unit="4" midi.bpm="60"><staffGrp>
<staffDef n="1" lines="5" clef.shape="G" clef.line="2"/></staffGrp></scoreDef>
<section>{}</section></score></mdiv></body></music></mei>"""
END, START = 'right="rptend"', 'left="rptstart"'
TIE = '<tie startid="#x" endid="#y"/>'


@pytest.fixture
def at_once(monkeypatch):
    """Verovio reads in this process, and takes less time."""
    monkeypatch.setattr(
        verovio_reading, "_played", lambda *file: verovio_reading.rendered(*file).encode()
    )


def note(name, dur=1, more=""):
    return f'<note pname="{name}" oct="4" dur="{dur}" {more}/>'


def bar(content, more="", controls=""):
    """A measure of a note by its name, or of what is in its layer."""
    content = note(content) if len(content) == 1 else content
    layers = f'<staff n="1"><layer n="1">{content}</layer></staff>'
    return f"<measure {more}>{layers}{controls}</measure>"


def ending(number, content):
    return f'<ending n="{number}">{content}</ending>'


def section(name, content):
    return f'<section xml:id="{name}">{content}</section>'


def mei(tmp_path, content):
    path = tmp_path / "a.mei"
    path.write_text(DOCUMENT.format(content))
    return read_score(path)


def names(score):
    """The names of the notes, which follow one another without rests."""
    ends = [0, *(n.end for n in score.notes)]
    assert [n.start for n in score.notes] == pytest.approx(ends[:-1], abs=0.01)
    return "".join("c.d.ef.g.a.b"[n.pitch - 60] for n in score.notes)


@pytest.mark.parametrize(
    ("content", "played"),
    [
        (bar("c", END) + bar("d"), "ccd"),
        (bar("c", 'right="rptboth"') + bar("d", END), "ccdd"),
        (section("A", bar("c", START)) + section("B", bar("d", END)) + bar("e"), "cdcde"),
        (bar("c") + ending(1, bar("d", END)) + ending(2, bar("e")), "cdce"),
        (bar("c") + ending("1-2", bar("d", END)) + ending("3.", bar("e")) + bar("f"), "cdcdcef"),
        (
            '<expansion plist="#A #B #A"/>' + section("A", bar("c")) + section("B", bar("d", END)),
            "cdc",
        ),
        (
            bar("g") + section("S", '<expansion plist="#A #A"/>' + section("A", bar("c"))),
            "gcc",
        ),
        (bar("c") + bar("d", "", '<repeatMark tstamp="5" func="fine"/>')
         + bar("e", "", "<dir tstamp='4'>D.C. al Fine</dir>"), "cdecd"),
        (bar("c") + bar("<mRpt/>") + bar("d"), "ccd"),
        (bar("c") + bar("d") + bar("<mRpt2/>") + bar("<mSpace/>") + bar("e"), "cdcde"),
        (bar("c") + bar("d") + bar('<multiRpt num="2"/>') + bar("<mSpace/>"), "cdcd"),
        (bar(note("c", 4) + "<beatRpt/>" + note("d", 4) + "<beatRpt/>"), "ccdd"),
        (bar(f"<beam>{note('c', 4)}{note('d', 4)}</beam><halfmRpt/>"), "cdcd"),
        (bar(f"<chord>{note('c', 2)}</chord>{note('d', 2)}") + bar("e"), "cde"),
        (bar("c", 'xml:id="m"') + '<measure copyof="#m"/>' + bar("d"), "ccd"),
        (section("A", bar("c") + bar("d")) + '<section copyof="#A"/>', "cdcd"),
        (bar('<note copyof="#b"/><note xml:id="b" copyof="#a"/>')
         + bar(note("c", 2, 'xml:id="a"') + note("d", 2)), "cccd"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("at_once")
def test_mei_is_played_in_its_order(tmp_path, content, played):
    score = mei(tmp_path, content)
    assert names(score) == played
    assert len(score.remarks) == 1


@pytest.mark.parametrize(
    ("content", "remark"),
    [
        (bar("c") + bar('<note copyof="#a"/>'), "1 copy of what is not there"),
        (bar("<mRpt/>") + bar("c"), "1 bar-repeat sign left out"),
        ('<expansion plist="#A #B"/>' + section("A", bar("c")), "1 section that is"),
        (
            '<expansion plist="#A"/>' + section("A", bar("c")) + section("B", bar("d")),
            "1 bar passed",
        ),
        (bar("c", "", '<trill startid="#x"/><turn startid="#x"/>'), "2 ornaments left out"),
        (bar(note("c", 1, 'fermata="above"')), "1 fermata left out"),
        (bar(f"<fTrem>{note('c', 2)}{note('d', 2)}</fTrem>"), "1 tremolo between notes left out"),
    ],
)
@pytest.mark.usefixtures("at_once")
def test_what_is_not_played_is_said(tmp_path, content, remark):
    assert remark in mei(tmp_path, content).remarks[1]


@pytest.mark.usefixtures("at_once")
def test_a_jump_goes_back_to_the_tempo_the_metre_and_the_transposition_there(tmp_path):
    tempo = '<tempo tstamp="3" midi.bpm="120"/>'
    change = '<scoreDef meter.count="2"/><staffDef n="1" trans.semi="2"/>'
    score = mei(tmp_path, bar("c") + change + bar(note("c", 4) * 2 + note("c", 4) * 2, END, tempo))
    once = [(0, 60), (4, 62), (5, 62), (6, 62), (6.5, 62)]
    assert [(n.start, n.pitch) for n in score.notes] == once + [(t + 7, pitch) for t, pitch in once]
    assert [(b.time, len(b.beats)) for b in score.bars] == [(0, 4), (4, 4), (7, 4), (11, 4)]


@pytest.mark.usefixtures("at_once")
def test_bars_are_as_long_as_they_are_played(tmp_path):
    content = bar(note("c", 4)) + bar("d") + bar(note("e", 2, 'dots="1"'), END) + bar(note("f", 4))
    score = mei(tmp_path, content)
    assert [b.time for b in score.bars] == [0, 1, 5, 8, 9, 13, 16]
    assert [len(b.beats) for b in score.bars] == [1, 4, 3, 1, 4, 3, 1]


@pytest.mark.usefixtures("at_once")
def test_ties_lead_into_the_ending_that_is_played(tmp_path):
    first = bar(note("c", 2) + note("d", 2, 'xml:id="x"'), "", TIE)
    endings = ending(1, bar(note("d", 1, 'xml:id="y"'), END))
    tied = ending(2, bar(note("d", 1, 'xml:id="z"'), "", '<tie tstamp="0" endid="#z"/>'))
    assert names(mei(tmp_path, first + endings + tied)) == "cdcd"
    assert names(mei(tmp_path, first + endings + ending(2, bar("d")))) == "cdcdd"


@pytest.mark.usefixtures("at_once")
def test_movements_follow_one_another_and_parts_sound_together(tmp_path):
    path = tmp_path / "a.mei"
    text = DOCUMENT.format(bar("c", END))
    first, score = text.index("<mdiv>"), text.index("<score>")
    movement = text[first : text.index("</body>")]
    path.write_text(text.replace(movement, movement + movement.replace('"c"', '"d"')))
    assert names(read_score(path)) == "ccdd"
    part = text[score : text.index("</mdiv>")].replace("score>", "part>")
    other = part.replace('"c"', '"e"')
    parts = f"<parts>{part}{other}</parts></mdiv></body>"
    path.write_text(f"{text[:score]}{parts}</music></mei>")
    score = read_score(path)
    assert [(n.start, n.pitch) for n in score.notes] == [(0, 60), (0, 64), (4, 60), (4, 64)]
    assert len(score.tracks) == 2


def kern(tmp_path, text):
    path = tmp_path / "a.krn"
    path.write_text("\n".join(("**kern", "*M4/4", "*MM60", *text.split(), "*-", "")))
    return read_score(path)


@pytest.mark.parametrize(
    ("text", "played"),
    [
        ("*>[A,A1,A,A2] *>norep[A,A2] *>A =1 1c *>A1 =2 1d *>A2 =3:|! 1e ==", "cdce"),
        ("*>[A,B,A] *>A =1 1c =2 *>B 1d ==", "cdc"),
        ("*>[A,Var2,A] *>A =1 1c =2 *>Var2 1d ==", "cdc"),  # not the second ending of Var
        ("*>[A,B,A] *>A =1 2c *>B 2d ==", "cdc"),  # within a bar
        ("=1 1c =2:|! 1d ==:|!", "ccdd"),
        ("*>A =1 1c *>A1 =2 1d =3:|! *>A2 1e ==", "cdce"),
        ("*>[A,A1,A,A2] *>A =1 2c [2d *>A1 =2 1d] *>A2 =3:|! 1d] ==", "cdcd"),
        ("*ITrd1c2 =1 1c =2 *ITrd-2c-3 1c =3 *Trd1c2 1d ==", "ccd"),
        ("*tremolo =1 8c 8d 8c 8d 2e ==", "cdcde"),
    ],
)
@pytest.mark.usefixtures("at_once")
def test_humdrum_is_played_in_its_order(tmp_path, text, played):
    score = kern(tmp_path, text)
    assert names(score) == played
    assert len(score.remarks) == 1


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


def test_words_have_their_usual_tempo_in_mei_without_any(tmp_path):
    text = MEI.format(encoding="UTF-8").replace("</layer></staff>", "</layer></staff>{}")
    words = '<tempo tstamp="1" staff="1"><rend>Andante</rend></tempo>'
    for tempo, seconds in ("midi.bpm='60'", 1.0), ("", 60 / 92):
        (tmp_path / "tune.mei").write_text(text.format(words).replace('midi.bpm="60"', tempo))
        score = read_score(tmp_path / "tune.mei")
        assert score.notes[1].start == pytest.approx(seconds, abs=1e-3)
        assert ("1 tempo word played as usual" in " ".join(score.remarks)) == (not tempo)


def played(path):
    return [(round(n.start, 3), round(n.end - n.start, 1), n.pitch) for n in read_score(path).notes]


def test_humdrum_is_played_with_its_repeats(tmp_path):
    path, text = tmp_path / "tune.krn", tmp_path / "tune.txt"
    for each in path, text:
        each.write_text(HUMDRUM)
        again = [(start + 4, length, pitch) for start, length, pitch in ONCE]
        assert played(each) == ONCE + again
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


TITLED = DOCUMENT.replace(
    "<music>",
    "<meiHead><fileDesc><titleStmt><title>Lied &amp; <rend>Tanz</rend></title>"
    "<composer>Clara</composer></titleStmt></fileDesc></meiHead><music>",
).format(bar("c"))


@pytest.mark.parametrize(
    ("name", "text", "title", "composer"),
    [
        ("a.mei", TITLED, "Lied & Tanz", "Clara"),
        ("a.mei", DOCUMENT.format(bar("c")), "a", ""),
        (
            "a.krn",
            "!!!COM: Wieck, Clara\n!!!OTL@@DE: Lied\n**kern\n*M4/4\n1c\n*-\n",
            "Lied",
            "Clara Wieck",
        ),
    ],
)
@pytest.mark.usefixtures("at_once")
def test_the_title_and_the_composer_are_those_of_the_file(tmp_path, name, text, title, composer):
    path = tmp_path / name
    path.write_text(text)
    score = read_score(path)
    assert (score.title, score.composer) == (title, composer)


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
