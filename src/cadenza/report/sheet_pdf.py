"""Engraved sheet music as a PDF: pages with a title, page numbers, and no system left alone.

PDF has operators for Verovio's shapes, glyphs and texts. Texts are in the Times that every reader
of PDF has; accents that its encoding lacks are left out.
"""

import cmath
import math
import re
import unicodedata
import zlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib import resources
from itertools import chain
from pathlib import Path
from xml.etree.ElementTree import Element, fromstring

from cadenza.files import write_atomically
from cadenza.music.notation.sheet import Sheet, sheet_of
from cadenza.music.score import Score
from cadenza.report.engraving import Engraving, System, engraved

# Widths of a system in Verovio's pixels: with the first, a staff is 6.5 mm high. The others are for
# music where the first leaves a bar to a system of its own.
_STAVES = 2000, 1900, 2100, 1800, 2200
_WIDTH, _HEIGHT = 595, 842  # [pt] of a page, A4
_MARGIN = 42  # [pt] at each edge
_TITLE, _COMPOSER, _SMALL = 22, 12, 10  # [pt] of letters
_HEAD = 62  # [pt] for title and composer, above the first system
_MIN_GAP, _MAX_GAP = 18, 40  # [pt] between systems
_FONTS = {"": "Times-Roman", "bold": "Times-Bold", "italic": "Times-Italic"}
_STYLES = {"fing": "bold", "tempo": "bold", "number": "italic", "mark": "italic"}
_ENCODING, _UNITS_PER_EM = "cp1252", 2048  # of these fonts, and of Verovio's table of widths
_SPELLED = str.maketrans(
    {
        "♭": "-flat",
        "♯": "-sharp",
        "♮": "-natural",
        "№": "No.",
        "Ł": "L",
        "ł": "l",
        "Đ": "D",
        "đ": "d",
    }
)
_NUMBER, _COMMAND = re.compile(r"-?[\d.]+"), re.compile(r"([A-Za-z])([^A-Za-z]*)")
_COUNTS = {"h": 1, "v": 1, "m": 2, "l": 2, "s": 4, "c": 6}  # numbers after a command of a path


def write_pdf(score: Score, path: str | Path) -> tuple[str, ...]:
    """Write a score as a PDF of A4 pages, engraved as `write_musicxml` writes it.

    Raises CadenzaError if the score has no notes. Returns remarks in plain words on differences
    from the score.
    """
    sheet = sheet_of(score)
    engraving = _without_lone_bar(sheet)
    scale = (_WIDTH - 2 * _MARGIN) / engraving.systems[0].width  # points in a unit of a drawing
    glyphs = {
        glyph.attrib["id"]: _outline(glyph, float(_NUMBER.findall(glyph.attrib["transform"])[0]))
        for glyph in fromstring(f"<g>{engraving.glyphs}</g>")
    }
    pages, drawn = _spread(engraving.systems, scale), []
    for number, systems in enumerate(pages, start=1):
        heights = [system.height * scale for system in systems]
        top = _HEIGHT - _MARGIN - (_HEAD if number == 1 else 0.0)
        gap = min((top - _MARGIN - sum(heights)) / max(len(systems) - 1, 1), _MAX_GAP)
        parts = list(_heading(sheet.title, score.composer, number, len(pages)))
        for system, height in zip(systems, heights, strict=True):
            shapes = "\n".join(_drawing(fromstring(f"<g>{system.svg}</g>"), glyphs))
            parts += [f"q {scale:.6f} 0 0 {-scale:.6f} {_MARGIN} {top:.2f} cm\n{shapes}\nQ"]
            top -= height + gap
        drawn.append("\n".join(parts).encode(_ENCODING))
    with write_atomically(Path(path)) as file:
        file.write(_document(drawn))
    return sheet.remarks


def _without_lone_bar(sheet: Sheet) -> Engraving:
    """Engrave sheet music so that its last system has more than one bar, if possible."""
    engravings = (engraved(sheet, width) for width in _STAVES)
    first = next(engravings)
    ends_well = (e for e in chain([first], engravings) if len(e.systems[-1].bars) > 1)
    return first if len(first.systems) == 1 else next(ends_well, first)


def _spread(systems: Sequence[System], scale: float) -> list[list[System]]:
    """Spread systems over pages; the last has more than one if the page before can spare it."""
    pages: list[list[System]] = []
    room = 0.0
    for system in systems:
        if system.height * scale > room:
            room = _HEIGHT - 2 * _MARGIN - (0 if pages else _HEAD)
            pages.append([])
        pages[-1].append(system)
        room -= system.height * scale + _MIN_GAP
    if len(pages) > 1 and len(pages[-1]) == 1 and len(pages[-2]) > 2:
        pages[-1].insert(0, pages[-2].pop())
    return pages


def _heading(title: str, composer: str, number: int, count: int) -> Iterator[str]:
    """Title and composer on the first page, the title small on the others, and page numbers."""
    top, middle = _HEIGHT - _MARGIN, _WIDTH / 2
    if number == 1:
        size = min(_TITLE, (_WIDTH - 2 * _MARGIN) / max(_width(title, "bold"), 1))
        yield _text(title, "bold", size, middle, top - _TITLE, "middle")
        line = top - _TITLE - 2 * _COMPOSER
        yield _text(composer, "italic", _COMPOSER, _WIDTH - _MARGIN, line, "end")
    else:
        yield _text(title, "italic", _SMALL, middle, top + _SMALL, "middle")
    if count > 1:
        yield _text(f"{number} / {count}", "", _SMALL, middle, _MARGIN - 2 * _SMALL, "middle")


def _drawing(parent: Element, glyphs: Mapping[str, str]) -> Iterator[str]:
    """Yield the operators that draw the contents of an element."""
    for shape in parent:
        value = {name: float(v) for name, v in shape.items() if _NUMBER.fullmatch(v)}
        if shape.tag == "g":
            turn = _turned(shape.get("transform", ""))
            yield from (
                (f"q {turn} cm", *_drawing(shape, glyphs), "Q") if turn else _drawing(shape, glyphs)
            )
        elif shape.tag == "use":
            glyph = glyphs[shape.attrib["href"][1:]]
            yield f"q 1 0 0 1 {value['x']:g} {value['y']:g} cm {glyph} f Q"
        elif shape.tag == "text":
            style, anchor = _STYLES.get(shape.get("class", ""), ""), shape.get("text-anchor", "")
            at = value.get("x", 0.0), value["y"]
            yield _text(shape.text or "", style, value["font-size"], *at, anchor, turned=-1)
        elif shape.tag == "ellipse":  # a dot
            place = f"{value['cx']:g} {value['cy']:g}"
            yield f"q {value['rx'] + value['ry']:g} w 1 J {place} m {place} l S Q"
        else:
            yield _painted(shape, value)


def _turned(transform: str) -> str:
    """The matrix of a rotation about a point; nothing without one."""
    if not transform.startswith("rotate"):
        return ""
    angle, x, y = map(float, _NUMBER.findall(transform))
    turn, centre = cmath.rect(1.0, math.radians(angle)), complex(x, y)
    moved = centre - turn * centre
    a, b = turn.real, turn.imag
    return f"{a:.4f} {b:.4f} {-b:.4f} {a:.4f} {moved.real:.2f} {moved.imag:.2f}"


def _painted(shape: Element, value: Mapping[str, float]) -> str:
    """The operators of a path, polygon, polyline or rectangle."""
    width, dashes = value.get("stroke-width", 0.0), shape.get("stroke-dasharray", "")
    if shape.tag == "rect":
        outline = "{x:g} {y:g} {width:g} {height:g} re".format(**value)
    else:
        outline = _outline(shape)
    paint = "S" if shape.get("fill") == "none" else "B" if width else "f"
    ends = "1 J 1 j " if shape.get("stroke-linecap") == "round" else ""
    pattern = f"[{' '.join(_NUMBER.findall(dashes))}] 0 d " if dashes else ""
    return f"q {width:g} w {ends}{pattern}{outline} {paint} Q"


def _outline(shape: Element, scale: float = 0.0) -> str:
    """The outline of a path or polygon; with a `scale`, of a glyph, which is upside down."""
    operators: list[str] = []
    at = start = control = 0j
    across, down = (scale, -scale) if scale else (1.0, 1.0)
    points = f"M{shape.get('points')}{'z' if shape.tag == 'polygon' else ''}"
    for kind, text in _COMMAND.findall(shape.get("d", points)):
        if kind in "zZ":
            at, operators = start, [*operators, "h"]
            continue
        numbers, count = [float(n) for n in _NUMBER.findall(text)], _COUNTS[kind.lower()]
        for i in range(0, len(numbers), count):
            base, values = at if kind.islower() else 0j, numbers[i : i + count]
            if kind in "hH":
                places = [complex(base.real + values[0], at.imag)]
            elif kind in "vV":
                places = [complex(at.real, base.imag + values[0])]
            else:
                places = [base + complex(*values[j : j + 2]) for j in range(0, count, 2)]
            if kind in "sS":
                places.insert(0, 2 * at - control)
            is_curve, is_move = len(places) == 3, kind in "mM" and not i
            control, at = places[-2 if is_curve else -1], places[-1]
            start = at if is_move else start
            operators += [f"{across * p.real:.6g} {down * p.imag:.6g}" for p in places]
            operators += ["c" if is_curve else "m" if is_move else "l"]
    return " ".join(operators)


def _text(
    text: str, style: str, size: float, x: float, y: float, anchor: str, turned: int = 1
) -> str:
    """The operators of a line of text, which in a drawing has to be `turned` by -1."""
    x -= {"middle": 0.5, "end": 1.0}.get(anchor, 0.0) * _width(text, style) * size
    escaped = re.sub(r"([\\()])", r"\\\1", _encodable(text))
    font = f"/F{list(_FONTS).index(style)} {size:g} Tf"
    return f"BT {font} 1 0 0 {turned} {x:.2f} {y:.2f} Tm ({escaped}) Tj ET"


def _encodable(text: str) -> str:
    """A text in letters of Times; others are spelled, lose accents, or become "?"."""
    text = text.translate(_SPELLED)
    pairs = ((letter, unicodedata.normalize("NFKD", letter)[0]) for letter in text)
    letters = (letter if letter.encode(_ENCODING, "ignore") else base for letter, base in pairs)
    return "".join(letters).encode(_ENCODING, "replace").decode(_ENCODING)


def _width(text: str, style: str) -> float:
    """The length of a line of text, in parts of the size of its letters."""
    widths = (_widths(style).get(ord(letter), _UNITS_PER_EM / 2) for letter in _encodable(text))
    return sum(widths) / _UNITS_PER_EM


@cache
def _widths(style: str) -> dict[int, float]:
    """The widths of the letters of Times, by their numbers, which come with Verovio."""
    name = f"Times-{style}.xml" if style else "Times.xml"
    table = fromstring(resources.files("verovio").joinpath("data", "text", name).read_bytes())
    return {int(g.attrib["c"], 16): float(g.get("h-a-x") or g.get("w") or 0) for g in table}


def _document(pages: Sequence[bytes]) -> bytes:
    """The PDF of pages, each a stream of operators."""
    first = 3 + len(_FONTS)  # after the catalogue, the list of pages and the fonts
    kids = " ".join(f"{first + 2 * i} 0 R" for i in range(len(pages)))
    fonts = " ".join(f"/F{i} {3 + i} 0 R" for i in range(len(_FONTS)))
    objects = [
        b"/Type/Catalog/Pages 2 0 R",
        f"/Type/Pages/Kids[{kids}]/Count {len(pages)}".encode(),
    ]
    font = "/Type/Font/Subtype/Type1/Encoding/WinAnsiEncoding/BaseFont/"
    objects += [f"{font}{name}".encode() for name in _FONTS.values()]
    page = f"/Type/Page/Parent 2 0 R/MediaBox[0 0 {_WIDTH} {_HEIGHT}]/Resources<</Font<<{fonts}>>>>"
    for drawing in map(zlib.compress, pages):
        objects.append(f"{page}/Contents {len(objects) + 2} 0 R".encode())
        head = f"/Length {len(drawing)}/Filter/FlateDecode>>\nstream\n".encode()
        objects.append(head + drawing + b"\nendstream")
    content, places = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, start=1):
        places.append(f"{len(content):010} 00000 n \n")
        close = b"" if body.endswith(b"endstream") else b">>"
        content += f"{number} 0 obj\n<<".encode() + body + close + b"\nendobj\n"
    table = f"xref\n0 {len(places) + 1}\n0000000000 65535 f \n{''.join(places)}"
    end = f"trailer\n<</Size {len(places) + 1}/Root 1 0 R>>\nstartxref\n{len(content)}\n%%EOF\n"
    return content + f"{table}{end}".encode()
