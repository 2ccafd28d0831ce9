"""The reader of music files of every known format."""

import os
import re
from collections.abc import Collection
from pathlib import Path

from cadenza.errors import CadenzaError
from cadenza.files import opened
from cadenza.music.score import Score

_MIDI = (".mid", ".midi", ".kar", ".rmi")
SHEET = ".musicxml"  # the ending of the names of files of sheet music that are written
_MUSICXML = (SHEET, ".xml", ".mxl")
_BY_VEROVIO = {".krn": "Humdrum", ".mei": "MEI"}
_BEGINS_MIDI = (b"MThd", b"RIFF")
_IS_MEI = re.compile(rb"<(\w+:)?mei(Corpus)?[\s>/]")
_BEGINNING = 1 << 12  # bytes of a file, among which an MEI file says what it is
MUSIC = (*_MIDI, *_MUSICXML, *_BY_VEROVIO)  # the endings of music files

_NOTATION = "open it in a notation program such as MuseScore, and export it as MIDI or MusicXML"
_SOUND = "convert the sound to MIDI with a transcription program such as Basic Pitch"
_SHEET = "convert the sheet music to MusicXML with a recognition program such as Audiveris"
NOT_READ = {  # ending of other files -> how to convert them
    **dict.fromkeys((".mscz", ".mscx", ".sib", ".musx", ".dorico", ".ptb"), _NOTATION),
    **dict.fromkeys((".gp", ".gp3", ".gp4", ".gp5", ".gpx", ".cap", ".capx"), _NOTATION),
    **dict.fromkeys((".abc",), "convert it with abc2midi"),
    **dict.fromkeys((".ly",), "have LilyPond write MIDI: add \\midi {} to its \\score block"),
    **dict.fromkeys((".mp3", ".wav", ".flac", ".ogg", ".oga", ".m4a", ".aac", ".opus"), _SOUND),
    **dict.fromkeys((".wma", ".aif", ".aiff", ".mp4", ".mov", ".webm", ".mkv", ".avi"), _SOUND),
    **dict.fromkeys((".pdf", ".png", ".jpg", ".jpeg", ".tif", ".tiff"), _SHEET),
    **dict.fromkeys((".gif", ".bmp", ".webp", ".heic", ".svg"), _SHEET),
}


def name_without_ending(song: str) -> str:
    """The last part of a path or a name, without the ending of a file of music."""
    path = Path(song)
    return path.stem if path.suffix.lower() in MUSIC else path.name


def check_format(path: Path) -> None:
    """Check the ending of a file; raises CadenzaError if its format is not read."""
    suffix = path.suffix.lower()
    if suffix in NOT_READ:
        raise CadenzaError(f"{path}: {suffix} files cannot be read; {NOT_READ[suffix]}")


def read_score(path: Path, tracks: Collection[int] = (), plain: bool = False) -> Score:
    """The score in a MIDI, MusicXML, Humdrum or MEI file, of all `Score.tracks` or some.

    The first bytes of the file tell its format, or else its ending; with an unknown one it is read
    as MIDI. Of MusicXML, `plain` plays the notes as they stand, whatever signs they have. Notes
    have the fingers of a file beside it with the ending .fingering, see
    `cadenza.music.formats.fingering_file`. Raises CadenzaError if its format is not read, or one of
    `read_midi`, `read_musicxml`, `read_by_verovio` and `read_fingering` refuses it.
    """
    from cadenza.music.formats.fingering_file import SUFFIX, read_fingering
    from cadenza.music.formats.midi import read_midi
    from cadenza.music.formats.musicxml.reader import read_musicxml
    from cadenza.music.formats.verovio_reading import read_by_verovio

    form = _form_of(path)
    if form in _BY_VEROVIO:
        score = read_by_verovio(path, _BY_VEROVIO[form], tracks)
    elif form in _MIDI:
        score = read_midi(path, tracks)
    else:
        score = read_musicxml(path, tracks, plain)
    sidecar = path.with_suffix(SUFFIX)
    if not os.path.isfile(sidecar):  # also where that name is too long
        return score
    return read_fingering(sidecar, score, all_there=not tracks)


def _form_of(path: Path) -> str:
    """The ending that files of its format have; raises CadenzaError if that is not read."""
    check_format(path)
    beginning = _beginning(path)
    form, suffix = ending_of(beginning), path.suffix.lower()
    if form in _MIDI and suffix in MUSIC and not beginning.startswith(_BEGINS_MIDI):
        return suffix  # its bytes say nothing
    return form


def ending_of(content: bytes) -> str:
    """The ending that fits the first bytes of a file of music; that of MIDI if none does."""
    if content.startswith(b"PK"):
        return ".mxl"
    text = content[:_BEGINNING].replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n")
    if text.startswith(b"<"):
        return ".mei" if _IS_MEI.search(text) else SHEET
    return ".krn" if text.startswith((b"**", b"!!")) else _MIDI[0]


def _beginning(path: Path) -> bytes:
    """The first bytes; none if the file cannot be read, which its reader will report."""
    try:
        with opened(path) as file:
            return file.read(_BEGINNING) or b""  # of the kernel's log there may be nothing yet
    except (OSError, ValueError):
        return b""
