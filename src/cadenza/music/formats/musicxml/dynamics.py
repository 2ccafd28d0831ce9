"""How loud notes are, and where the pedals are, by signs and by what is said for playback."""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.timeline import Placed, ends_of_lines, number, number_or_none
from cadenza.music.score import LOUDEST
from cadenza.music.signs.loudness import Dynamic, Hairpin, Loudness, Sforzato, within_midi
from cadenza.music.signs.words import loudness_step

FORTE = 90  # the velocity that MusicXML's `dynamics` attributes are in percent of
VELOCITIES = {"ppp": 16, "pp": 33, "p": 49, "mp": 64, "mf": 80, "f": 96, "ff": 112, "fff": 126}
"""The velocities of dynamic markings."""
UNMARKED = VELOCITIES["mf"]
_ALL = {
    **VELOCITIES,
    **{"n": 1, "pppp": 10, "ppppp": 7, "pppppp": 4},
    **dict.fromkeys(("ffff", "fffff", "ffffff"), LOUDEST),
}
_THEN = {  # for a note, and for those after it
    **dict.fromkeys(("fp", "sfp", "sfzp"), ("f", "p")),
    **{"sfpp": ("f", "pp"), "ffp": ("ff", "p"), "pf": ("p", "f")},
}
_SFORZATOS = frozenset(("sf", "sfz", "fz", "rf", "rfz", "sff", "sffz", "sfffz"))
_FOR_ONE_NOTE = _SFORZATOS.union(_THEN)
_STEPS = {"crescendo": 1, "diminuendo": -1}
_ANY = None  # the staff of marks that name none
_NEVER = Fraction(10**9)
_Mark = Dynamic | Sforzato | Hairpin


class PartLoudness:
    """How loud the notes of a part are; `plain` without hairpins and sforzatos.

    A mark with a staff is for that staff, one without for all of the part. A staff follows the
    marks of the others until it has one of its own.
    """

    def __init__(self, part: Sequence[Placed], plain: bool) -> None:
        self._plain = plain
        self._end_of_line = ends_of_lines(part)
        self._marks: defaultdict[int | None, list[_Mark]] = defaultdict(list)  # by staff
        self._open: dict[tuple[str, int | None], Hairpin] = {}
        self._known: dict[int | None, tuple[Fraction, Loudness]] = {}
        for placed in part:
            self._read(placed)
        for (_, staff), hairpin in self._open.items():
            self._marks[staff].append(hairpin)

    def velocity(self, placed: Placed) -> int:
        """The velocity of a note: its own for playback, or as marks say; 0 if not heard."""
        if (own := _percent(placed.element.get("dynamics"))) is not None:
            return own
        first, loudness = self._loudness(placed.staff)
        if placed.quarter < first:
            _, loudness = self._loudness(_ANY)
        return loudness.at(placed.quarter)

    def _loudness(self, staff: int | None) -> tuple[Fraction, Loudness]:
        """The place of the first mark of a staff, and what its marks say; with `_ANY`, of all."""
        if staff not in self._known:
            heard = [*self._marks] if staff is _ANY else [_ANY, staff]
            marks = [mark for of in heard for mark in self._marks.get(of, ())]
            first = min((mark.onset for mark in marks), default=_NEVER)
            if self._plain:
                marks = [mark for mark in marks if isinstance(mark, Dynamic)]
            self._known[staff] = first, Loudness(marks, UNMARKED)
        return self._known[staff]

    def _read(self, placed: Placed) -> None:
        element = placed.element
        if element.tag == "note":
            for sign in element.iterfind("notations/dynamics/*"):
                self._mark(sign, placed.quarter, placed.staff)
        elif element.tag in ("direction", "sound"):
            marks = element.findall("direction-type/dynamics/*")
            for sign in marks:
                self._mark(sign, placed.sounds_at(), placed.staff)
            if not any(_name(sign) in _FOR_ONE_NOTE for sign in marks):
                for sound in placed.sounds:
                    if (velocity := _percent(sound.get("dynamics"))) is not None:
                        self._marks[placed.staff].append(Dynamic(placed.sounds_at(sound), velocity))
            for wedge in element.iterfind("direction-type/wedge"):
                self._read_wedge(wedge, placed)
            end = self._end_of_line(placed)
            for words in element.iterfind("direction-type/words"):
                text = words.text or ""
                if step := loudness_step(text):
                    hairpin = Hairpin(placed.sounds_at(), end, step, "niente" in text.lower())
                    self._marks[placed.staff].append(hairpin)

    def _mark(self, sign: Element, onset: Fraction, staff: int | None) -> None:
        name = _name(sign)
        if name in _SFORZATOS:
            self._marks[staff].append(Sforzato(onset))
        elif name in _THEN:
            velocity, then = (VELOCITIES[each] for each in _THEN[name])
            self._marks[staff].append(Dynamic(onset, velocity, then))
        elif name in _ALL:
            self._marks[staff].append(Dynamic(onset, _ALL[name]))

    def _read_wedge(self, wedge: Element, placed: Placed) -> None:
        key, niente = (wedge.get("number", "1"), placed.staff), wedge.get("niente") == "yes"
        if step := _STEPS.get(wedge.get("type", "")):
            self._open[key] = Hairpin(placed.sounds_at(), None, step, niente)
        elif wedge.get("type") == "stop" and key in self._open:
            hairpin, end = self._open.pop(key), placed.sounds_at()
            if hairpin.onset < end:
                niente |= hairpin.niente
                self._marks[placed.staff].append(replace(hairpin, end=end, niente=niente))


def _name(sign: Element) -> str:
    """The name of a dynamic mark, as its tag or its text says."""
    return (sign.text or "").strip().lower() if sign.tag == "other-dynamics" else sign.tag


def _percent(text: str | None) -> int | None:
    """The velocity of an attribute for playback, in percent of a forte, if any; 0 for none."""
    percent = number_or_none(text)
    if percent is None or percent < 0:
        return None
    return within_midi(float(percent) * FORTE / 100) if percent else 0


# Pedals

PEDALS = _SUSTAIN, _SOSTENUTO = "damper-pedal", "sostenuto-pedal"
"""The pedals that are played, as sounds for playback call them."""
_SOFT = "soft-pedal"
_SOFT_IN_WORDS = re.compile(r"\b(una corda|u\. ?c\.|due corde)", re.IGNORECASE)
_SOSTENUTO_IN_WORDS = re.compile(r"\bsost(enuto|\.)? ?ped", re.IGNORECASE)
_DOWN, _UP = 127, 0
_SIGNS = {
    **dict.fromkeys(("start", "sostenuto", "resume"), (_DOWN,)),
    **dict.fromkeys(("stop", "discontinue"), (_UP,)),
    "change": (_UP, _DOWN),
}


class Move(NamedTuple):
    """The pedal moves to a value, in a measure, at a quarter of the sheet."""

    measure: int
    quarter: Fraction
    value: int


def pedal_moves(part: Iterable[Placed], begins: Sequence[Fraction], pedal: str) -> list[Move]:
    """The motions of a pedal of a part, one of `PEDALS`, in the order of their times.

    A sign moves by its offset for playback, as far as its measure reaches. A pedal that is pressed
    again without having been lifted is lifted before. A sign that lifts a pedal is for the one that
    went down last. `begins` is as `timeline` returns it.
    """
    moves: list[Move] = []
    down = defaultdict[str, list[str]](list)  # pedals, by the numbers of their signs
    for placed in part:
        if placed.element.tag in ("direction", "sound"):
            begin, end = begins[placed.measure : placed.measure + 2]
            for quarter, value in _values(placed, pedal, down):
                moves.append(Move(placed.measure, min(max(quarter, begin), end), value))
    moves.sort(key=lambda move: move[:2])
    again = [
        after._replace(value=_UP)
        for before, after in pairwise(moves)
        if before.value == after.value == _DOWN and before.quarter < after.quarter
    ]
    return sorted([*again, *moves], key=lambda move: move[:2])


def has_soft_pedal(root: Element) -> bool:
    """Whether a soft pedal goes down, in words or for playback."""
    words = (_SOFT_IN_WORDS.search(each.text or "") for each in root.iter("words"))
    return any(words) or any(_value(sound.get(_SOFT)) for sound in root.iter("sound"))


def sostenuto_words(root: Element) -> int:
    """The number of words for the sostenuto pedal, which do not say how long; 0 beside signs."""
    signs = (sign.get("type") == "sostenuto" for sign in root.iter("pedal"))
    if any(signs) or any(sound.get(_SOSTENUTO) for sound in root.iter("sound")):
        return 0
    words = (_SOSTENUTO_IN_WORDS.search(each.text or "") for each in root.iter("words"))
    return sum(each is not None for each in words)


def _values(
    placed: Placed, pedal: str, down: Mapping[str, list[str]]
) -> list[tuple[Fraction, int]]:
    """The quarters at which an element moves a pedal, and to which values."""
    signs: list[tuple[Fraction, int]] = []
    for sign in placed.element.iterfind("direction-type/pedal"):
        kind, others = sign.get("type", ""), down[sign.get("number", "1")]
        if kind in ("start", "sostenuto"):
            others.append(_SUSTAIN if kind == "start" else _SOSTENUTO)
        if pedal == (others[-1] if others else _SUSTAIN):
            signs += ((placed.sounds_at(), value) for value in _SIGNS.get(kind, ()))
        if kind == "stop" and others:
            others.pop()
    given = [
        (placed.sounds_at(sound), value)
        for sound in placed.sounds
        if (value := _value(sound.get(pedal))) is not None
    ]
    return [*signs[:-1], *given] if given else signs


def _value(given: str | None) -> int | None:
    """The value of a pedal for playback: yes, no, or in percent."""
    if given is None:
        return None
    percent = {"yes": 100, "no": 0}.get(given) if given in ("yes", "no") else number(given)
    return round(_DOWN * min(max(percent or 0, 0), 100) / 100)
