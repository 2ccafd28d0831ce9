"""MusicXML documents for tests, and what is read of them."""

import io
import zipfile

FOUR_QUARTERS = (
    "<attributes><divisions>4</divisions><time><beats>4</beats><beat-type>4</beat-type></time>"
    "</attributes>"
)
HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<!DOCTYPE score-partwise PUBLIC '
    '"-//Recordare//DTD MusicXML 3.1 Partwise//EN" "http://www.musicxml.org/dtds/partwise.dtd">'
)
AGAIN = '<barline location="right"><repeat direction="backward"/></barline>'
BACK = "<backup><duration>16</duration></backup>"


def note(pitch, duration, staff=1, inside="", grace=False):
    """Such as E5, of `duration` sixteenths."""
    grace_or_not = "<grace/>" if grace else ""
    length = "" if grace else f"<duration>{duration}</duration>"
    return (
        f"<note>{grace_or_not}<pitch><step>{pitch[0]}</step><octave>{pitch[1:]}</octave></pitch>"
        f"{length}<voice>{staff}</voice><staff>{staff}</staff>{inside}</note>"
    )


def finger(number):
    return f"<notations><technical><fingering>{number}</fingering></technical></notations>"


def tempo(quarters_per_minute):
    sound = f'<sound tempo="{quarters_per_minute}"/>'
    return f"<direction><direction-type><words>x</words></direction-type>{sound}</direction>"


def direction(sign):
    return f"<direction><direction-type>{sign}</direction-type></direction>"


def document(*parts, title="Little piece", head=HEAD):
    """`parts` are lists of measures."""
    names = "".join(
        f'<score-part id="P{i}"><part-name>Part {i}</part-name></score-part>'
        for i in range(1, len(parts) + 1)
    )
    music = "".join(
        f'<part id="P{i}">'
        + "".join(f'<measure number="{k}">{m}</measure>' for k, m in enumerate(part, start=1))
        + "</part>"
        for i, part in enumerate(parts, start=1)
    )
    work = f"<work><work-title>{title}</work-title></work>"
    body = f"{work}<part-list>{names}</part-list>{music}"
    return f'{head}<score-partwise version="3.1">{body}</score-partwise>'


def compressed(document, name="score.xml", packing=zipfile.ZIP_DEFLATED, named=None):
    """`named` is the document's name in the table of contents, if it is another."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", packing) as archive:
        rootfile = (
            f'<container><rootfiles><rootfile full-path="{named or name}"/></rootfiles></container>'
        )
        archive.writestr("META-INF/container.xml", rootfile)
        archive.writestr(name, document)
    return out.getvalue()


def jump(sign, words="x"):
    """Such as 'dacapo="yes"'."""
    words = f"<direction-type><words>{words}</words></direction-type>"
    return f"<direction>{words}<sound {sign}/></direction>"


def pitches(score):
    return [note.pitch for note in score.notes]


def played(score):
    return [(n.start, n.end, n.pitch) for n in score.notes]
