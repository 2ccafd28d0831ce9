"""How `make docs` builds the site: the pages of this folder, and the reference from docstrings."""

from __future__ import annotations

import json
import re
from html import escape
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring

import cadenza

REPOSITORY = "https://github.com/cadenza-piano/cadenza"
README = Path(__file__).parents[1] / "README.md"
GALLERY = "gallery"  # folder of the site
PICTURE = r"!\[Two robot hands.*\n\n\*The hands play.*"  # and what is written below it

project = "Cadenza"
author = "The Cadenza authors"
project_copyright = "The Cadenza authors, Apache-2.0"
version = release = cadenza.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["curves"]

myst_heading_anchors = 3
smartquotes_action = "De"  # dashes, but quotation marks as they are written
default_role = "py:obj"  # a name in backticks leads to what is written about it
autoclass_content = "both"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_type_aliases = {name: name for name in ("Array", "Mask", "NDArray", "RewardTerm")}
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 80
python_use_unqualified_type_names = True

NAPOLEON = Config(napoleon_use_ivar=True)  # what "Attributes:" lists has no entries of its own

html_theme = "sphinx_book_theme"
html_title = "Cadenza"
html_static_path = ["static"]
html_css_files = ["gallery.css"]
html_theme_options = {
    "repository_url": REPOSITORY,
    "path_to_docs": "docs",
    "use_download_button": False,
    "use_fullscreen_button": False,
    "show_toc_level": 2,
    "navbar_persistent": [],
}


def read(app: Sphinx, page: str, source: list[str]) -> None:
    """The front page is the README; links to files outside this folder lead to the repository."""
    text, out = source[0], "../" * (page.count("/") + 1)
    if page == "index":
        readme, listed = README.read_text("utf-8"), app.outdir / GALLERY / "gallery.json"
        if listed.exists():  # what `gallery.py` has played takes the place of the picture
            played = gallery(json.loads(listed.read_text("utf-8")), listed.parent)
            readme = re.sub(PICTURE, lambda _: played, readme, count=1)
        text = re.sub(r"\]\((?!\w+:|#|docs/)", "](../", readme) + text
        text = text.replace("](docs/", "](")
    text = text.replace(f"]({out}README.md)", "](/index.md)")
    text = text.replace(f"]({out}", f"]({REPOSITORY}/blob/main/")
    source[0] = re.sub(r"\]\((\w+/)\)", rf"]({REPOSITORY}/tree/main/docs/\1)", text)


def gallery(listed: list[dict[str, Any]], folder: Path) -> str:
    """Returns the first of what `gallery.py` has played, which plays here, and the others."""
    first, *others = listed
    cards = "".join(card(each, folder) for each in others)
    film = f" There is {film_of(first, folder, 'a film')}, too." * has_film(first, folder)
    return f"""```{{raw}} html
<iframe class="plays" src="{GALLERY}/{first["name"]}.html" title="{about(first)}"></iframe>
<p>{escape(first["who"])}, plays {about(first)}: {escape(first["verdict"])} Drag to turn the
picture, or scroll in it for more about the performance.{film} Others play, too:</p>
<div class="plays">{cards}</div>
```"""


def card(played: dict[str, Any], folder: Path) -> str:
    """Returns the picture of a performance, with what it is, which leads to its page."""
    page, in_time = f"{GALLERY}/{played['name']}.html", played["verdict"].split(" (")[0]
    picture = f'<img src="{page[:-5]}.webp" alt="">' * played["picture"]
    words = f"<b>{about(played)}</b><span>{escape(played['who'])}</span><span>{in_time}</span>"
    return f'<div><a href="{page}">{picture}{words}</a>{film_of(played, folder, "Film")}</div>'


def has_film(played: dict[str, Any], folder: Path) -> bool:
    """Whether `gallery.py films` has made a film of a performance."""
    return (folder / f"{played['name']}.mp4").exists()


def film_of(played: dict[str, Any], folder: Path, words: str) -> str:
    """Returns what leads to the film of a performance; nothing where there is none."""
    return f'<a href="{GALLERY}/{played["name"]}.mp4">{words}</a>' * has_film(played, folder)


def about(played: dict[str, Any]) -> str:
    """Returns what was played."""
    return escape(f"{played['song']} ({played['composer']})")


def parse(app: Sphinx, what: str, name: str, of: object, options: object, lines: list[str]) -> None:
    """Docstrings are in Google's style, but for those of fields, which have no sections."""
    lines[:] = [re.sub(r"(?<!\S)--[a-z][a-z-]*", r"``\g<0>``", line) for line in lines]
    if what not in ("attribute", "property"):
        lines[:] = GoogleDocstring(lines, NAPOLEON, app, what, name, of, options).lines()


def sign(*event: Any) -> tuple[str | None, str | None]:
    """Defaults that are made anew are written as `...`, which Python can read."""
    signature, result = event[-2:]
    return signature and signature.replace("<factory>", "..."), result


def setup(app: Sphinx) -> None:
    app.connect("env-get-outdated", lambda *_: ["index"])  # it holds README and what has films
    app.connect("source-read", read)
    app.connect("autodoc-process-docstring", parse)
    app.connect("autodoc-process-signature", sign)
