"""A performance as one HTML file: in three dimensions, with sound, piano roll and scores.

The page needs neither a network nor a server. Its 3D drawing is three.js, of which a cut-down copy
(MIT, 570 kB) lies in `assets`, because no Python package carries one that serves: trimesh has the
release of 2022 inside the template of its own viewer, meshcat, viser, pythreejs and k3d bring a web
server or Jupyter, and bare copies come with packages of another purpose.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.episode import Episode
from cadenza.files import write_atomically
from cadenza.report.recording import embedded
from cadenza.report.sound import SAMPLE_RATE

_SCRIPTS = ("recording.js", "flat.js", "stage.js", "charts.js", "page.js")


def write_report(
    path: Path,
    episode: Episode,
    metrics: Mapping[str, Any],
    settings: Mapping[str, Any],
    audio: NDArray[np.floating],
    sample_rate: int = SAMPLE_RATE,
    misses: Sequence[Mapping[str, Any]] = (),
) -> None:
    """Writes the page of an episode to `path`.

    Args:
        episode: what to show; without a drawn scene, the page has all but the 3D view.
        metrics: name -> number; nested mappings are flattened. NaN is shown as a dash.
        settings: name -> value, nested or not; `agent` and `seed` are also named at the top. None
            is not shown.
        audio: the performance, (n,) or (n, 2) within -1..1, starting with the first step.
        misses: of each note that was lost `time` [s], `note`, `finger` 0..9 or -1, `what` became of
            it, and the `reason`; without any, the page has no such table.
    """
    figures = sorted(flat(metrics), key=lambda item: item[0] != "f1")
    facts = _facts(episode, dict(flat(settings)))
    parts = {
        "title": html.escape(episode.song or "Untitled"),
        "facts": "".join(
            f"<span>{html.escape(k)} <b>{html.escape(v)}</b></span>" for k, v in facts
        ),
        "cards": "".join(_card(name, value) for name, value in figures),
        "misses": _misses(misses),
        "settings": _table(dict(flat(settings))),
        "roll_label": html.escape(_in_words(episode)),
        "recording": embedded(episode, audio, sample_rate),
        "css": asset("page.css"),
        "three": asset("three.min.js"),
        "js": "\n".join(map(asset, _SCRIPTS)),
    }
    write_page(path, "page.html", parts)


def write_page(path: Path, template: str, parts: Mapping[str, str | Iterable[str]]) -> None:
    """Writes the asset `template` to `path`, each `{{name}}` in it replaced by its part.

    A long part comes in pieces; each stands in the template once.
    """
    texts = re.split(r"{{(\w+)}}", asset(template))
    with write_atomically(path) as file:
        for text, name in zip_longest(texts[::2], texts[1::2]):
            file.write(text.encode())
            part = parts[name] if name else ""
            for piece in [part] if isinstance(part, str) else part:
                file.write(piece.encode())


def _facts(episode: Episode, settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    named = {name.rsplit(".", 1)[-1]: settings[name] for name in reversed(list(settings))}
    facts = [(name, str(named[name])) for name in ("agent", "seed") if named.get(name) is not None]
    seconds = episode.num_steps * episode.dt
    return [*facts, ("length", f"{seconds:.1f} s"), ("control steps", str(episode.num_steps))]


def _in_words(episode: Episode) -> str:
    goal, played = episode["goal_keys"], episode["key_activation"]
    hit, wrong = np.sum(goal & played), np.sum(played & ~goal)
    return (
        f"Piano roll of {episode.num_steps * episode.dt:.1f} seconds: of {goal.sum()} key steps "
        f"to play, {hit} were hit; {wrong} were wrong"
    )


def _card(name: str, value: Any) -> str:
    number = _number(value)
    bar = ""
    if number is not None and name.endswith(("f1", "precision", "recall")):
        bar = f'<div class="bar"><i style="width:{100 * number:.1f}%"></i></div>'
    shown = "–" if number is None else f"{number:z.3f}" if bar else f"{round(number, 3):z.6g}"
    return f'<dl class="score"><dt>{html.escape(_spoken(name))}</dt><dd>{shown}</dd>{bar}</dl>'


def _table(settings: Mapping[str, Any]) -> str:
    rows = (
        f'<tr><th scope="row">{_breakable(name)}</th><td>{_breakable(str(value))}</td></tr>'
        for name, value in settings.items()
        if value is not None
    )
    return f"<table>{''.join(rows)}</table>"


def _misses(misses: Sequence[Mapping[str, Any]]) -> str:
    """A section with a row for each, nothing if there are none."""
    if not misses:
        return ""
    rows = (
        (
            f"{miss['time']:.2f} s",
            miss["note"],
            _finger(miss["finger"]),
            miss["what"],
            miss["reason"],
        )
        for miss in misses
    )
    cells = ("".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in rows)
    return (
        '<section class="card" aria-labelledby="misses-title">'
        f'<h2 id="misses-title">Notes missed or let go early: {len(misses)}</h2>'
        f'<div class="scroll list" tabindex="0"><table><tr>{"</tr><tr>".join(cells)}</tr></table>'
        "</div></section>"
    )


def _finger(finger: int) -> str:
    names = ("thumb", "index", "middle", "ring", "little")
    return f"{('right', 'left')[finger // 5]} {names[finger % 5]}" if finger >= 0 else "–"


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


def asset(name: str) -> str:
    """The text of a file of `assets`."""
    return resources.files("cadenza.report").joinpath("assets", name).read_text("utf-8")
