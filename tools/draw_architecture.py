"""Draws how data flows through Cadenza: writes docs/architecture.svg.

python tools/draw_architecture.py
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

PICTURE = Path(__file__).parents[1] / "docs" / "architecture.svg"
WIDTH, HEIGHT = 940, 710
BOX = (136, 66)  # [px] width and height
COLUMNS = (20, 211, 402, 593, 784)
ROWS = (24, 164, 244, 364, 458, 572)
LEGEND = (("given", "yours to exchange"), ("box", "Cadenza"), ("made", "results"))
STYLE = """
  text { font-family: system-ui, "Segoe UI", Helvetica, Arial, sans-serif; fill: #1b2530; }
  .what { font-size: 16px; font-weight: 600; text-anchor: middle; }
  .folder { font: 13px ui-monospace, Menlo, monospace; text-anchor: middle; fill: #4a5a6a; }
  .label { font-size: 13px; text-anchor: middle; fill: #4a5a6a; }
  .legend { font-size: 13px; fill: #4a5a6a; }
  rect.inside { fill: none; stroke: #7c95ad; stroke-dasharray: 5 4; }
  rect.box { fill: #e8f0f8; stroke: #7c95ad; }
  rect.given { fill: #f6efe0; stroke: #b59a63; }
  rect.made { fill: #e6f3ea; stroke: #74a384; }
  path.arrow { fill: none; stroke: #4a5a6a; stroke-width: 1.6; marker-end: url(#head); }
"""


class Box(NamedTuple):
    column: float
    row: float
    what: str
    folder: str
    kind: str = "box"


class Arrow(NamedTuple):
    points: tuple[tuple[float, float], ...]
    label: str = ""
    at: tuple[float, float] = (0, 0)
    """The middle of the label [px]."""


BOXES = (
    Box(0, 0, "song", "MIDI, MusicXML", "given"),
    Box(1, 0, "score", "music/"),
    Box(2, 0, "arrangement", "arranging/"),
    Box(3, 0, "fingers", "fingering/"),
    Box(4, 0, "goals", "tasks/"),
    Box(0, 1, "hand", "hands/", "given"),
    Box(0, 2, "keyboard", "keyboards/", "given"),
    Box(1, 1.5, "scene", "scene/"),
    Box(2, 1.5, "simulation", "sim/"),
    Box(3, 1.5, "task", "tasks/"),
    Box(4, 1.5, "agent", "agents/", "given"),
    Box(0, 3, "results", "evaluation/", "made"),
    Box(1, 3, "page, sound", "report/", "made"),
    Box(2, 3, "performance", "performing/", "made"),
    Box(3, 3, "episode", "episode.py", "made"),
    Box(4, 3, "learner", "learning/", "given"),
    Box(3, 4, "live page", "studio/", "made"),
    Box(4, 4, "episodes", "demonstrations/", "made"),
)
AGENTS = (
    Box(0, 5, "nominal plan", "planner/plan/"),
    Box(1, 5, "search", "planner/search/"),
    Box(2, 5, "practice", "planner/practice/"),
    Box(3, 5, "generalist", "generalist/"),
    Box(4, 5, "other planners", "baselines/"),
)


def place(box: Box) -> tuple[float, float]:
    """The upper left corner of a box [px]."""
    below = int(box.row)
    y = ROWS[below] + (box.row - below) * (ROWS[min(below + 1, len(ROWS) - 1)] - ROWS[below])
    return COLUMNS[int(box.column)], y


def side(what: str, where: str, offset: float = 0) -> tuple[float, float]:
    """The middle of one side of a box, moved along that side [px]."""
    x, y = place(next(box for box in BOXES + AGENTS if box.what == what))
    width, height = BOX
    return {
        "left": (x, y + height / 2 + offset),
        "right": (x + width, y + height / 2 + offset),
        "top": (x + width / 2 + offset, y),
        "bottom": (x + width / 2 + offset, y + height),
    }[where]


def straight(start: str, end: str, label: str = "", offset: float = 0) -> Arrow:
    """An arrow between the facing sides of two boxes in a row."""
    ahead = side(start, "left") < side(end, "left")
    a = side(start, "right" if ahead else "left", offset)
    b = side(end, "left" if ahead else "right", offset)
    return Arrow((a, b), label, ((a[0] + b[0]) / 2, a[1] - 6 if offset <= 0 else a[1] + 16))


def arrows() -> list[Arrow]:
    flow = "song", "score", "arrangement", "fingers", "goals"
    found = [straight(first, second) for first, second in pairwise(flow)]
    found += [straight("episode", "performance"), straight("performance", "page, sound")]
    found += [
        Arrow((side("hand", "right"), side("scene", "left", -10))),
        Arrow((side("keyboard", "right"), side("scene", "left", 10))),
        straight("scene", "simulation"),
        straight("simulation", "task", "state", -12),
        straight("task", "simulation", "ctrl", 12),
        straight("task", "agent", "view", -12),
        straight("agent", "task", "action", 12),
        Arrow((side("task", "bottom"), side("episode", "top"))),
    ]
    x, y = side("hand", "top")
    to = side("fingers", "bottom", -20)
    found.append(Arrow(((x, y), (x, 134), (to[0], 134), to), "reach", (x + 24, 128)))
    (x, y), to = side("task", "bottom", 44), side("learner", "top", -32)
    found.append(Arrow(((x, y), (x, 330), (to[0], 330), to), "transitions", (x + 60, 324)))
    a, b = side("learner", "top", 16), side("agent", "bottom", 16)
    found.append(Arrow((a, b), "policy", (a[0] + 24, (a[1] + b[1]) / 2 + 4)))
    (x, y), to = side("goals", "bottom"), side("task", "top", 40)
    found.append(Arrow(((x, y), (x, 148), (to[0], 148), to)))
    (x, y), to = side("episode", "bottom", 40), side("episodes", "top", -40)
    found.append(Arrow(((x, y), (x, 444), (to[0], 444), to)))
    found.append(Arrow((side("episodes", "top"), side("learner", "bottom"))))
    (x, y), to = side("performance", "bottom"), side("results", "bottom")
    found.append(Arrow(((x, y), (x, 450), (to[0], 450), to), "many runs", (x - 191, 445)))
    (x, y), to = side("performance", "bottom", 44), side("live page", "left")
    found.append(Arrow(((x, y), (x, to[1]), to), "steps", (x + 40, to[1] - 6)))
    found += [straight("nominal plan", "search"), straight("search", "practice")]
    (x, y), to = side("nominal plan", "bottom"), side("generalist", "bottom")
    return [*found, Arrow(((x, y), (x, y + 16), (to[0], y + 16), to))]


def drawn() -> str:
    """The picture as SVG."""
    (left, top), (width, height) = place(AGENTS[0]), BOX
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img">',
        "<title>How data flows through Cadenza</title>",
        f"<style>{STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7"'
        ' markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" fill="#4a5a6a"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{HEIGHT}" rx="8" fill="#ffffff"/>',
        f'<rect class="inside" x="{left - 12:g}" y="{top - 14:g}"'
        f' width="{COLUMNS[-1] + width - left + 24:g}" height="{height + 42:g}" rx="12"/>',
        f'<text class="folder" x="{left + 24:g}" y="{top - 21:g}">agents/</text>',
    ]
    for arrow in arrows():
        path = "M" + " L".join(f"{x:g} {y:g}" for x, y in arrow.points)
        lines.append(f'<path class="arrow" d="{path}"/>')
        if arrow.label:
            x, y = arrow.at
            lines.append(f'<text class="label" x="{x:g}" y="{y:g}">{escape(arrow.label)}</text>')
    for box in BOXES + AGENTS:
        (x, y), (width, height) = place(box), BOX
        middle = x + width / 2
        lines += [
            f'<rect class="box {box.kind}" x="{x:g}" y="{y:g}" width="{width}" height="{height}"'
            ' rx="8"/>',
            f'<text class="what" x="{middle:g}" y="{y + 29:g}">{escape(box.what)}</text>',
            f'<text class="folder" x="{middle:g}" y="{y + 50:g}">{escape(box.folder)}</text>',
        ]
    for column, (kind, about) in enumerate(LEGEND):
        x, y = COLUMNS[column], HEIGHT - 32
        lines.append(f'<rect class="box {kind}" x="{x}" y="{y}" width="20" height="14" rx="3"/>')
        lines.append(f'<text class="legend" x="{x + 28}" y="{y + 12}">{about}</text>')
    return "\n".join([*lines, "</svg>", ""])


if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0]).parse_args()
    PICTURE.write_text(drawn(), encoding="utf-8")
