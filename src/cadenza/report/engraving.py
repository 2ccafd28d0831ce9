"""Engraved sheet music, as small drawings of one system each, with numbered notes.

Verovio engraves. Of its drawings remain shapes, glyphs and texts: glyphs are shared by all systems,
and only the groups of notes are kept, to be coloured.

`python -m cadenza.report.engraving` reads a `WrittenScore` on stdin and prints its `engraving_of`,
so that other processes need not wait.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, lru_cache
from importlib import resources
from pathlib import Path
from tempfile import TemporaryFile
from xml.etree.ElementTree import Element, fromstring, tostring
from xml.sax.saxutils import escape, quoteattr

from cadenza.errors import CadenzaError
from cadenza.files import parsed_json, write_atomically
from cadenza.music.formats.musicxml_writing import musicxml_of
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.notation.sheet import Sheet, sheet_of
from cadenza.music.score import Score
from cadenza.report.html_pages import COMPACT, packed_text

_WIDTH = 2600  # width of a system in Verovio's pixels: a staff is 72 high
_MUSIC_FONT = "Leipzig"
_MAX_PAGE_LENGTH = 60_000  # the greatest height of a page that Verovio takes
_MARGIN = 400  # about the systems of a document and between them, in tenths of these
# Verovio keeps a finger's number clear of things above and below its own width, which is less than
# a note head's: it is given wider numbers, so that stems beside notes are clear of them, too.
_WIDE_FINGERS, _FINGERS = 0.95, 0.75  # parts of the size of other texts: for Verovio, and as drawn
# Sizes of drawn texts, as parts of the sizes for which Verovio leaves room.
_TEXT_SIZES = {"fing": _FINGERS / _WIDE_FINGERS, "tempo": 0.7}
_OPTIONS = {
    "pageWidth": _WIDTH,
    "pageHeight": _MAX_PAGE_LENGTH,
    "adjustPageHeight": True,
    "systemMaxPerPage": 1,  # so that each page is a drawing of one system
    "header": "none",
    "footer": "none",
    "svgRemoveXlink": True,
    "svgFormatRaw": True,
    "smuflTextFont": "none",
    "font": _MUSIC_FONT,
    "fingeringScale": _WIDE_FINGERS,
    "minLastJustification": 0.4,  # of the width, from which on the last system is stretched to it
    **{f"pageMargin{side}": 0 for side in ("Top", "Bottom", "Left", "Right")},
}
_SVG = "{http://www.w3.org/2000/svg}"
_NOTE_ID = re.compile(r"n(\d+)(?:\.\d+)?")
_PLACED = re.compile(r"translate\((-?\d+), (-?\d+)\) scale\(([\d.]+), [\d.]+\)")
_LINE = re.compile(r"M(-?\d+) (-?\d+) L(-?\d+) (-?\d+)")
_LEFT_OUT = {"label", "placeholder"}  # the name of the instrument, and invisible parts
_CLASSES = {"fing": "fing", "tempo": "tempo", "mNum": "number", "dynam": "mark", "dir": "mark"}
# Halves and quarters of metronome marks, and dots, and how wide they are ...
_IN_TEXT = {"\ueca3": 310, "\ueca5": 302, "\uecb7": 97}
_EM = 1000  # ... in parts of the size of the font
_STYLES = (
    "text{font-family:Times,serif}.fing,.tempo{font-weight:bold}.number,.mark{font-style:italic}"
)
_A4 = 210  # [mm], the width of a document
_MAX_SYMBOLS = 15_000  # bars, rests, and notes with their tied ones, of a score on a page


@dataclass(frozen=True)
class EngravedBar:
    """A bar in a drawing: from `left` to `right`, played from `begin` to `end` [s]."""

    number: int
    left: int
    right: int
    begin: float
    end: float


@dataclass(frozen=True)
class System:
    """A drawing of one system, and its place and bars; notes are groups with `data-note`.

    In a document of all systems its upper edge is at `top`.
    """

    top: int
    width: int
    height: int
    bars: tuple[EngravedBar, ...]
    svg: str


@dataclass(frozen=True)
class Engraving:
    """Systems, and the SVG of the glyphs that they use."""

    systems: tuple[System, ...]
    glyphs: str

    @property
    def frame(self) -> tuple[str, str]:
        """The beginning and the end of an SVG file around the systems, of the width of a page."""
        last = self.systems[-1]
        width, height = last.width + 2 * _MARGIN, last.top + last.height + 2 * _MARGIN
        box = f"{-_MARGIN} {-_MARGIN} {width} {height}"
        size = f'width="{_A4}mm" height="{_A4 * height / width:.0f}mm"'
        before = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" {size}>'
            f"<style>{_STYLES}</style><defs>{self.glyphs}</defs>"
            f'<rect x="{-_MARGIN}" y="{-_MARGIN}" width="{width}" height="{height}" fill="white"/>'
            '<g stroke="black" stroke-width="0">'
        )
        return before, "</g></svg>\n"

    @property
    def document(self) -> str:
        """An SVG file of all systems, one below the other."""
        before, after = self.frame
        placed = (f'<g transform="translate(0,{s.top})">{s.svg}</g>' for s in self.systems)
        return f"{before}{''.join(placed)}{after}"


def engraved(sheet: Sheet, width: int = _WIDTH) -> Engraving:
    """Engrave sheet music in systems of a `width` in Verovio's pixels: a staff is 72 high.

    Raises CadenzaError if Verovio cannot engrave it.
    """
    import verovio  # only where it is needed, as it takes a tenth of a second

    verovio.enableLog(verovio.LOG_OFF)
    toolkit = verovio.toolkit()
    toolkit.setOptions(_OPTIONS | {"pageWidth": width})
    if not toolkit.loadData(_with_columns(musicxml_of(sheet, has_fermatas=True))):
        raise CadenzaError(f"{sheet.title}: the sheet music cannot be engraved")
    drawer = _Drawer(sheet)
    pages = range(1, toolkit.getPageCount() + 1)
    systems = tuple(drawer.system(fromstring(toolkit.renderToSVG(page))) for page in pages)
    return Engraving(systems, "".join(drawer.glyphs.values()))


def _with_columns(musicxml: str) -> str:
    """Put the fingers of a chord in one column, where Verovio would have one beside each head.

    A thumb on D below a second finger on E would read as 12.
    """
    root, column = fromstring(musicxml), None
    for note in root.iter("note"):
        fingers = note.find("notations/technical")
        if column is None or note.find("chord") is None:
            column = fingers
        elif fingers is not None:
            (finger,) = fingers
            fingers.remove(finger)  # the column begins beside the staff
            column.insert(0 if finger.get("placement") == "below" else len(column), finger)
    return tostring(root, "unicode")


@dataclass
class _Drawer:
    sheet: Sheet
    glyphs: dict[str, str] = field(default_factory=dict)
    _num_bars: int = 0
    _top: int = 0

    def system(self, page: Element) -> System:
        """The system on a page."""
        outlines = {
            glyph.get("id", "").partition("-")[0]: glyph[0].get("d", "")
            for glyph in page.iterfind(f"{_SVG}defs/{_SVG}g")
        }
        drawing = page.find(f"{_SVG}svg")
        assert drawing is not None
        width, height = (int(number) for number in drawing.get("viewBox", "").split()[2:])
        shapes = "".join(self._shapes(drawing, outlines, ""))
        top, self._top = self._top, self._top + height + _MARGIN
        return System(top, width, height, tuple(self._bars(drawing)), shapes)

    def _bars(self, drawing: Element) -> Iterator[EngravedBar]:
        for group in drawing.iter(f"{_SVG}g"):
            if group.get("class") != "measure":
                continue
            bar = self.sheet.measures[self._num_bars]
            upper_staff = group.find(f"{_SVG}g/{_SVG}path[@d]")
            line = None if upper_staff is None else _LINE.match(upper_staff.attrib["d"])
            assert line is not None
            left, right = int(line[1]), int(line[3])
            yield EngravedBar(bar.measure.number, left, right, bar.begin, bar.end)
            self._num_bars += 1

    def _shapes(self, parent: Element, outlines: Mapping[str, str], style: str) -> Iterator[str]:
        """Yield the shapes in an element; texts have a `style`."""
        for element in parent:
            kind = element.tag.removeprefix(_SVG)
            names = element.get("class", "").split()
            if _LEFT_OUT.intersection(names):
                continue
            if kind == "use":
                yield self._glyph(element, outlines)
            elif kind == "text":
                yield from self._text(element, style)
            elif kind != "g":
                yield _shape(kind, element)
            elif "arpeg" in names:  # of wavy glyphs that are turned
                content = "".join(self._shapes(element, outlines, style))
                yield f'<g transform="{element.get("transform", "")}">{content}</g>'
            elif "note" in names and (number := _NOTE_ID.fullmatch(element.get("id", ""))):
                content = "".join(self._shapes(element, outlines, style))
                yield f'<g class="note" data-note="{number[1]}">{content}</g>'
            else:
                inner_style = next((_CLASSES[name] for name in names if name in _CLASSES), style)
                yield from self._shapes(element, outlines, inner_style)

    def _glyph(self, use: Element, outlines: Mapping[str, str]) -> str:
        name = use.get("href", "")[1:].partition("-")[0]
        placed = _PLACED.fullmatch(use.get("transform", ""))
        assert placed is not None
        x, y, scale = placed.groups()
        return self._placed(name, outlines[name], float(scale), x, y)

    def _placed(self, name: str, outline: str, scale: float, x: str, y: str) -> str:
        """A glyph at a place, and keep its outline at this scale for all that use it."""
        scaled = f"{name}-{_EM * scale:.0f}"
        if scaled not in self.glyphs:
            enlarged = f'transform="scale({scale:g},{-scale:g})"'
            self.glyphs[scaled] = f'<path id="{scaled}" {enlarged} d={quoteattr(outline)}/>'
        return f'<use href="#{scaled}" x="{x}" y="{y}"/>'

    def _text(self, text: Element, style: str) -> Iterator[str]:
        """Yield a line of text, and before it the glyphs of a metronome mark."""
        x, y = text.get("x", ""), text.get("y", "")
        anchor = f' text-anchor="{text.get("text-anchor")}"' if text.get("text-anchor") else ""
        style_class = f' class="{style}"' if style else ""
        words, size = "", 0
        for part in text.iter(f"{_SVG}tspan"):
            font_size = int(part.get("font-size", "0px").removesuffix("px"))
            size = round(font_size * _TEXT_SIZES.get(style, 1)) or size
            for letter in part.text or "":
                if letter in _IN_TEXT:
                    yield self._placed(f"{ord(letter):X}", _outline(letter), size / _EM, x, y)
                    x = str(int(x) + _IN_TEXT[letter] * size // _EM)
                else:
                    words += letter
        if words:
            place = f'x="{x}" y="{y}"{anchor}{style_class} font-size="{size}"'
            yield f'<text {place} xml:space="preserve">{escape(words)}</text>'


def _shape(kind: str, element: Element) -> str:
    values = {name: value for name, value in element.attrib.items() if name not in ("id", "class")}
    attributes = "".join(f" {name}={quoteattr(value)}" for name, value in values.items())
    return f"<{kind}{attributes}/>"


def write_svg(score: Score, path: str | Path) -> tuple[str, ...]:
    """Write a score as an SVG file of all its systems, engraved as `write_musicxml` writes it.

    Raises CadenzaError if the score has no notes. Returns remarks in plain words on differences
    from the score.
    """
    sheet = sheet_of(score)
    with write_atomically(Path(path)) as file:
        file.write(engraved(sheet).document.encode())
    return sheet.remarks


def engraving_of(score: Score) -> str:
    """The engraved score that `score.js` reads, as `packed_text`; "" for no notation.

    A score has notation if it has bars, or if its onsets fit the estimated bars, unlike those of
    performers. A score of over 15,000 symbols is too long for a page.
    """
    if not 0 < len(score.notes) <= _MAX_SYMBOLS:
        return ""
    sheet = sheet_of(score)
    symbols = len(sheet.measures) + sum(max(len(symbol.notes), 1) for symbol in sheet.symbols)
    if not sheet.is_sure or symbols > _MAX_SYMBOLS:
        return ""
    engraving = engraved(sheet)
    contents = {
        "glyphs": engraving.glyphs,
        "frame": engraving.frame,
        "systems": [asdict(system) for system in engraving.systems],
        "notes": [[note.pitch, note.start, note.end] for note in sheet.notes],
        "remarks": sheet.remarks,
        "musicxml": musicxml_of(sheet),
    }
    return packed_text(json.dumps(contents, **COMPACT))


@cache
def _outline(letter: str) -> str:
    """The outline of a letter of the music font, which comes with Verovio."""
    glyph = resources.files("verovio").joinpath("data", _MUSIC_FONT, f"{ord(letter):X}.xml")
    return fromstring(glyph.read_text("utf-8"))[0].get("d", "")


# In a process

_NICENESS = 5  # behind the process that plays
_MAX_KEPT = 4  # engravings


class Engraver:
    """The engraving of a score, which takes up to seconds."""

    def __init__(self, score: Score) -> None:
        """Begin to engrave a score."""
        self._output = TemporaryFile()  # noqa: SIM115  # closed with this
        command = [sys.executable, "-P", "-m", "cadenza.report.engraving"]
        with TemporaryFile() as file:
            file.write(json.dumps(asdict(WrittenScore.of(score))).encode())
            file.seek(0)
            self._process = subprocess.Popen(command, stdin=file, stdout=self._output)

    def __del__(self) -> None:
        self._process.kill()
        self._process.wait()

    def engraving(self, patience: float = 0.0) -> str | None:
        """The engraving; "" where there is none, None if not yet after `patience` [s]."""
        try:
            failed = self._process.wait(patience) != 0
        except subprocess.TimeoutExpired:
            return None
        self._output.seek(0)
        return "" if failed else self._output.read().decode()


@lru_cache(_MAX_KEPT)
def engraving_within(patience: float, score: Score) -> str:
    """Engraving of a score, see `Engraver`; the last ones are kept, as songs are played again.

    Raises TimeoutError if it takes longer than `patience` [s].
    """
    engraving = Engraver(score).engraving(patience)
    if engraving is None:
        raise TimeoutError
    return engraving


def main() -> None:
    """Engrave the score on stdin."""
    os.nice(_NICENESS)
    input_score = parsed_json(sys.stdin.buffer.read(), WrittenScore, "score")
    sys.stdout.write(engraving_of(input_score.score))


if __name__ == "__main__":
    main()
