"""MEI as it is played: its copies, signs that repeat music, and sections in their order.

Verovio plays these in part only. What is made here it plays from beginning to end.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import count, groupby, islice
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

from cadenza.music.formats.musicxml.bars import Signs, WrittenBar, played_order, without_goal
from cadenza.music.formats.musicxml.jumps import JumpReader
from cadenza.music.signs.tempo_map import usual_tempo

_ID = "xml:id"
_NAMESPACE = "http://www.music-encoding.org/ns/mei"
_MAX = 100_000  # bars, with repeats
_MAX_STAVES = 100  # staves of a part
_MAX_PASSES = 64
_ENDLESS = 10**9  # more than any number in MEI
_ZERO = Fraction(0)
_SLOWEST, _FASTEST = 4, 2000  # quarters a minute; slower ones MIDI cannot say
_TEMPO = 120.0  # quarters a minute where nothing is said, as in MIDI
_LENGTHS = {"breve": Fraction(2), "long": Fraction(4), "maxima": Fraction(8)}  # whole notes
_SIGNS = {"common": (4, 4), "cut": (2, 2)}
_WORDS = {"daCapo": "da capo", "dalSegno": "dal segno"}
_TEMPOS = frozenset(("scoreDef", "staffDef", "tempo"))
_EVENTS = frozenset(("note", "chord", "rest", "space"))
_REPEATED_BARS = {"mRpt": 1, "mRpt2": 2, "multiRpt": 0}  # the last has @num
_REPEATS = ("rptend", "rptboth"), ("rptstart", "rptboth")
_UNPLAYED = {
    **dict.fromkeys(("trill", "mordent", "turn", "ornam"), "ornament"),
    **{"fermata": "fermata", "fTrem": "tremolo", "gliss": "glissando"},
}
"""Signs that Verovio does not play, and what they count as."""
_WITHOUT_MUSIC = frozenset(("pb", "sb", "cb", "div", "expansion", "annot"))


_Pitch = tuple[str | None, str | None, str | None]  # staff, name and octave


@dataclass(slots=True)
class MeiBar:
    """A measure as it is written, and the number of scoreDefs before it (`changes`).

    Its `metre` is a number of beats and the part of a whole note that each is. `tempos` are
    quarters from its beginning, where the first is, and quarters a minute.
    """

    measure: Element
    changes: int
    metre: tuple[int, int]
    tempos: list[tuple[Fraction, float]]
    signs: Signs = field(default_factory=Signs)


def unfolded(content: str) -> tuple[str, dict[str, MeiBar], Counter[str]]:
    """A document in which every bar stands as often as it is played, one after the other.

    Comes with its measures by the ids that they have there, and counts of what is left out. Raises
    ParseError if it is not XML.
    """
    root, counts = fromstring(content), Counter[str]()
    for number, element in enumerate(root.iter()):
        element.tag = element.tag.rpartition("}")[2]
        ids = {key: value for key, value in element.items() if key.endswith("}id")}
        for key, value in ids.items():
            del element.attrib[key]
            element.set(_ID, value)
        if element.tag in _UNPLAYED or "fermata" in element.attrib:
            counts[_UNPLAYED.get(element.tag, "fermata")] += 1
        if element.tag == "measure":
            element.attrib.setdefault(_ID, f"bar{number}")
            for place, staff in enumerate(element.findall("{*}staff"), start=1):
                staff.attrib.setdefault("n", f"{place}")
    root.set("xmlns", _NAMESPACE)
    _Copying(root, counts).resolve(root)
    for chord in root.iter("chord"):
        longest = max(chord.iter("note"), key=_length, default=chord)
        if "dur" not in chord.attrib:  # Verovio asks for the chord's own
            lengths = {key: longest.get(key) for key in ("dur", "dots")}
            chord.attrib.update({key: value for key, value in lengths.items() if value})
    for parts in root.iter("parts"):
        _join(parts)
    bars: dict[str, MeiBar] = {}
    for score in root.iterfind(".//body//score"):
        if score.find(".//measure") is not None:
            bars |= _Unfolding(score, counts).played()
    return tostring(root, "unicode"), bars, counts


def _join(parts: Element) -> None:
    """Make parts that are written apart one score, by the numbers of their measures."""
    score, *other_parts = list(parts)
    for number, part in enumerate(other_parts, start=1):
        for staff in part.iter():
            if staff.tag in ("staff", "staffDef"):
                staff.set("n", f"{number * _MAX_STAVES + int(_number(staff.get('n')) or 1)}")
        for measure, other_measure in zip(
            score.iter("measure"), part.iter("measure"), strict=False
        ):
            measure.extend(other_measure)
        if (staves := score.find(".//staffGrp")) is not None:
            staves.extend(part.iter("staffDef"))
    parts.tag = "score"
    parts[:] = score


class _Copying:
    def __init__(self, root: Element, counts: Counter[str]) -> None:
        self._named = {element.get(_ID, ""): element for element in root.iter()}
        self._counts = counts
        self._numbers = count()
        self._open: set[Element] = set()  # those that are being resolved

    def resolve(self, element: Element) -> None:
        """Resolve an element and all within it."""
        link = element.attrib.pop("copyof", None)
        if link is None and element.tag in _EVENTS and not len(element):
            link = element.attrib.pop("sameas", None) if "dur" not in element.attrib else None
        self._open.add(element)
        if link is not None:
            original = self._named.get(link.strip().lstrip("#"))
            if original is None or original in self._open:
                self._counts["copy"] += 1
                element.tag = "space" if element.tag in _EVENTS else element.tag
            else:
                self.resolve(original)
                copy = _copied(original, f"copy{next(self._numbers)}")
                element.tag, element[:] = original.tag, copy[:]
                element.attrib.update({**copy.attrib, **element.attrib})
        for child in element:
            self.resolve(child)
        self._open.discard(element)


def _copied(element: Element, name: str) -> Element:
    """A copy; ids in it, and links to them, have the `name` after them."""
    copy = deepcopy(element)
    names = {each.get(_ID) for each in copy.iter()}
    for each in copy.iter():
        for key, value in each.items():
            if key == _ID:
                each.set(key, f"{value}-{name}")
            elif value.startswith("#"):
                links = (f"{x}-{name}" if x[1:] in names else x for x in value.split())
                each.set(key, " ".join(links))
    return copy


class _Unfolding:
    def __init__(self, score: Element, counts: Counter[str]) -> None:
        self._score = score
        self._counts = counts
        self._numbers = count()
        self._bars: list[MeiBar] = []
        self._held: dict[Element, range] = {}  # the bars that an element holds
        self._changes: list[Element] = []  # scoreDefs
        self._metre, self._tempo = (4, 4), _TEMPO
        self._says_tempo = any(_tempo(each) for each in score.iter() if each.tag in _TEMPOS)
        self._read(score, frozenset())
        for first in self._changes[:1]:
            for staff in first.iter("staffDef"):  # also after a jump back
                staff.attrib.setdefault("trans.semi", first.get("trans.semi", "0"))
        self._named = {each.get(_ID, ""): each for each in self._held}
        self._repeating: dict[str | None, tuple[int, int]] = {}  # staves: bars, and to which bar
        for number, bar in enumerate(self._bars):
            for staff in bar.measure.iter("staff"):
                self._spell_out(number, staff)
        self._read_signs()

    def _read(self, element: Element, ending: frozenset[int]) -> None:
        """Read the measures in an element; `ending` are the passes on which they are played."""
        first = len(self._bars)
        for child in _chosen(element):
            if child.tag == "measure":
                self._read_measure(child, ending)
            elif child.tag in ("scoreDef", "staffDef"):
                change = child
                if child.tag == "staffDef":  # alone, Verovio does not heed it
                    change = Element("scoreDef")
                    SubElement(change, "staffGrp").append(child)
                self._changes.append(change)
                self._metre = _metre(child) or self._metre
                self._tempo = _tempo(child) or self._tempo
            elif child.tag == "ending":
                before = self._bars[-1].signs.ending if self._bars else frozenset[int]()
                following = frozenset([max(before, default=0) + 1])
                self._read(child, _passes(child.get("n", "")) or following)
            elif child.tag not in _WITHOUT_MUSIC:
                self._read(child, ending)
        self._held[element] = range(first, len(self._bars))

    def _read_measure(self, measure: Element, ending: frozenset[int]) -> None:
        tempos = [(_ZERO, self._tempo)]
        for element in measure.iter("tempo"):
            if tempo := _tempo(element) or self._usual_tempo(element):
                place = ((_number(element.get("tstamp")) or Fraction(1)) - 1) * 4 / self._metre[1]
                tempos.append((max(place, _ZERO), tempo))
        tempos.sort(key=lambda each: each[0])
        self._tempo = tempos[-1][1]
        signs = Signs(ending=ending)
        self._held[measure] = range(len(self._bars), len(self._bars) + 1)
        self._bars.append(MeiBar(measure, len(self._changes), self._metre, tempos, signs))

    def _usual_tempo(self, element: Element) -> float | None:
        """The usual tempo for the words of an element, if the score has no other."""
        tempo = None if self._says_tempo else usual_tempo("".join(element.itertext()))
        self._counts["tempo"] += tempo is not None
        return tempo

    def _spell_out(self, number: int, staff: Element) -> None:
        """Put music in the place of signs for it in a staff of a bar."""
        name, metre = staff.get("n"), self._bars[number].metre
        sign = next((each for each in staff.iter() if each.tag in _REPEATED_BARS), None)
        if sign is not None:
            bars = _REPEATED_BARS[sign.tag] or int(_number(sign.get("num")) or 2)
            self._repeating[name] = bars, number + bars
        bars, end = self._repeating.get(name, (0, 0))
        if sign is not None or (number < end and not _EVENTS & {each.tag for each in staff.iter()}):
            self._repeat_bar(number, staff, self._bars[max(number - bars, 0)].measure)
        before = self._bars[number - 1].measure.find(f"staff[@n='{name}']") if number else None
        earlier = [] if before is None else before.findall("layer")
        for at, layer in enumerate(staff.findall("layer")):
            if any(each.tag in ("beatRpt", "halfmRpt") for each in layer.iter()):
                self._repeat_beats(layer, earlier[at : at + 1], metre)

    def _repeat_bar(self, number: int, staff: Element, original: Element) -> None:
        """Have a staff play what it did in another measure, also where only a layer says so."""
        source = original.find(f"staff[@n='{staff.get('n')}']")
        if source is None or source is staff:
            self._counts["sign"] += 1
            return
        measure = Element("measure")
        ids = {f"#{each.get(_ID)}" for each in source.iter()}
        measure.append(source)
        measure.extend(x for x in original.iter("tie") if {x.get("startid"), x.get("endid")} <= ids)
        copy = _copied(measure, f"bar{number}")
        layers = copy[0].findall("layer")
        if len(own_layers := staff.findall("layer")) > 1:
            layers_with_notes = {
                x.get("n"): x for x in own_layers if not any(y.tag in _REPEATED_BARS for y in x)
            }
            layers = [layers_with_notes.get(layer.get("n"), layer) for layer in layers]
        staff[:] = layers
        self._bars[number].measure.extend(copy[1:])

    def _repeat_beats(
        self, layer: Element, earlier: Sequence[Element], metre: tuple[int, int]
    ) -> None:
        """Put the music before them in the place of signs that repeat a beat or half a bar."""
        elements = [sign for earlier_layer in earlier for sign in _without_beams(earlier_layer)]
        first = len(elements)
        for sign in _without_beams(layer):
            beats, unit = metre
            if sign.tag == "beatRpt":
                is_compound = unit >= 8 and beats % 3 == 0
                length = (_number(sign.get("beatdef")) or Fraction(3 if is_compound else 1)) / unit
            elif sign.tag == "halfmRpt":
                length = Fraction(beats, 2 * unit)
            else:
                elements.append(sign)
                continue
            begin = len(elements)
            while begin and length > 0:
                begin -= 1
                length -= _length(elements[begin])
            if length:
                self._counts["sign"] += 1
                elements.append(sign)  # is silent, as long as what it stands for
            else:
                elements += [
                    _copied(element, f"beat{next(self._numbers)}") for element in elements[begin:]
                ]
        layer[:] = elements[first:]

    def _read_signs(self) -> None:
        """Read repeats, and jumps in signs and words."""
        signs = [bar.signs for bar in self._bars]
        as_bars = (WrittenBar(n, _ZERO, _ZERO, n, 4, each) for n, each in enumerate(signs))
        jumps, last = JumpReader(list(as_bars)), len(self._bars) - 1
        for number, bar in enumerate(self._bars):
            left, right = bar.measure.get("left"), bar.measure.get("right")
            next_signs, previous_signs = signs[min(number + 1, last)], signs[max(number - 1, 0)]
            bar.signs.begins_repeat |= left in _REPEATS[1]
            next_signs.begins_repeat |= right in _REPEATS[1] and number < last
            bar.signs.times = max(bar.signs.times, 1 + (right in _REPEATS[0]))
            previous_signs.times = max(previous_signs.times, 1 + (left in _REPEATS[0]))
            for each in bar.measure.iter():
                if each.tag in ("dir", "repeatMark"):
                    words = _WORDS.get(each.get("func", ""), each.get("func")) or ""
                    glyphs = (glyph.get("glyph.name", "") for glyph in each.iter("symbol"))
                    words = " ".join((words, *each.itertext(), *glyphs)).lower()
                    words = " ".join(words.split())
                    is_end = (_number(each.get("tstamp")) or 1) > bar.metre[0]
                    jumps.read_text(words, number, min(number + is_end, last))
        jumps.read_signs()
        self._counts["jump"] += without_goal(signs)

    def _order(self, element: Element, is_expanded: bool = False) -> Iterator[int]:
        """Yield the bars in an element as they are played.

        Those that an expansion names are played as they stand, without their repeats.
        """
        expansion = _expansion(element)
        if expansion is not None:
            for link in expansion.get("plist", "").split():
                if (part := self._named.get(link.lstrip("#"))) is not None:
                    yield from self._order(part, True)
                else:
                    self._counts["section"] += 1
            return
        for is_measure, group in groupby(self._pieces(element), lambda x: x.tag == "measure"):
            if not is_measure:
                for part in group:
                    yield from self._order(part, is_expanded)
                continue
            run = [self._held[measure].start for measure in group]
            signs = [self._bars[number].signs for number in run]
            yield from run if is_expanded else (run[at] for at, _ in played_order(signs))

    def _pieces(self, element: Element) -> Iterator[Element]:
        """Yield measures, and parts with an order of their own, in an element."""
        for child in [element] if element.tag == "measure" else _chosen(element):
            if child.tag == "measure" or (child in self._held and _expansion(child) is not None):
                yield child
            elif child in self._held:
                yield from self._pieces(child)

    def played(self) -> dict[str, MeiBar]:
        """Unfold the score; its measures as they are played."""
        order = list(islice(self._order(self._score), _MAX))
        turns, changed = Counter[int](), 1  # how many changes hold
        section, played, names = Element("section"), dict[str, MeiBar](), list[str]()
        for at, number in enumerate(order):
            bar = self._bars[number]
            names.append(f"-turn{turns[number]}" if turns[number] else "")
            if at and number != order[at - 1] + 1:
                changed = 0  # all is said again
            section.extend(deepcopy(change) for change in self._changes[changed : bar.changes])
            changed = bar.changes
            section.append(_copied(bar.measure, names[-1][1:]) if turns[number] else bar.measure)
            played[section[-1].get(_ID, "")] = bar
            turns[number] += 1
        self._lead(order, names, list(section.iter("measure")))
        self._score[:] = [*self._changes[:1], section]
        self._counts["bar"] += len(self._bars) - len(turns)
        return played

    def _lead(
        self, order: Sequence[int], names: Sequence[str], measures: Sequence[Element]
    ) -> None:
        """Have links from played measures to others lead to these as they are played then.

        A tie that leads to a bar that does not follow leads to a note of the same pitch in the one
        that does, if a tie leads there, too.
        """
        where, pitches = dict[str, int](), dict[str, _Pitch]()
        for number, bar in enumerate(self._bars):
            where.update({name: number for each in bar.measure.iter() if (name := each.get(_ID))})
            for staff in bar.measure.iter("staff"):
                for note in staff.iter("note"):
                    pitch = staff.get("n"), note.get("pname"), note.get("oct")
                    pitches[note.get(_ID, "")] = pitch
        goals = defaultdict[int, dict[_Pitch | None, str]](dict)  # of ties into bars
        for bar in self._bars:
            for tie in bar.measure.iter("tie"):
                start, end = _link(tie, "startid"), _link(tie, "endid")
                if end in where and where[end] != where.get(start):
                    goals[where[end]][pitches.get(end)] = end

        for at, (number, measure) in enumerate(zip(order, measures, strict=True)):
            for each in list(measure):
                start, end = _link(each, "startid"), _link(each, "endid")
                steps = where.get(end, number) - number
                if not (start or end) or (end and not steps):
                    continue
                goal = None
                if steps > 0 and order[at : at + steps + 1] == [*range(number, number + steps + 1)]:
                    goal = end + names[at + steps]
                elif each.tag == "tie" and start and at + 1 < len(order):
                    goal = goals[order[at + 1]].get(pitches.get(start.removesuffix(names[at])))
                    goal = goal and goal + names[at + 1]
                if goal:
                    each.set("endid", f"#{goal}")
                elif end or each.tag == "tie":
                    measure.remove(each)


def _link(element: Element, key: str) -> str:
    """The id that a link leads to; empty without one."""
    return element.get(key, "").strip().lstrip("#")


def _chosen(element: Element) -> Iterator[Element]:
    """Yield the children of an element; of several readings of a text the first."""
    for child in element:
        if child.tag in ("app", "choice"):
            reading = child.find("lem")
            yield from child[:1] if reading is None else [reading]
        else:
            yield child


def _expansion(element: Element) -> Element | None:
    """The order in which the parts of an element are played, with repeats; None without one."""
    expansions = [*element.findall("expansion"), *element.findall("choice/*/expansion")]
    return next((each for each in expansions if each.get("type") != "norep"), None)


def _metre(change: Element) -> tuple[int, int] | None:
    """The beats of a bar, and the part of a whole note that each is; None if it says none."""
    for each in (change, *change.iter("meterSig"), *change.iter("staffDef")):
        prefix = "" if each.tag == "meterSig" else "meter."
        beats = [int(x) for x in re.findall(r"\d+", each.get(f"{prefix}count", ""))]
        if beats and sum(beats):
            return sum(beats), int(_number(each.get(f"{prefix}unit")) or 0) or 4
        if each.get(f"{prefix}sym") in _SIGNS:
            return _SIGNS[each.get(f"{prefix}sym", "")]
    return None


def _tempo(element: Element) -> float | None:
    """The quarters a minute that an element says; None if it says none that can be played."""
    tempo = _number(element.get("midi.bpm", element.get("midi.tempo")))
    if tempo is None and (microseconds := _number(element.get("midi.mspb"))):
        tempo = 60_000_000 / microseconds
    if tempo is None and (beats := _number(element.get("mm"))):
        dots = int(_number(element.get("mm.dots")) or 0)
        unit = _number(element.get("mm.unit")) or 4
        tempo = beats * 4 / unit * (2 - Fraction(1, 2**dots))
    return float(tempo) if tempo and _SLOWEST <= tempo <= _FASTEST else None


def _number(text: str | None) -> Fraction | None:
    """The number that an attribute is; None if it is none above zero."""
    try:
        number = Fraction(text or "")
    except (ValueError, ZeroDivisionError):
        return None
    return number if 0 < number < _ENDLESS else None


def _passes(text: str) -> frozenset[int]:
    """The passes that the number of an ending is for, such as "1, 2", "1-3" and "2."."""
    passes = set[int]()
    for first, last in re.findall(r"(\d+)(?:\s*[-–]\s*(\d+))?", text):
        passes.update(range(int(first), min(int(last or first), _MAX_PASSES) + 1))
    return frozenset(each for each in passes if 0 < each <= _MAX_PASSES)


def _without_beams(element: Element) -> Iterator[Element]:
    """Yield the events of a layer, those in beams one by one."""
    for child in element:
        if child.tag == "beam":
            yield from _without_beams(child)
        else:
            yield child


def _length(element: Element) -> Fraction:
    """The length of an event in whole notes; zero of grace notes, clefs and the like."""
    if element.get("grace") or element.tag == "graceGrp":
        return _ZERO
    value = element.get("dur", "")
    unit = _number(value)
    if unit or value in _LENGTHS:
        length = 1 / unit if unit else _LENGTHS[value]
        dots = int(_number(element.get("dots")) or len(element.findall("dot")))
        return length * (2 - Fraction(1, 2**dots))
    lengths = [_length(child) for child in element]
    if element.tag == "chord":
        return max(lengths, default=_ZERO)
    ratio = (_number(element.get("numbase")) or 1) / (_number(element.get("num")) or Fraction(1))
    return sum(lengths, _ZERO) * (ratio if element.tag == "tuplet" else 1)
