"""Mends MusicXML that partitura cannot parse, or reads wrongly."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from fractions import Fraction
from xml.etree import ElementTree

from cadenza.music.formats.musicxml_marks import placed
from cadenza.music.repair import counted_remarks

Element = ElementTree.Element

_COUNTED = ("divisions", "duration", "offset")  # a quarter in units, and what is given in these
_MOST_FINE = 10_000  # times as small as a file has its units
_SOUND = ("cue", "tie", "notations", "unpitched")  # what of a cue note no rest has
_PLACES = ("offset", "voice", "staff")  # where a direction stands
_SLOWEST, _FASTEST = 1, 10_000  # quarters a minute
_QUARTERS = {"whole": 4.0, "half": 2.0, "quarter": 1.0, "eighth": 0.5, "16th": 0.25}


def mend(root: Element) -> list[str]:
    """Mends a document, and returns remarks on what changed its music.

    A score ordered by measures becomes one ordered by parts. Metronome marks become tempos for
    playback if there are none. A change of the pedal becomes a lift and a press, and pedal
    marks move to where they sound. Fingerings without a number and tempos that cannot be are left
    out. Cue notes become rests, since they are not to be played. Durations that are no whole
    numbers are counted in finer units, alterations by less than a semitone rounded. Octaves that an
    instrument sounds higher are added to the semitones.
    """
    _order_by_parts(root)
    _distinguish_parts(root)
    _play_metronomes(root)
    _split_pedal_changes(root)
    fingerings, tempos, cues = _strange_fingerings(root), _strange_tempos(root), _cues(root)
    _remove(root, [*fingerings, *(note for note in cues if _takes_no_time(note))])
    for mark in tempos:
        del mark.attrib["tempo"]
    for note in cues:
        _silence(note)
    _refine(root)
    _move_pedal_marks(root)
    _add_octaves(root)
    remarks = (
        (len(fingerings), "unreadable fingering", "left out"),
        (len(tempos), "impossible tempo", "left out"),
        (_round_alterations(root), "microtone", "rounded to a semitone"),
        (len([*root.iter("unpitched")]), "unpitched note", "left out"),
        (len([*root.iter("tremolo")]), "tremolo", "played as a plain note"),
        (len(_bar_repeats(root)), "bar-repeat sign", "left out"),
    )
    return counted_remarks(remarks)


def _order_by_parts(root: Element) -> None:
    """Turns a score of measures that hold parts into one of parts that hold measures."""
    if root.tag != "score-timewise":
        return
    root.tag = "score-partwise"
    parts: dict[str, Element] = {}
    for measure in root.findall("measure"):
        for music in measure.findall("part"):
            part = parts.setdefault(music.get("id", ""), Element("part", music.attrib))
            ElementTree.SubElement(part, "measure", measure.attrib).extend(music)
    root[:] = [each for each in root if each.tag != "measure"] + list(parts.values())


def _distinguish_parts(root: Element) -> None:
    """Makes the ids of parts differ, by which partitura tells them apart."""
    for parts in (root.findall("part-list/score-part"), root.findall("part")):
        seen = Counter[str]()
        for part in parts:
            name = part.get("id", "P1")
            seen[name] += 1
            part.set("id", name if seen[name] == 1 else f"{name} ({seen[name]})")


def _play_metronomes(root: Element) -> None:
    """Adds tempos for playback at metronome marks, in a file without any."""
    if root.find(".//sound[@tempo]") is not None:
        return
    for direction in root.iter("direction"):
        mark = direction.find("direction-type/metronome")
        if mark is None:
            continue
        unit, number = mark.findtext("beat-unit", ""), mark.findtext("per-minute", "")
        found = re.search(r"\d{1,5}(\.\d{1,3})?", number)
        if unit.strip() in _QUARTERS and found and len(mark.findall("beat-unit")) == 1:
            dots = len(mark.findall("beat-unit-dot"))
            quarters = _QUARTERS[unit.strip()] * (2 - 0.5**dots)
            tempo = f"{quarters * float(found[0]):g}"
            ElementTree.SubElement(direction, "sound", {"tempo": tempo})


def _split_pedal_changes(root: Element) -> None:
    for measure in root.iterfind("part/measure"):
        measure[:] = [part for each in measure for part in _lift_and_press(each)]


def _move_pedal_marks(root: Element) -> None:
    """Moves pedal marks by their offsets for playback, as far as their measures reach."""
    for measure in root.iterfind("part/measure"):
        *elements, (end, _) = placed(measure)
        length = max([end, *(at for at, _ in elements)])
        measure[:] = [
            part for at, element in elements for part in _at_its_offset(element, at, length)
        ]


def _at_its_offset(element: Element, at: int, length: int) -> Iterator[Element]:
    """Yields a pedal mark with the motions to its place and back, others as they are."""
    offset = element.find("offset[@sound='yes']")
    by = int(offset.text or 0) if offset is not None else 0
    by = min(max(at + by, 0), length) - at
    is_moved = by and element.find("direction-type/pedal") is not None
    if not is_moved or offset is None:
        yield element
        return
    element.remove(offset)
    yield _motion(by)
    yield element
    yield _motion(-by)


def _motion(by: int) -> Element:
    motion = Element("forward" if by > 0 else "backup")
    ElementTree.SubElement(motion, "duration").text = str(abs(by))
    return motion


def _lift_and_press(direction: Element) -> Iterator[Element]:
    """Yields two directions in place of one that changes the pedal, others as they are."""
    yield direction
    change = direction.find("direction-type/pedal[@type='change']")
    if direction.tag != "direction" or change is None:
        return
    press = Element("direction", direction.attrib)
    kind = ElementTree.SubElement(press, "direction-type")
    ElementTree.SubElement(kind, "pedal", {**change.attrib, "type": "start"})
    for each in direction:
        if each.tag in _PLACES:
            ElementTree.SubElement(press, each.tag, each.attrib).text = each.text
    change.set("type", "stop")
    yield press


def _round_alterations(root: Element) -> int:
    """Rounds alterations to semitones, and returns how many were not whole."""
    fractions = 0
    for each in root.iter("alter"):
        if re.fullmatch(r"-?\d{1,3}\.\d{1,12}", text := (each.text or "").strip()):
            each.text = str(round(float(text)))
            fractions += float(text) % 1 != 0
    return fractions


def _add_octaves(root: Element) -> None:
    """Adds the octaves of transpositions, which partitura does not read, to their semitones."""
    for each in root.iter("transpose"):
        octaves, semitones = (_whole(each, tag) for tag in ("octave-change", "chromatic"))
        if octaves:
            chromatic = each.find("chromatic")
            if chromatic is None:
                chromatic = ElementTree.SubElement(each, "chromatic")
            chromatic.text = str(semitones + 12 * octaves)


def _whole(parent: Element, tag: str) -> int:
    """The number in a child, 0 if there is none."""
    text = parent.findtext(tag, "").strip()
    return int(text) if re.fullmatch(r"[+-]?\d{1,3}", text) else 0


def _strange_fingerings(root: Element) -> list[Element]:
    return [sign for sign in root.iter("fingering") if not re.search(r"\d", sign.text or "")]


def _strange_tempos(root: Element) -> list[Element]:
    return [mark for mark in root.iter("sound") if not _is_tempo(mark.get("tempo", "120"))]


def _is_tempo(text: str) -> bool:
    try:
        return _SLOWEST <= float(text) <= _FASTEST
    except ValueError:
        return False


def _bar_repeats(root: Element) -> list[Element]:
    return [sign for sign in root.iter("measure-repeat") if sign.get("type") == "start"]


def _cues(root: Element) -> list[Element]:
    return [note for note in root.iter("note") if note.find("cue") is not None]


def _takes_no_time(note: Element) -> bool:
    return note.find("chord") is not None or note.find("grace") is not None


def _silence(note: Element) -> None:
    """Turns a note into a rest."""
    note[:] = [part for part in note if part.tag not in _SOUND]
    if (pitch := note.find("pitch")) is not None:
        pitch.clear()
        pitch.tag = "rest"


def _remove(root: Element, elements: Iterable[Element]) -> None:
    gone = set(elements)
    if gone:
        for parent in root.iter():
            parent[:] = [child for child in parent if child not in gone]


def _refine(root: Element) -> None:
    """Divides the unit of time so that all durations are whole, or nearly so.

    Text that is no number stays: partitura reads it as 0.
    """
    counts = {each: _number(each) for tag in _COUNTED for each in root.iter(tag)}
    known = {each: count for each, count in counts.items() if count is not None}
    finer = min(math.lcm(*(count.denominator for count in known.values())), _MOST_FINE)
    if any(each.tag == "divisions" and each not in known for each in counts):
        finer = 1  # not all could be
    for each, count in known.items():
        each.text = str(round(count * finer))


def _number(element: Element) -> Fraction | None:
    """The number of an element; None unless it has few digits, as others could have billions."""
    text = (element.text or "0").strip()
    return Fraction(text) if re.fullmatch(r"-?\d{1,12}(\.\d{0,12})?", text) else None
