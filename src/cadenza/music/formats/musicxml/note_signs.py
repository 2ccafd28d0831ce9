"""The signs at a note: articulations, ornaments, tremolos, arpeggios, slurs and grace notes."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.timeline import number
from cadenza.music.signs.notes import (
    Arpeggio,
    Mark,
    Ornament,
    OrnamentKind,
    Role,
    SlurEnd,
    Tremolo,
)

_MARKS = {
    "staccato": Mark.STACCATO,
    "staccatissimo": Mark.STACCATISSIMO,
    "spiccato": Mark.STACCATISSIMO,
    "tenuto": Mark.TENUTO,
    "detached-legato": Mark.PORTATO,
    "accent": Mark.ACCENT,
    "strong-accent": Mark.STRONG_ACCENT,
    "breath-mark": Mark.BREATH,
}
_ORNAMENTS = {
    **dict.fromkeys(("trill-mark", "shake", "wavy-line"), OrnamentKind.TRILL),
    "mordent": OrnamentKind.MORDENT,
    "inverted-mordent": OrnamentKind.INVERTED_MORDENT,
    **dict.fromkeys(("turn", "delayed-turn", "vertical-turn", "haydn"), OrnamentKind.TURN),
    **dict.fromkeys(
        ("inverted-turn", "delayed-inverted-turn", "inverted-vertical-turn"),
        OrnamentKind.INVERTED_TURN,
    ),
    "schleifer": OrnamentKind.SLIDE,
}
_ALTERATIONS = {
    **{"natural": 0, "sharp": 1, "flat": -1, "natural-sharp": 1, "natural-flat": -1},
    **{"double-sharp": 2, "sharp-sharp": 2, "flat-flat": -2},
}
_FIRST = {"upper": 1, "main": 0, "below": -1}  # notes of ornaments
_INTERVALS = {"whole": 2, "half": 1, "unison": 0}
_MAX_NOTES = 128  # of an ornament
_ROLES = {"start": Role.FIRST, "stop": Role.SECOND}
_STEPS = {"up": 1, "down": -1}


def signs_of(note: Element) -> dict[str, Any]:
    """The signs at a note, as fields of a `SignedNote`."""
    found: dict[str, Any] = {}
    marks = {_MARKS[e.tag] for e in note.iterfind("notations/articulations/*") if e.tag in _MARKS}
    if marks:
        found["marks"] = frozenset(marks)
    for ornaments in note.iterfind("notations/ornaments"):
        for tremolo in ornaments.iterfind("tremolo"):
            is_measured = tremolo.get("type") != "unmeasured"
            strokes = int(number(tremolo.text)) if is_measured else 0
            found["tremolo"] = Tremolo(strokes, _ROLES.get(tremolo.get("type", ""), Role.ALONE))
        if "ornament" not in found and (ornament := next(_ornaments(ornaments), None)):
            found["ornament"] = ornament
    for wave in note.iterfind("notations/arpeggiate"):
        chord = int(number(wave.get("number"))) or None
        found["arpeggio"] = Arpeggio(chord, _STEPS.get(wave.get("direction", ""), 1))
    if note.find("notations/non-arpeggiate") is not None:
        found["arpeggio"] = Arpeggio(step=0)
    slurs = [
        SlurEnd(slur.get("type") == "start", int(number(slur.get("number", "1"))))
        for slur in note.iterfind("notations/slur")
        if slur.get("type") in ("start", "stop")
    ]
    if slurs:
        found["slurs"] = tuple(slurs)
    return found


def _ornaments(parent: Element) -> Iterator[Ornament]:
    """Yields the ornaments, each with the accidentals that follow it.

    What one of them says for playback is for all, such as that of a line after a trill.
    """
    signs = list(parent)
    said = {k: v for sign in reversed(signs) if sign.tag in _ORNAMENTS for k, v in sign.items()}
    for i, sign in enumerate(signs):
        if sign.tag not in _ORNAMENTS or (sign.tag == "wavy-line" and sign.get("type") == "stop"):
            continue
        kind = _ORNAMENTS[sign.tag]
        altered: dict[str, int | None] = {"above": None, "below": None}
        for mark in islice(signs, i + 1, None):
            if mark.tag != "accidental-mark":
                break
            usual = "below" if kind is OrnamentKind.MORDENT else "above"
            place = mark.get("placement", usual)
            altered[place if place in altered else usual] = _ALTERATIONS.get(
                (mark.text or "").strip()
            )
        yield Ornament(
            kind,
            altered["above"],
            altered["below"],
            begins=_FIRST.get(said.get("start-note", "")),
            delayed=sign.tag.startswith("delayed"),
            long=said.get("long") == "yes",
            interval=_INTERVALS.get(said.get("trill-step", "")),
            turn=_INTERVALS.get(said.get("two-note-turn", "")),
            notes=min(int(number(said.get("beats"))), _MAX_NOTES),
            accelerates=said.get("accelerate") == "yes",
        )
