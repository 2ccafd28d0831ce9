"""Humdrum and MEI, which Verovio plays as MIDI.

It does so in a process of its own, `python -m cadenza.music.formats.verovio_reading FORMAT`, which
reads a file on stdin and prints what it makes of it: damaged files have Verovio crash.
"""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from html import unescape
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadenza.errors import CadenzaError, errors_in
from cadenza.music.formats.midi import score_of
from cadenza.music.formats.midi_messages import METRE, TEMPO, Message, parsed
from cadenza.music.formats.source import printable, read_bytes, title_of
from cadenza.music.repair import counted_remarks
from cadenza.music.score import BEAT_TYPES, Score
from cadenza.music.signs.tempo_map import AS_USUAL

if TYPE_CHECKING:
    from cadenza.music.formats.mei_unfolding import MeiBar

_PATIENCE = 30  # [s] for a file
_MEMORY = 1 << 30  # bytes that Verovio may use
_OPTIONS = {"breaks": "none", "mdivAll": True, "expandNever": True}
# All notes are there, as they sound, whatever the instrument and the signs for engraving. Verovio
# takes four times as long where marks above and below are defined (RDF).
_FOR_ENGRAVING = re.compile(r"(?m)(^|\t)\*(?:I?Tr[-dc\d]|tremolo|rep\b)[^\t\r\n]*")
_LIST = re.compile(r"(?m)^(?:\*\t)*\*>\[")
_SECTION = re.compile(r"(?:^|\t)\*>(?!\w*\[)")  # the beginning of one
_LABEL = re.compile(r"(?<=[>\[,])[^\[\],\t]+(?=[\],\t]|$)")  # also each in a list
_HEAD = 1 << 16  # letters of a file, among which it names its title and composer
_TITLE = {
    "Humdrum": re.compile(r"(?m)^!!!OTL[^:\n]*:(.*)$"),
    "MEI": re.compile(r"(?s)<titleStmt\b[^>]*>\s*<title\b[^>/]*>(.*?)</title>"),
}
_COMPOSER = {
    "Humdrum": re.compile(r"(?m)^!!!COM[^:\n]*:(.*)$"),
    "MEI": re.compile(r'(?s)<(composer|persName [^>]*role="composer")[^>/]*>(.*?)</'),
}
_NEAR = 1e-3  # beats by which Verovio may round
_MAX_BEATS = 255  # beats of a time signature in MIDI
_MINUTE = 60_000_000  # microseconds


def read_by_verovio(path: Path, form: str, tracks: Collection[int] = ()) -> Score:
    """The piano score in a Humdrum or MEI file: its notes, bars and tempos, with all repeats.

    `form` is "Humdrum" or "MEI". All parts are played together, or only `tracks`. The file has no
    velocities for us, nor fingers. Raises CadenzaError if it is not there, or Verovio makes no
    music of it, or what `read_midi` refuses.
    """
    content = read_bytes(path)
    output = _played(content, form)
    if not output:
        raise CadenzaError(
            f"{path}: cannot be read as {form}; open it in a notation program such as "
            "MuseScore, and export it as MusicXML"
        )
    midi, marks, left_out = json.loads(output)
    file = parsed(base64.b64decode(midi))
    # Verovio has incomplete bars as long as complete ones, and moves tempos to bars.
    music = [[each for each in track if each.kind not in (METRE, TEMPO)] for track in file.tracks]
    marked = [Message(tick, kind, base64.b64decode(content)) for tick, kind, content in marks]
    with errors_in(path):
        title = _named(_TITLE[form], content) or title_of(path)
        score = score_of(file._replace(tracks=[*music, marked]), tracks, title)
    remark = f"read by Verovio as {form}: without loudness, articulation and fingers"
    remarks = (remark, *_remarks(Counter(left_out)), *score.remarks)
    name = _named(_COMPOSER[form], content)
    composer = " ".join(reversed(name.split(", "))) if name.count(", ") == 1 else name
    return replace(score, remarks=remarks, composer=composer)


def _named(pattern: re.Pattern[str], content: bytes) -> str:
    """What the head of a file calls something, without tags; empty if it does not."""
    match = pattern.search(_text(content)[:_HEAD])
    return printable(unescape(re.sub("<[^>]*>", "", match[match.re.groups]))) if match else ""


def _text(content: bytes) -> str:
    encoding = "utf-16" if content.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"
    return content.decode(encoding, "replace")


def _remarks(counts: Counter[str]) -> list[str]:
    return counted_remarks(
        (
            (counts["copy"], "copy", "of what is not there left out"),
            (counts["sign"], "bar-repeat sign", "left out"),
            (counts["section"], "section", "that is to be played but not there left out"),
            (counts["jump"], "jump", "without a segno or coda to go to left out"),
            (counts["bar"], "bar", "passed over by all repeats and jumps"),
            (counts["tempo"], "tempo word", AS_USUAL),
            (counts["ornament"], "ornament", "left out"),
            (counts["fermata"], "fermata", "left out"),
            (counts["tremolo"], "tremolo", "between notes left out"),
            (counts["glissando"], "glissando", "left out"),
        )
    )


def _played(content: bytes, form: str) -> bytes:
    """What the process prints about a file; nothing if Verovio does not make it in time."""
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
    """Print what Verovio makes of the file on stdin."""
    import resource  # which only Unix has

    resource.setrlimit(resource.RLIMIT_DATA, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print(rendered(sys.stdin.buffer.read(), sys.argv[1]))


def rendered(content: bytes, form: str) -> str:
    """A file as MIDI in base 64, its marks, and counts of what is left out, as JSON."""
    from verovio import LOG_OFF, enableLog

    from cadenza.music.formats.mei_unfolding import unfolded

    enableLog(LOG_OFF)
    text = _text(content)
    if form == "Humdrum":
        text = _loaded(_plain(text), "humdrum").getMEI()
    text, bars, left_out = unfolded(text)
    toolkit = _loaded(text, "mei")
    midi = toolkit.renderToMIDI()
    places = toolkit.renderToTimemap({"includeMeasures": True})
    marks = _marks(bars, places, parsed(base64.b64decode(midi)).division)
    printed = [(tick, kind, base64.b64encode(data).decode()) for tick, kind, data, _ in marks]
    return json.dumps((midi, printed, left_out))


def _plain(text: str) -> str:
    """Humdrum from which Verovio makes all bars and sections, in little time.

    It has sections begin at barlines only, and takes those with numbers for endings, which they
    need not be where a list says the order.
    """
    lines, is_within, is_listed = list[str](), False, _LIST.search(text) is not None
    for line in _FOR_ENGRAVING.sub(r"\1*", text).splitlines():
        if line.startswith("*"):
            if is_within and _SECTION.search(line):
                lines.append("\t".join("=-" for _ in line.split("\t")))
                is_within = False
            if is_listed and "*>" in line:
                line = _LABEL.sub(r"\g<0>_", line.replace(" ", ""))
        elif not line.startswith("!"):
            is_within = not line.startswith("=")
        if not line.startswith("!!!RDF") or "linked" in line:  # which ties may be
            lines.append(line)
    return "\n".join(lines)


def _loaded(text: str, form: str) -> Any:
    import verovio

    toolkit = verovio.toolkit()
    toolkit.setOptions({"inputFrom": form, **_OPTIONS})
    if not toolkit.loadData(text):
        sys.exit(1)
    return toolkit


def _marks(
    bars: Mapping[str, MeiBar], places: Sequence[dict[str, Any]], division: int
) -> list[Message]:
    """The time signatures and tempos of bars, with `division` ticks in a quarter.

    `places` is Verovio's map of time.
    """
    quarters = {each["measureOn"]: each["qstamp"] for each in places if "measureOn" in each}
    begins = [0.0]
    for name in list(bars)[1:]:
        begins.append(quarters.get(name, begins[-1]))  # empty ones may be missing
    begins.append(places[-1]["qstamp"])
    marks: list[Message] = []
    metre, tempo = (0, 0), 0.0
    for bar, begin, end in zip(bars.values(), begins, begins[1:], strict=False):
        if end <= begin:
            continue
        last_metre, metre = metre, _metre(end - begin, bar.metre[1])
        if metre != last_metre:
            content = bytes((metre[0], metre[1].bit_length() - 1, 0, 0))
            marks.append(Message(round(begin * division), METRE, content))
        for place, new_tempo in bar.tempos:
            if new_tempo != tempo:
                tick = round((begin + float(place)) * division)
                marks.append(Message(tick, TEMPO, round(_MINUTE / new_tempo).to_bytes(3, "big")))
            tempo = new_tempo
    return sorted(marks, key=itemgetter(0))


def _metre(quarters: float, unit: int) -> tuple[int, int]:
    """The time signature of a bar of that length, with beats of `1 / unit` if they fill it."""
    unit = unit if unit in BEAT_TYPES else min(BEAT_TYPES)
    while unit < max(BEAT_TYPES) and abs(quarters * unit / 4 - round(quarters * unit / 4)) > _NEAR:
        unit *= 2
    return min(max(round(quarters * unit / 4), 1), _MAX_BEATS), unit


if __name__ == "__main__":
    main()
