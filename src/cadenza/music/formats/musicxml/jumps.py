"""Jumps, by sounds for playback, words and signs: da capo, dal segno, coda and fine."""

import re
from collections.abc import Sequence
from fractions import Fraction
from itertools import chain
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.bars import Signs, WrittenBar, bar_at
from cadenza.music.formats.musicxml.timeline import Placed, exact, number, passes_of

_DA_CAPO = re.compile(r"\bd\. ?c\b|^dc\b|\bda ?capo\b")
_DAL_SEGNO = re.compile(r"\bd\. ?s\b|^ds\b|\bdal? segno\b")
_TO_CODA = re.compile(r"\b(to|al|alla) (the )?coda\b")
_FINE = re.compile(r"^\W*(il )?(fine?|ende|schlu(ss|ß))\b")
_WORD = re.compile(r"[a-zäöüéè]{5,}")
_ANY_WORD = re.compile(r"[^\W\d_]+")
_DANCE = re.compile(r"(men|min)u|trio|scher|mar[cs]|ron[dt]|gavot|bour|polon|mazur|wal[tz]|vals")
_MAX_BEFORE = 3  # words before a jump, such as "Menuetto primo" or "2nd time"
_MENTION = re.compile(  # a word before what is no jump itself, such as "on D.S."
    "on|at|after|before|during|until|till|in|of|the|for|when|while|if|with|without|not?|only|tacet|"
    "nach|beim?|vor|im|zum|vom|ohne|nicht|nur|auf?|après|avant|sans|dopo|prima|[dn]el|alla?|senza|"
    "non|solo"
)
_WHEN = re.compile(  # a word that may stand with "to coda" and "fine"
    "on|at|after|last|the|times?|n?[rd]d|st|x|second|third|volt[ae]|[dcs]|da|capo|dal|segno|go|then|"
    "only|repeat|and|coda|jump|skip"
)
_WHERE = re.compile(  # a word that may follow a jump
    "a|ad|all?|all[ao]|au|to|till|until|bis|zu[mr]?|sino?|fino?|fine|ende?|schlu(ss|ß)|coda|segno|"
    "sign|senza|sans|ohne|with(out)?|con|mit|avec|no|rep(eats?|lica|liche)?|reprises?|"
    "r[ei]peti[tz]ion[ei]?s?|wiederholung(en)?|ma|ed?|et|und|and|poi|then|dann|puis|l[ae]|il|das|"
    "d[ie][er]|[lsdcx]|da|capo|dall?|from|beginning|top|anfang|i+|primo|secondo|times?|volt[ae]|nd|"
    "fade|out|lib(itum)?|last|poco|molto|rit|rall|tempo|attacca|segue"
)
_TRIO = re.compile(r"^\W*trio\b")
_GOALS = {kind: re.compile(rf"^\W*{kind}( {kind})?\W*\d?$") for kind in ("segno", "coda")}
_GLYPHS = {"\U0001d10b": " segno ", "\U0001d10c": " coda ", "⊕": " coda "}
_HEADING = "heading"
_UNNAMED = ""  # leads to the nearest goal of its kind
_SOUNDS = ("dacapo", "dalsegno", "tocoda", "fine", "segno", "coda")
JUMPS = frozenset((*_SOUNDS, "time-only"))
"""The attributes of a sound for playback that only say in which order bars are played."""


def read_jumps(
    parts: Sequence[Sequence[Placed]], bars: Sequence[WrittenBar], begins: Sequence[Fraction]
) -> None:
    """Add the jumps in all parts, and their goals, to the signs of bars, which have their barlines.

    Words and signs count where no sound for playback stands with them. A fine is within a bar if it
    stands at a line there, or says how long the note before it is. A coda sign up to the last jump
    back sends the player to the coda, one after it is the coda.
    """
    reader = JumpReader(bars)
    for part in parts:
        for placed in part:
            if placed.measure <= bars[-1].measure:
                reader.read(
                    placed,
                    is_end=begins[placed.measure] < placed.quarter == begins[placed.measure + 1],
                )
    reader.read_signs()


class JumpReader:
    """The reader of words and signs at bars, which adds what they mean to the signs of these."""

    def __init__(self, bars: Sequence[WrittenBar]) -> None:
        self._bars = bars
        self._codas: list[tuple[int, int]] = []  # each sign's bar, and the bar that begins there
        self._segnos: set[int] = set()
        self._trios: set[int] = set()  # bars before trios
        self._headings: dict[str, int] = {}  # bars by the words that stand over them
        self._fines: dict[int, Fraction] = {}  # places of a fine by bar
        self._lines: set[Fraction] = set()  # places of lines within bars
        self._note: Placed | None = None  # the latest

    def read(self, placed: Placed, is_end: bool) -> None:
        """Read an element, which may stand at the end of its measure."""
        element = placed.element
        if element.tag == "note" and element.find("grace") is None:
            self._note = placed
        if element.tag not in ("direction", "sound", "barline"):
            return
        if element.get("location") == "middle":
            self._lines.add(placed.quarter)
        at = bar_at(self._bars, placed.measure, placed.quarter)
        next_bar = min(at + is_end, len(self._bars) - 1)  # the bar that begins there
        bar = self._bars[at]
        if at and self._bars[at - 1].measure == bar.measure and placed.quarter == bar.begin:
            at -= 1  # at a repeat sign within a measure
        sounds = [element] if element.tag == "barline" else placed.all_sounds
        for sound in sounds:
            _read_sound(sound, self._bars[at].signs, self._bars[next_bar].signs)
            length, before = number(sound.get("fine")), self._note
            if length and before is not None and before.measure == placed.measure:
                end = exact(before.quarter + length / before.divisions)
                self._fines[at] = end
                self._lines.add(end)
        if not any(sound.get(name) for sound in sounds for name in _SOUNDS):
            self.read_text(_text(element), at, next_bar)
        if self._bars[at].signs.fine:
            self._fines.setdefault(at, placed.quarter)

    def read_text(self, text: str, at: int, next_bar: int) -> None:
        signs = self._bars[at].signs
        next_signs = self._bars[min(at + 1, len(self._bars) - 1)].signs
        # Long words begin before the bar that they are for.
        back = next_signs if next_signs.times > 1 and not next_signs.begins_repeat else signs
        if self._is_jump(_DA_CAPO.search(text)):
            if _DAL_SEGNO.search(text):
                back.dal_segno = back.dal_segno or _UNNAMED
            headings = [self._headings[w] for w in _WORD.findall(text) if w in self._headings]
            if headings:  # such as "Menuetto da capo"
                goal = self._bars[headings[0]].signs
                goal.segno = goal.segno or _HEADING
                back.dal_segno = back.dal_segno or goal.segno
            back.da_capo = True
        elif self._is_jump(_DAL_SEGNO.search(text)):
            back.dal_segno = back.dal_segno or _UNNAMED
        elif _TRIO.search(text) and at:
            self._trios.add(at - 1)
        elif _is_alone(_TO_CODA.search(text)):
            signs.to_coda = signs.to_coda or _UNNAMED
        elif _is_alone(_FINE.search(text)):
            signs.fine = True
        elif _GOALS["segno"].search(text):
            self._segnos.add(next_bar)
        elif _GOALS["coda"].search(text):
            self._codas.append((at, next_bar))
        elif (word := _WORD.match(text)) and at:
            self._headings[word[0]] = next_bar

    def _is_jump(self, match: re.Match[str] | None) -> bool:
        """Whether words in a text are a jump themselves, and not only mention one."""
        if match is None:
            return False
        before, after = _around(match)
        return (
            len(before) <= _MAX_BEFORE
            and not any(map(_MENTION.fullmatch, before))
            and all(_WHERE.fullmatch(w) or w in self._headings or _DANCE.match(w) for w in after)
        )

    def read_signs(self) -> None:
        """Read the segno, trio and coda signs, now that all jumps are known, and ends of fines."""
        for at, quarter in self._fines.items():
            if quarter in self._lines and self._bars[at].begin < quarter < self._bars[at].end:
                self._bars[at].cut = quarter
        signs = [bar.signs for bar in self._bars]
        has_segno = ends = False  # whether there is a segno; and an end of what is repeated
        last_jump = -1
        for at, each in enumerate(signs):
            is_beside = has_segno and each.dal_segno is not None  # the words that lead to another
            if at in self._segnos and each.segno is None and not is_beside:
                each.segno = _UNNAMED
            each.fine |= at in self._trios and not ends  # da capo is up to the trio
            has_segno |= each.segno is not None
            ends = not each.returns and (ends or each.fine or each.to_coda is not None)
            last_jump = at if each.returns else last_jump
        for at, next_bar in self._codas:
            if signs[next_bar].coda is not None or signs[at].to_coda is not None:
                continue
            if next_bar > last_jump:
                signs[next_bar].coda = _UNNAMED
            else:
                signs[at].to_coda = _UNNAMED


def _read_sound(sound: Element, signs: Signs, next_signs: Signs) -> None:
    signs.da_capo |= sound.get("dacapo", "no") != "no"
    signs.fine |= sound.get("fine", "no") != "no"
    if (passes := passes_of(sound)) and sound.get("tocoda"):
        signs.to_coda_on = passes
    elif passes:
        signs.returns_on = passes
    signs.dal_segno = sound.get("dalsegno", signs.dal_segno)
    signs.to_coda = sound.get("tocoda", signs.to_coda)
    next_signs.segno = sound.get("segno", next_signs.segno)
    next_signs.coda = sound.get("coda", next_signs.coda)
    next_signs.begins_repeat |= sound.get("forward-repeat", "no") == "yes"


def _is_alone(match: re.Match[str] | None) -> bool:
    """Whether nothing stands beside words in a text but when they hold."""
    return match is not None and all(map(_WHEN.fullmatch, chain(*_around(match))))


def _around(match: re.Match[str]) -> tuple[list[str], list[str]]:
    """The words before and after others in a text."""
    text = match.string
    return _ANY_WORD.findall(text[: match.start()]), _ANY_WORD.findall(text[match.end() :])


def _text(element: Element) -> str:
    """The words of a direction, with its signs and those of a barline by their names."""
    texts = []
    for each in (*element.iterfind("direction-type/*"), *element):
        if each.tag in ("words", "rehearsal"):
            texts.append("".join(_GLYPHS.get(letter, letter) for letter in each.text or ""))
        elif each.tag in ("segno", "coda"):
            texts.append(each.tag)
    return " ".join(" ".join(texts).lower().split())
