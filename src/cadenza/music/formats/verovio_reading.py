"""Humdrum and MEI, which Verovio plays as MIDI.

Verovio does so in a process of its own, `python -m cadenza.music.formats.verovio_reading FORMAT`,
which reads a file on stdin and prints a MIDI file: damaged files have it crash.
"""

from __future__ import annotations

import base64
import subprocess
import sys
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from cadenza.errors import CadenzaError
from cadenza.music.formats.midi import read_midi
from cadenza.music.formats.source import read_bytes
from cadenza.music.score import Score

_PATIENCE = 30  # [s] for a file
_MEMORY = 1 << 30  # bytes that Verovio may use


def read_by_verovio(path: Path, form: str, tracks: Collection[int] = ()) -> Score:
    """The piano score in a Humdrum or MEI file: its notes, bars and tempos, with all repeats.

    `form` is "Humdrum" or "MEI". All parts are played together, or only `tracks`. The file has
    no velocities for us, nor fingers.

    Raises:
        CadenzaError: no such file, or one that Verovio makes no music of; or what `read_midi`
            refuses.
    """
    midi = _played(read_bytes(path), form)
    if not midi:
        raise CadenzaError(
            f"{path}: cannot be read as {form}; open it in a notation program such as "
            "MuseScore, and export it as MusicXML"
        )
    score = read_midi(path, tracks, midi)
    said = f"read by Verovio as {form}: without loudness, pedal and fingers"
    return replace(score, remarks=(said, *score.remarks))


def _played(content: bytes, form: str) -> bytes:
    """Returns a file as MIDI; nothing if Verovio does not make it in time."""
    command = [sys.executable, "-P", "-m", __name__, form]
    try:
        played = subprocess.run(
            command,
            input=content,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_PATIENCE,
        )
    except subprocess.TimeoutExpired:
        return b""
    return b"" if played.returncode else played.stdout


def main() -> None:
    """Prints the file on stdin as MIDI."""
    import resource  # which only Unix has

    import verovio

    resource.setrlimit(resource.RLIMIT_DATA, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    verovio.enableLog(verovio.LOG_OFF)
    toolkit = verovio.toolkit()
    toolkit.setOptions({"inputFrom": sys.argv[1].lower(), "breaks": "none"})
    content = sys.stdin.buffer.read()
    encoding = "utf-16" if content.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
    if toolkit.loadData(content.decode(encoding, "replace")):
        sys.stdout.buffer.write(base64.b64decode(toolkit.renderToMIDI()))


if __name__ == "__main__":
    main()
