"""Pages as HTML files that need neither a network nor a server, made from the files in `templates`.

A page holds its style sheets, its scripts, the libraries that these use, and the data. The
libraries are three.js for 3D (cut down to 570 kB), Mediabunny for films (230 kB) and uPlot for
charts (50 kB), and lie as copies in `assets` because no Python package carries ones that serve:
trimesh has three.js of 2022, meshcat, viser, pythreejs and k3d bring a web server or Jupyter,
plotly, bokeh and altair bring megabytes.
"""

from __future__ import annotations

import base64
import re
import zlib
from collections.abc import Iterator
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadenza.cameras import VIEWS
from cadenza.files import write_atomically

if TYPE_CHECKING:
    from jinja2 import Environment

_SEPARATORS = r"[/\\_,=]|\.(?=[^\W\d])"  # a line may be broken after each; not within 1.5


PLAYING = (
    *("elements.js", "recording.js", "rows.js", "flat.js", "falling.js", "camera.js"),
    *("software.js", "stage.js", "chart.js", "arrangement.js", "explanations.js", "roll.js"),
    *("controls.js", "score.js"),
)
"""Scripts of the pages that play, the report and the studio's."""
COMPACT: dict[str, Any] = {"separators": (",", ":"), "allow_nan": False}
"""Arguments of `json.dumps` for the data in a page."""


@cache
def asset(name: str) -> str:
    """The text of a file of `assets`, which templates do not escape."""
    from markupsafe import Markup

    return Markup(resources.files("cadenza.report").joinpath("assets", name).read_text("utf-8"))


@cache
def packed_asset(name: str) -> str:
    """A file of `assets` as `packed_text`, which takes a third of the space."""
    return packed_text(asset(name))


def packed_text(text: str) -> str:
    """A text as base64 of its deflated UTF-8, which `recording.js` reads."""
    return in_base64(zlib.compress(text.encode(), zlib.Z_BEST_COMPRESSION))


def render(template: str, **context: Any) -> Iterator[str]:
    """Yield the text of a page piece by piece, from a file of `templates`; each asset is a piece.

    Text among the values and functions of the `context` is escaped.
    """
    return _environment().get_template(template).generate(context)


def rendered(source: str) -> str:
    """The page of a template in `source`, which may use the files of `templates`."""
    return _environment().from_string(source).render()


def write_page(path: Path, pieces: Iterator[str]) -> None:
    """Write a page to `path`; letters that are no text, as in names of files, become ?."""
    with write_atomically(path) as file:
        for piece in pieces:
            file.write(piece.encode("utf-8", "replace"))


@cache
def _environment() -> Environment:
    # Importing it takes a tenth of a second, and would delay the first action.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("cadenza.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = COMPACT
    environment.globals |= {"asset": asset, "packed_asset": packed_asset, "cameras": VIEWS}
    environment.filters |= {
        "base64": in_base64,
        "packed": packed_text,
        "breakable": _breakable,
        "percent": lambda share: f"{100 * min(max(share, 0.0), 1.0):.1f}%",
    }
    return environment


def in_base64(content: bytes) -> str:
    """The base64 text of `content`."""
    return base64.b64encode(content).decode()


def _breakable(text: str) -> str:
    """Return `text` that a narrow screen breaks after separators rather than within words."""
    from markupsafe import Markup, escape

    return Markup(re.sub(_SEPARATORS, r"\g<0><wbr>", str(escape(text))))
