"""What the marks of a part say, and what is said for playback: loudness, pedals and tempos."""

import re
from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.timeline import (
    NOTE_VALUES,
    ZERO,
    Placed,
    ends_of_lines,
    length_of,
    number,
    number_or_none,
)
from cadenza.music.formats.source import printable
from cadenza.music.score import LOUDEST
from cadenza.music.signs import CHORALE_FERMATA, FERMATA, LONG_FERMATA, SHORT_FERMATA
from cadenza.music.signs.loudness import Dynamic, Hairpin, Loudness, Sforzato, within_midi
from cadenza.music.signs.tempo_map import (
    Caesura,
    Fermata,
    Modulation,
    Swing,
    Tempo,
    TempoMark,
    TempoWord,
    is_of_tempo,
    loudness_step,
    swing,
    tempo_change,
    usual_tempo,
)

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
        if (percent := _percent(placed.element.get("dynamics"))) is not None:
            return percent
        first, loudness = self._loudness(placed.staff)
        if placed.quarter < first:
            _, loudness = self._loudness(_ANY)
        return loudness.at(placed.quarter)

    def _loudness(self, staff: int | None) -> tuple[Fraction, Loudness]:
        """The place of the first mark of a staff, and what its marks say; with `_ANY`, of all."""
        if staff not in self._known:
            staves = [*self._marks] if staff is _ANY else [_ANY, staff]
            marks = [mark for of in staves for mark in self._marks.get(of, ())]
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
    lifts = [
        after._replace(value=_UP)
        for before, after in pairwise(moves)
        if before.value == after.value == _DOWN and before.quarter < after.quarter
    ]
    return sorted([*lifts, *moves], key=lambda move: move[:2])


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
    own_values = [
        (placed.sounds_at(sound), value)
        for sound in placed.sounds
        if (value := _value(sound.get(pedal))) is not None
    ]
    return [*signs[:-1], *own_values] if own_values else signs


def _value(text: str | None) -> int | None:
    """The value of a pedal for playback: yes, no, or in percent."""
    if text is None:
        return None
    percent = {"yes": 100, "no": 0}.get(text) if text in ("yes", "no") else number(text)
    return round(_DOWN * min(max(percent or 0, 0), 100) / 100)


# Tempos, fermatas, caesuras and swing

_SLOWEST, _FASTEST = 1, 10_000  # quarters a minute
_PER_MINUTE = re.compile("[0-9]{1,5}([.,][0-9]{1,3})?")
_MAX_TUPLET = Fraction(64)  # notes
_EIGHTH = NOTE_VALUES["eighth"]
_MINUTE = 60  # seconds
_FERMATAS = {
    **dict.fromkeys(("angled", "double-angled"), SHORT_FERMATA),
    **dict.fromkeys(("square", "double-square"), LONG_FERMATA),
}
_MIN_LINES = 4  # lines of a chorale
_LINE = 1.5, 6.0  # bars of its lines, in the mean
_MAX_SWING = 16  # times as long as the other note of a pair


class TempoMarks:
    """The marks in all parts that change the tempo; where they differ, the first part counts.

    A metronome mark counts where there is no tempo for playback. `marks` and `swings` have their
    places in quarters. Without a tempo of either kind, words such as "Andante" have their usual
    ones. `words` are those of tempo, by quarters, and at `fermatas` notes or rests begin that have
    one. Added to `counts` are those "usual" ones, tempos for playback that are "impossible", and
    metronome marks that are "unclear", as they give none.
    `begins` is as `timeline` returns it.
    """

    def __init__(
        self, parts: Sequence[Sequence[Placed]], begins: Sequence[Fraction], counts: Counter[str]
    ) -> None:
        self.marks: list[TempoMark] = []
        self.swings: list[Swing] = []
        self.words: dict[Fraction, str] = {}
        self._begins, self._counts = begins, counts
        self._for_playback: dict[Fraction, Fraction] = {}  # quarters a minute
        self._metronome: dict[Fraction, Fraction] = {}
        self._usual: dict[Fraction, Fraction] = {}
        fermatas: list[Fermata] = []
        for part in reversed(parts):
            end_of_line = ends_of_lines(part)
            for placed in part:
                if placed.element.tag in ("direction", "sound"):
                    self._read_direction(placed, end_of_line(placed))
                elif placed.element.tag in ("note", "barline"):
                    fermatas += _fermatas(placed)
                    if placed.element.find("notations/articulations/caesura") is not None:
                        self.marks.append(Caesura(placed.quarter + placed.duration))
        self.fermatas = {each.onset for each in fermatas if each.onset < each.end}
        is_chorale = self._is_chorale([fermata.end for fermata in fermatas])
        for fermata in fermatas:
            if is_chorale and fermata.factor == FERMATA:
                fermata = replace(fermata, factor=CHORALE_FERMATA)
            self.marks.append(fermata)
        given = self._metronome | self._for_playback
        counts["usual"] = 0 if given else len(self._usual)
        for onset, speed in (given or self._usual).items():
            self.marks.append(Tempo(max(ZERO, onset), _MINUTE / float(speed)))

    def _is_chorale(self, ends: Iterable[Fraction]) -> bool:
        """Whether fermatas that end there [quarters] are a few bars apart, as in a chorale."""
        bars = sorted({bisect_left(self._begins, end) for end in ends})
        if len(bars) < _MIN_LINES or len(self._begins) - 1 - bars[-1] > _LINE[1]:
            return False
        return _LINE[0] <= bars[-1] / len(bars) <= _LINE[1]

    def _read_direction(self, placed: Placed, end_of_line: Fraction | None) -> None:
        """Read a direction, or a sound outside of any, and the line after its words."""
        element, sounds = placed.element, placed.sounds
        tempos = [sound for sound in sounds if sound.get("tempo") is not None]
        for sound in tempos:
            speed = number(sound.get("tempo"))
            if _is_possible(speed):
                self._for_playback[placed.sounds_at(sound)] = speed
            else:
                self._counts["impossible"] += 1
        for metronome in element.iterfind("direction-type/metronome"):
            mark, place = _Metronome(metronome), placed.sounds_at()
            if (tempo := mark.quarters_a_minute) is not None:
                self._metronome[place] = tempo
            elif mark.swing is not None:
                self._swing(placed, *mark.swing, mark.before[0])
            elif mark.slower is not None:
                self.marks.append(Modulation(place, mark.slower))
            else:
                self._counts["unclear"] += not tempos
        for sound in sounds:
            for sign in sound.iterfind("swing"):
                unit = NOTE_VALUES.get(sign.findtext("swing-type", "").strip(), _EIGHTH)
                shares = (int(number(sign.findtext(tag))) for tag in ("first", "second"))
                first, second = (min(max(each, 1), _MAX_SWING) for each in shares)
                self._swing(placed, first, second, unit)
        texts = [words.text or "" for words in element.iterfind("direction-type/words")]
        if is_of_tempo(words_of_tempo := printable(" ".join(texts))):
            self.words[placed.quarter] = words_of_tempo
        for words in placed.element.iterfind("direction-type/words"):
            text = words.text or ""
            if not tempos and (change := tempo_change(text)):
                self.marks.append(TempoWord(placed.sounds_at(), change, end_of_line))
            if usual := usual_tempo(text):
                self._usual[placed.sounds_at()] = Fraction(usual)
            if (ratio := swing(text)) and placed.element.find("sound/swing") is None:
                self._swing(placed, *ratio, _EIGHTH)

    def _swing(self, placed: Placed, first: int, second: int, unit: Fraction) -> None:
        beat = self._begins[placed.measure + 1]  # that of a pickup would be between beats
        self.swings.append(Swing(placed.quarter, first, second, unit, beat))


def _fermatas(placed: Placed) -> Iterator[Fermata]:
    element, end = placed.element, placed.quarter + placed.duration
    for sign in (*element.iterfind("fermata"), *element.iterfind("notations/fermata")):
        factor = _FERMATAS.get((sign.text or "").strip(), FERMATA)
        yield Fermata(placed.quarter, end, factor)


def _is_possible(speed: Fraction) -> bool:
    return _SLOWEST <= speed <= _FASTEST


class _Metronome:
    """A metronome mark: lengths of notes [quarters], and a number a minute or notes `after`."""

    def __init__(self, mark: Element) -> None:
        self.before: list[Fraction] = []
        self.after: list[Fraction] = []
        self.per_minute = ZERO
        notes, unit, tuplet = self.before, ZERO, Fraction(1)
        for each in mark:
            text = (each.text or "").strip()
            if each.tag == "beat-unit":
                notes, unit = self.after if self.before else self.before, length_of(text, dots=0)
                notes.append(unit)
            elif each.tag == "beat-unit-dot" and notes:
                unit /= 2
                notes[-1] += unit
            elif each.tag == "beat-unit-tied" and notes:
                notes[-1] += _length(each, "beat-unit")
            elif each.tag == "metronome-relation":
                notes = self.after
            elif each.tag == "metronome-note":
                bracket = each.find("metronome-tuplet")
                kind = None if bracket is None else bracket.get("type")
                if bracket is not None and kind == "start":
                    tuplet = _shortened(bracket)
                notes.append(_length(each, "metronome-type") * tuplet)
                if kind == "stop":
                    tuplet = Fraction(1)
            elif each.tag == "per-minute" and (digits := _PER_MINUTE.search(text)):
                self.per_minute = number(digits[0].replace(",", "."))

    @property
    def quarters_a_minute(self) -> Fraction | None:
        """The tempo, if a number gives one that may be."""
        speed = sum(self.before, ZERO) * self.per_minute
        return speed if _is_possible(speed) else None

    @property
    def slower(self) -> Fraction | None:
        """How many times longer notes are now, by what the mark says is equal; None if nothing."""
        old, new = sum(self.before, ZERO), sum(self.after, ZERO)
        return old / new if old and new else None

    @property
    def swing(self) -> tuple[int, int] | None:
        """How two equal notes share their time, where the mark shows two others in their place."""
        is_pair = len(self.before) == len(self.after) == 2
        if not is_pair or self.slower != 1 or self.before[0] != self.before[1]:
            return None
        share = self.after[0] / sum(self.after)
        return share.numerator, share.denominator - share.numerator


def _length(note: Element, tag: str) -> Fraction:
    """The length of a note in a mark, with its dots [quarters]."""
    dots = sum(each.tag in ("beat-unit-dot", "metronome-dot") for each in note)
    return length_of(note.findtext(tag, ""), dots)


def _shortened(tuplet: Element) -> Fraction:
    """What the lengths of the notes in a tuplet are multiplied by."""
    actual, normal = (
        min(max(number(tuplet.findtext(tag)), Fraction(1)), _MAX_TUPLET)
        for tag in ("actual-notes", "normal-notes")
    )
    return normal / actual
