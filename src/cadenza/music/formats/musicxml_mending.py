"""Mends MusicXML before it is parsed: what the library stumbles over, or mistakes."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from fractions import Fraction
from xml.etree import ElementTree

Element = ElementTree.Element

_MOST_FINE = 10_000  # times as fine as a file says that its durations may have to be counted


def mended(document: bytes) -> tuple[bytes, list[str]]:
    """The document, and what was changed of what it says; as it is where nothing is.

    Fingerings without a number and tempos that cannot be are left out. Cue notes become rests,
    since they are not to be played. Durations that are no whole numbers are counted in finer units.

    Args:
        document: without entities.
    """
    try:
        root = ElementTree.fromstring(document)
    except ElementTree.ParseError:
        return document, []  # the library says what is wrong
    fingerings, tempos = _strange_fingerings(root), _strange_tempos(root)
    cues, finer = _cues(root), _finer(root)
    _remove(root, [*fingerings, *(note for note in cues if _takes_no_time(note))])
    for mark in tempos:
        del mark.attrib["tempo"]
    for note in cues:
        _silence(note)
    _refine(root, finer)
    told = (
        (len(fingerings), "unreadable fingering", "left out"),
        (len(tempos), "unreadable tempo", "left out"),
        (len(_more_often(root)), "repeat", "played twice instead of more often"),
    )
    remarks = [f"{n} {what}{'s'[: n != 1]} {why}" for n, what, why in told if n]
    changed = fingerings or tempos or cues or finer > 1
    return (ElementTree.tostring(root) if changed else document), remarks


def _strange_fingerings(root: Element) -> list[Element]:
    return [sign for sign in root.iter("fingering") if not re.search(r"\d", sign.text or "")]


def _strange_tempos(root: Element) -> list[Element]:
    return [mark for mark in root.iter("sound") if not _is_tempo(mark.get("tempo", "120"))]


def _is_tempo(text: str) -> bool:
    try:
        return 0 < float(text) < math.inf
    except ValueError:
        return False


def _more_often(root: Element) -> list[Element]:
    return [mark for mark in root.iter("repeat") if mark.get("times", "2") not in ("1", "2")]


def _cues(root: Element) -> list[Element]:
    return [note for note in root.iter("note") if note.find("cue") is not None]


def _takes_no_time(note: Element) -> bool:
    return note.find("chord") is not None or note.find("grace") is not None


def _silence(note: Element) -> None:
    """Makes a rest of a note."""
    for tag in ("cue", "tie", "notations", "unpitched"):
        for part in note.findall(tag):
            note.remove(part)
    if (pitch := note.find("pitch")) is not None:
        pitch.clear()
        pitch.tag = "rest"


def _remove(root: Element, elements: Iterable[Element]) -> None:
    gone = set(elements)
    if gone:
        for parent in root.iter():
            for child in [child for child in parent if child in gone]:
                parent.remove(child)


def _finer(root: Element) -> int:
    """How many times as fine units have to be for all durations to be whole; 1 where none are."""
    try:
        finer = math.lcm(*(_length(each).denominator for each in _durations(root)))
        [int(each.text or "") for each in root.iter("divisions")]
    except (ValueError, ZeroDivisionError):
        return 1
    return finer if finer <= _MOST_FINE else 1


def _refine(root: Element, finer: int) -> None:
    if finer > 1:
        for each in _durations(root):
            each.text = str(int(_length(each) * finer))
        for each in root.iter("divisions"):
            each.text = str(int(each.text or "") * finer)


def _length(duration: Element) -> Fraction:
    """Raises: ValueError: it is no number with few digits, of which others could have billions."""
    text = (duration.text or "0").strip()
    if not re.fullmatch(r"-?\d{1,12}(\.\d{1,12})?", text):
        raise ValueError(text)
    return Fraction(text)


def _durations(root: Element) -> list[Element]:
    return [*root.iter("duration"), *root.iter("offset")]
