"""Whatever a MusicXML file has many of, reading it takes time in proportion."""

from functools import partial

import pytest

from cadenza.music.formats.musicxml.reader import read_musicxml
from musicxml_documents import AGAIN, FOUR_QUARTERS, direction, document, jump, tempo
from musicxml_documents import note as note_of
from proportion import grows_in_proportion


def note(inside="", grace=False, notations="", chord=False, pitch="C4"):
    inside += f"<notations>{notations}</notations>" * bool(notations)
    made = note_of(pitch, 4, inside=inside, grace=grace)
    return made.replace("<pitch>", "<chord/><pitch>") if chord else made


def words(text, more=""):
    return direction(f"<words>{text}</words>") + more


def around(begin, end):
    """A note between two directions."""
    return direction(begin) + note() + direction(end)


def many(music):
    """A document of one measure that repeats `music`."""
    return lambda n: document([FOUR_QUARTERS + music * n + note()])


def bars(*music):
    """A document that repeats bars of `music`."""
    return lambda n: document([FOUR_QUARTERS + note(), *music * n, note()])


def parts(music):
    """A document of `n / 10` parts."""
    return lambda n: document(*[[FOUR_QUARTERS + music]] * (n // 10))


def within(music, text, where="NOTE"):
    """A document in which one note, or one direction, has `text` many times."""
    return lambda n: document([FOUR_QUARTERS + music.replace(where, text * n) + note()])


TRILL = "<ornaments><trill-mark/></ornaments>"
ENDING = '<barline location="left"><ending number="{}" type="start"/></barline>'
DASHES = '<dashes type="start"/>', '<dashes type="stop"/>'
SLUR = '<slur type="start" number="1"/><slur type="stop" number="1"/>'
VOLUME = '<sound><midi-instrument id="P1-I1"><volume>9</volume></midi-instrument></sound>'

KINDS = {
    "notes": many(note()),
    "rests": many("<note><rest/><duration>1</duration></note>"),
    "notes of a chord": many(note(chord=True)),
    "broken chords": many(note(notations="<arpeggiate/>", chord=True)),
    "grace notes before one": many(note(grace=True)),
    "grace notes of a chord": many(note(grace=True, chord=True)),
    "grace notes": many(note(grace=True) + note()),
    "voices": lambda n: document(
        [FOUR_QUARTERS + "".join(note().replace("<voice>1", f"<voice>{i}") for i in range(n))]
    ),
    "ties": many(note('<tie type="stop"/><tie type="start"/>')),
    "slurs": many(note(notations=SLUR)),
    "slurs at one note": within(note(notations="NOTE"), SLUR),
    "tuplets": many(note(notations='<tuplet type="start"/><tuplet type="stop"/>')),
    "lyrics": within(note("NOTE"), "<lyric><text>la</text></lyric>"),
    "fingers": many(note(notations="<technical><fingering>1</fingering></technical>")),
    "fingers of one note": within(
        note(notations="<technical>NOTE</technical>"), "<fingering>x</fingering>"
    ),
    "trills": many(note(notations=TRILL)),
    "trills of one note": within(
        note(notations="<ornaments>NOTE</ornaments>"), "<trill-mark/><accidental-mark/>"
    ),
    "tremolos": many(note(notations="<ornaments><tremolo>3</tremolo></ornaments>")),
    "glissandos": many(note(notations='<glissando type="start"/>')),
    "fermatas": many(note(notations="<fermata/>")),
    "slashes": many(note("<notehead>slash</notehead>")),
    "chord symbols": many("<harmony><root><root-step>C</root-step></root></harmony>"),
    "backups": many("<backup><duration>1</duration></backup>"),
    "forwards": many("<forward><duration>1</duration></forward>"),
    "keys": many("<attributes><key><fifths>1</fifths></key></attributes>" + note()),
    "ossias": many(
        "<attributes><staff-details number='2'><staff-type>ossia</staff-type></staff-details>"
        "</attributes>"
    ),
    "dynamics": many(direction("<dynamics><f/></dynamics>") + note()),
    "dynamics of one note": within(note(notations="<dynamics>NOTE</dynamics>"), "<sf/><p/>"),
    "wedges": many(around('<wedge type="crescendo"/>', '<wedge type="stop"/>')),
    "wedges without an end": many(direction('<wedge type="crescendo"/>')),
    "words": many(words("dolce e cantabile")),
    "words in one direction": within(direction("NOTE"), "<words>to coda, Menuetto d.c.</words>"),
    "one long word": within(words("NOTE"), "menuetto to the d.c. "),
    "cresc.": many(words("cresc.", direction(DASHES[0])) + note() + direction(DASHES[1])),
    "rit.": many(words("rit.") + note() + words("a tempo")),
    "tempos": many(tempo(90) + note()),
    "metronome marks": within(
        direction("<metronome>NOTE</metronome>"), "<beat-unit>quarter</beat-unit>"
    ),
    "swing": many("<sound><swing><first>2</first><second>1</second></swing></sound>" + note()),
    "volumes": many(VOLUME + note()),
    "pedals": many(around('<pedal type="start"/>', '<pedal type="stop"/>')),
    "pedals without an end": many(direction('<pedal type="start"/>') + note()),
    "sostenuto": many(around('<pedal type="sostenuto"/>', '<pedal type="stop"/>')),
    "bars": bars(note()),
    "repeats": bars(note() + AGAIN),
    "repeats within a bar": many(note() + AGAIN.replace("right", "middle")),
    "endings": lambda n: document(
        [FOUR_QUARTERS, *(ENDING.format(i) + note() for i in range(1, n)), note()]
    ),
    "dal segno": bars(jump('segno="a"') + note() + jump('dalsegno="a"')),
    "codas": bars(jump('tocoda="a"') + note(), jump('coda="a"') + note()),
    "da capo of headings": bars(words("Menuetto") + note() + words("Menuetto D.C.")),
    "parts": parts(note()),
    "parts with a pedal": parts(around('<pedal type="start"/>', '<pedal type="stop"/>')),
    "parts with sostenuto": parts(around('<pedal type="sostenuto"/>', '<pedal type="stop"/>') * 2),
}


@pytest.mark.parametrize("few", [40, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_reading_takes_time_in_proportion(saved, kind, few):
    assert grows_in_proportion(lambda n: partial(read_musicxml, saved(KINDS[kind](n))), few)
