"""The tree of a MusicXML document, refused as soon as it is too large for a song."""

import io
import posixpath
import re
from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote
from xml.etree.ElementTree import Element, SubElement, TreeBuilder
from xml.parsers import expat
from zipfile import ZipFile

from cadenza.errors import CadenzaError, errors_in, shortened
from cadenza.files import unpacked
from cadenza.music.formats.source import read_bytes

MAX_XML_BYTES = 16 * 2**20
# A long sonata has a tenth of these.
MAX_PARTS = 800_000  # elements and attributes
MAX_NOTES = 40_000
MAX_DEPTH = 64  # elements within each other; MusicXML has a dozen
_CONTENTS = "META-INF/container.xml"
_MAX_CONTENTS = 2**16  # bytes
_ENDINGS = (".xml", ".musicxml")
_FROM_MACOS = re.compile(r"(^|/)(__MACOSX/|\._)")
_MAX_NAME = 40  # letters of a name that a message repeats
_PARTWISE, _TIMEWISE = "score-partwise", "score-timewise"
_ADVICE = "open it in a notation program such as MuseScore, and export it as MusicXML"
_DECLARED = re.compile(rb"""encoding\s*=\s*["']([\w.-]{1,40})""")
_BEGINNING = 200  # bytes, among which the encoding is declared
_BYTE_VALUES = bytes(range(256))


def tree_of(path: Path) -> Element:
    """The root of the document, from its archive where it is compressed: parts that hold measures.

    Names lose their prefixes of namespaces, and attributes with a prefix, which MusicXML does not
    use, are left out. Raises CadenzaError if it cannot be read, is no MusicXML, declares anything
    of its own, or is too large or too deeply nested for a song.
    """
    data = read_bytes(path, MAX_XML_BYTES)
    with errors_in(path):
        if data.startswith(b"PK"):
            data = _document_of(data)
        text = _decoded(data)
        beginning = text[:_BEGINNING].lower()
        if not beginning.startswith("<"):
            raise CadenzaError(f"not a MusicXML file (it does not begin as XML); {_ADVICE}")
        if beginning.startswith(("<!doctype html", "<html")):
            raise CadenzaError("is a page (HTML), no music; download the file itself")
        return _by_parts(_Tree().root_of(text))


def _decoded(data: bytes) -> str:
    """The text of a document, whatever encoding it declares: programs err in that.

    What can be read as UTF-8 is. Other text has the encoding that it declares, if that has a letter
    for each byte, or else that of Windows.
    """
    encodings = ["utf-8-sig", "cp1252"]
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ["utf-16"]
    elif b"\0" in data[:2]:
        encodings = ["utf-16-be" if data.startswith(b"\0") else "utf-16-le"]
    elif declared := _DECLARED.search(data[:_BEGINNING]):
        name = declared[1].decode()
        with suppress(LookupError, UnicodeError):  # no such encoding
            if len(_BYTE_VALUES.decode(name, "replace")) == len(_BYTE_VALUES):
                encodings.insert(1, name)
    for encoding in encodings:
        with suppress(UnicodeDecodeError):
            return data.decode(encoding).lstrip()
    return data.decode("latin-1").lstrip()


class _Tree:
    def __init__(self) -> None:
        # Without namespaces, whose names are repeated with every element.
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = True
        self._parser.StartDoctypeDeclHandler = self._declare
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._tree = TreeBuilder()
        self._parser.CharacterDataHandler = self._tree.data
        self._open: list[str] = []
        self._parts = self._notes = 0

    def root_of(self, text: str) -> Element:
        try:
            self._parser.Parse(text, True)
        except CadenzaError:
            raise
        except Exception as error:
            raise CadenzaError(f"cannot be read as MusicXML ({shortened(str(error))})") from error
        return self._tree.close()

    def _declare(self, name: str, system: str | None, public: str | None, own: int) -> None:
        if own:
            raise CadenzaError("declares XML entities or the like, which MusicXML does not use")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        name = name.rpartition(":")[2]
        self._parts += 1 + len(attributes)
        self._notes += name == "note"
        if self._parts > MAX_PARTS:
            raise CadenzaError(f"over {MAX_PARTS} elements and attributes, too large for a song")
        if self._notes > MAX_NOTES:
            raise CadenzaError(f"over {MAX_NOTES} notes, too large for a song")
        if len(self._open) == MAX_DEPTH:
            raise CadenzaError(f"over {MAX_DEPTH} elements within each other, which no music has")
        self._open.append(name)
        plain = {n: v for n, v in attributes.items() if n != "xmlns" and ":" not in n}
        self._tree.start(name, plain)

    def _end(self, _: str) -> None:
        self._tree.end(self._open.pop())


def _by_parts(root: Element) -> Element:
    """The root of a score, converted from score-timewise to score-partwise where it is not."""
    if root.tag == _PARTWISE:
        return root
    if root.tag != _TIMEWISE:
        name = shortened(root.tag, _MAX_NAME)
        raise CadenzaError(f"cannot be read as MusicXML (it is <{name}>); {_ADVICE}")
    parts: dict[str, Element] = {}
    for measure in root.iterfind("measure"):
        for music in measure.iterfind("part"):
            part = parts.setdefault(music.get("id", ""), Element("part", music.attrib))
            SubElement(part, "measure", measure.attrib).extend(music)
    root[:] = [each for each in root if each.tag != "measure"] + list(parts.values())
    return root


def _document_of(data: bytes) -> bytes:
    """The document in a compressed MusicXML file."""
    try:
        with ZipFile(io.BytesIO(data)) as archive:
            return unpacked(archive, _name_of_document(archive), MAX_XML_BYTES)
    except CadenzaError as error:
        raise CadenzaError(f"the compressed MusicXML: {error}") from error
    except Exception as error:  # damage shows in many ways
        reason = shortened(str(error)) or type(error).__name__
        raise CadenzaError(f"the compressed MusicXML is damaged ({reason})") from error


def _name_of_document(archive: ZipFile) -> str:
    """The first document in the table of contents; without one, the only one but for macOS's."""
    names = [name for name in archive.namelist() if not _FROM_MACOS.search(name)]
    if _CONTENTS in names:
        names_by_plain = {_plain(name): name for name in names}
        contents = _Tree().root_of(_decoded(unpacked(archive, _CONTENTS, _MAX_CONTENTS)))
        listed = [_plain(each.get("full-path", "")) for each in contents.iter("rootfile")]
        documents = [names_by_plain[name] for name in listed if name in names_by_plain]
        if documents:
            return min(documents, key=lambda name: not name.lower().endswith(_ENDINGS))
    documents = [n for n in names if n.lower().endswith(_ENDINGS) and not n.endswith(_CONTENTS)]
    if len(documents) != 1:
        raise CadenzaError(
            f"{len(documents)} documents, and no table of contents ({_CONTENTS}) that names one"
        )
    return documents[0]


def _plain(path: str) -> str:
    """A path in an archive, as programs differ in how they write it."""
    return posixpath.normpath(unquote(path).replace("\\", "/").lstrip("/")).lower()
