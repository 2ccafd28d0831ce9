"""A performance as one HTML file: in three dimensions, with sound, piano roll and scores.

The page needs neither a network nor a server. Its 3D drawing is three.js (cut down to 570 kB), its
charts are uPlot (50 kB). Copies of both (MIT) lie in `assets`, because no Python package carries
ones that serve. Of three.js, trimesh has the release of 2022 inside the template of its own viewer,
meshcat, viser, pythreejs and k3d bring a web server or Jupyter, and bare copies come with packages
of another purpose. Libraries of charts for Python bring megabytes (plotly, bokeh, altair).
"""

from __future__ import annotations

import base64
import html
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from cadenza.episode import Episode
from cadenza.files import write_atomically
from cadenza.music.formats.finger_numbers import finger_from
from cadenza.report.asset import asset
from cadenza.report.recording import embedded
from cadenza.report.sound import SAMPLE_RATE, Samples

_SCRIPTS = (
    *("recording.js", "rows.js", "flat.js", "falling.js", "stage.js"),
    *("chart.js", "roll.js", "rewards.js", "controls.js", "page.js"),
)

Parts = Mapping[str, str | Iterable[str]]
"""By the names that they have in a template; a long one comes in pieces, and stands there once."""
_HEADLINES = {
    "f1": ("F1", "The balance of precision and recall, 0 to 1. At 1 every key is right, always."),
    "precision": ("Precision", "Of the keys that sound, the share that should, 0 to 1."),
    "recall": ("Recall", "Of the keys that should sound, the share that do, 0 to 1."),
    "note_onset_f1": ("Note onset F1", "Notes that begin within 50 ms of their time, 0 to 1."),
}
"""What stands at the top of the page, with what it means; the rest is folded."""


def write_report(
    path: Path,
    episode: Episode,
    metrics: Mapping[str, Any],
    settings: Mapping[str, Any],
    audio: Samples,
    sample_rate: int = SAMPLE_RATE,
    misses: Sequence[Mapping[str, Any]] = (),
    goal_mp3: bytes = b"",
    midi: bytes = b"",
    video: str = "",
) -> None:
    """Writes the page of an episode to `path`.

    Args:
        episode: what to show; without a drawn scene, the page has all but the 3D view.
        metrics: name -> number or text; nested mappings are flattened. NaN is shown as a dash.
        settings: name -> value, nested or not; `agent` and `seed` are also named at the top, and
            each of `remarks`. None is not shown; of an absolute path, only the last part.
        audio: the performance as `synthesize` makes it, starting with the first step.
        misses: of each note that was lost `time` [s], `note`, `finger` as files have it, `what`
            became of it, and the `reason`; without any, the page has no such table.
        goal_mp3: what should have been played, of the same length; without, it cannot be heard.
        midi: a MIDI file to download.
        video: name of a file beside the page to download.
    """
    recording = embedded(episode, audio, sample_rate, goal_mp3)
    own = own_parts(episode, metrics, settings, recording, misses, midi, video)
    write_page(path, "page.html", own | shared_parts())


def framed(page: str) -> str:
    """A whole page as a part of another, such as a notebook."""
    text = page.replace("&", "&amp;").replace('"', "&quot;")
    return f'<iframe srcdoc="{text}" style="width: 100%; height: 800px; border: 0"></iframe>'


def own_parts(
    episode: Episode,
    metrics: Mapping[str, Any],
    settings: Mapping[str, Any],
    recording: Iterable[str],
    misses: Sequence[Mapping[str, Any]] = (),
    midi: bytes = b"",
    video: str = "",
) -> dict[str, str | Iterable[str]]:
    """What the page of an episode does not share with others; `recording` is what it embeds."""
    shown, remarks = _metrics_shown(episode, metrics), settings.get("remarks") or ()
    settings = {name: value for name, value in settings.items() if name != "remarks"}
    facts = _facts(episode, dict(flat(settings)))
    return {
        "title": html.escape(episode.song or "Untitled"),
        "facts": "".join(
            f"<span>{html.escape(k)} <b>{html.escape(v)}</b></span>" for k, v in facts
        ),
        "remarks": "".join(f'<p class="remark">{html.escape(each)}</p>' for each in remarks),
        "headlines": "".join(_headline(name, shown[name]) for name in _HEADLINES if name in shown),
        "figures": _figures(shown),
        "misses": _misses(misses),
        "settings": settings_section(settings),
        "downloads": _downloads(midi, video),
        "roll_label": html.escape(_in_words(episode)),
        "recording": recording,
    }


def shared_parts() -> dict[str, str]:
    """Looks and scripts of the page of any episode."""
    return {
        "css": "".join(map(asset, ("uplot.min.css", "page.css", "chart.css"))),
        "three": asset("three.min.js"),
        "uplot": asset("uplot.min.js"),
        "js": "\n".join(map(asset, _SCRIPTS)),
    }


def write_page(path: Path, template: str, parts: Parts) -> None:
    """Writes the asset `template` to `path`, each `{{name}}` in it replaced by its part."""
    with write_atomically(path) as file:
        for _, text in pieces(template, parts):
            file.write(text.encode("utf-8", "replace"))  # names of files need not be text


def pieces(template: str, parts: Parts) -> Iterator[tuple[str, str]]:
    """The asset `template` piece by piece, each with the name of its part, or "" between parts."""
    texts = re.split(r"{{(\w+)}}", asset(template))
    for text, name in zip_longest(texts[::2], texts[1::2], fillvalue=""):
        yield "", text
        part = parts[name] if name else ""
        yield from ((name, piece) for piece in ([part] if isinstance(part, str) else part))


def _facts(episode: Episode, settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    named = {name.rsplit(".", 1)[-1]: settings[name] for name in reversed(list(settings))}
    shown = (name for name in ("agent", "seed") if named.get(name) is not None)
    facts = [(name, _plain(named[name])) for name in shown]
    if named.get("hands") == "apart":
        facts.append(("recordings", "of each hand by itself, combined"))
    seconds = episode.num_steps * episode.dt
    return [*facts, ("length", f"{seconds:.1f} s"), ("control steps", str(episode.num_steps))]


def _in_words(episode: Episode) -> str:
    goal, played = episode["goal_keys"], episode["key_activation"]
    hit, wrong = np.sum(goal & played), np.sum(played & ~goal)
    return (
        f"Piano roll of {episode.num_steps * episode.dt:.1f} seconds: of {goal.sum()} key steps "
        f"to play, {hit} were hit; {wrong} were wrong"
    )


def _metrics_shown(episode: Episode, metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Flattened, and without the pedal's where the piece has none."""
    pedal = bool(episode["goal_sustain"].any())
    return {name: v for name, v in flat(metrics) if pedal or not name.startswith("sustain_")}


def _headline(name: str, value: Any) -> str:
    title, meaning = _HEADLINES[name]
    number = _number(value)
    bar = f'<div class="bar"><i style="width:{100 * number:.1f}%"></i></div>' if number else ""
    shown = "–" if number is None else f"{number:z.3f}"
    return (
        f'<div class="score"><h2>{title}</h2><p class="value">{shown}</p>{bar}'
        f"<p>{meaning}</p></div>"
    )


def _figures(metrics: Mapping[str, Any]) -> str:
    """A table of those without a headline, nothing if there are none."""
    rows = {
        _spoken(name.removesuffix("_seconds")): _with_unit(name, value)
        for name, value in metrics.items()
        if name not in _HEADLINES
    }
    return _folded("All other figures", _table(rows)) if rows else ""


def _with_unit(name: str, value: Any) -> str:
    if isinstance(value, str):
        return html.escape(value)
    number = _number(value)
    if number is None or isinstance(value, bool):
        return "–" if number is None else "yes" if value else "no"
    unit = " s" if name.endswith(("seconds", "timing_error")) else ""
    return f"{round(number, 3):z.6g}{unit}"


def settings_section(settings: Mapping[str, Any]) -> str:
    """A table to unfold of those that are not None, nothing if there are none."""
    shown = {name: value for name, value in flat(settings) if value is not None}
    return _folded("Settings", _table(shown)) if shown else ""


def _folded(title: str, content: str) -> str:
    return (
        f'<details class="card"><summary>{title}</summary>'
        f'<div class="scroll">{content}</div></details>'
    )


def _table(rows: Mapping[str, Any]) -> str:
    cells = (
        f'<tr><th scope="row">{_breakable(name)}</th><td>{_breakable(_plain(value))}</td></tr>'
        for name, value in rows.items()
    )
    return f"<table>{''.join(cells)}</table>"


def _plain(value: Any) -> str:
    """Of a path only its name: folders of this machine say nothing to whoever reads the page."""
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value)) or "–"
    path = Path(text := str(value))
    return path.name if path.is_absolute() else text


def _downloads(midi: bytes, video: str) -> str:
    links = []
    if midi:
        source = f"data:audio/midi;base64,{base64.b64encode(midi).decode()}"
        links.append(f'<a class="button" href="{source}" download="played.mid">MIDI file</a>')
    if video:
        name = html.escape(video)
        links.append(f'<a class="button" href="{name}" download="{name}">Video</a>')
    return "".join(links)


def _misses(misses: Sequence[Mapping[str, Any]]) -> str:
    """A section with a row for each, nothing if there are none."""
    if not misses:
        return ""
    titles = ("Time", "Note", "Finger", "What", "Why")
    head = "".join(f'<th scope="col">{title}</th>' for title in titles)
    return (
        '<section class="card" aria-labelledby="misses-title">'
        f'<h2 id="misses-title">Notes missed or let go early: {len(misses)}</h2>'
        '<div class="scroll list" tabindex="0" aria-labelledby="misses-title" role="group">'
        f'<table id="misses"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(map(_miss, misses))}</tbody></table></div></section>"
    )


def _miss(miss: Mapping[str, Any]) -> str:
    """A row; its button, and a click anywhere on it, goes there."""
    texts = (miss["note"], _finger(miss["finger"]), miss["what"], miss["reason"])
    cells = "".join(f"<td>{html.escape(text)}</td>" for text in texts)
    time = f"{miss['time']:.2f}"
    return f'<tr data-time="{time}"><td><button type="button">{time} s</button></td>{cells}</tr>'


def _finger(number: int | str) -> str:
    finger = finger_from(number)
    return finger.name if finger else "–"


def _breakable(text: str) -> str:
    """`text` that a narrow screen breaks after separators rather than within words."""
    return re.sub(r"[/\\_,=]|\.(?=[^\W\d])", r"\g<0><wbr>", html.escape(text))


def _spoken(name: str) -> str:
    words = re.sub(r"[_./]+", " ", name).strip()
    return re.sub(r"\bf1\b", "F1", words[:1].upper() + words[1:], flags=re.IGNORECASE)


def flat(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested mappings, with the names that lead to each, joined by dots."""
    for name, value in mapping.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _number(value: Any) -> float | None:
    """`value` short enough for the page, None where it is no finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return float(f"{number:.5g}") if math.isfinite(number) else None
