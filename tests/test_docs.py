"""The documentation: what it lists, and that the site is built and its links lead somewhere."""

import inspect
import re
import runpy
import subprocess
import sys
from contextlib import closing
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import cadenza
from cadenza import PianoEnv
from test_layering import STANDS_ON

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


def test_every_page_is_in_the_contents():
    listed = re.findall(r"^([\w/-]+)$", (DOCS / "index.md").read_text(), re.MULTILINE)
    pages = [str(page.relative_to(DOCS).with_suffix("")) for page in PAGES]
    assert sorted([*listed, "index"]) == sorted(pages)


def test_the_python_files_that_pages_name_exist():
    places = ("src", "tests", "tools", "benchmarks", "examples", "docs")
    files = {
        f"/{path.relative_to(ROOT)}" for folder in places for path in (ROOT / folder).rglob("*.py")
    }
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS.glob("*.md")]:
        for name in re.findall(r"[\s`(]((?:\w+/)*\w+\.py)\b", page.read_text()):
            assert any(file.endswith(f"/{name}") for file in files), (page.name, name)


def test_the_page_of_the_task_has_the_sizes_of_the_environments():
    text = (DOCS / "task.md").read_text()
    parts = dict(re.findall(r"^\| `(\w+)` \| (\d+) \|", text, re.MULTILINE))
    with closing(PianoEnv("OdeToJoy")) as env:
        layout = env.observation_layout
        assert {name: int(size) for name, size in parts.items()} == {
            name: part.stop - part.start for name, part in layout.items()
        }
        sizes = env.observation_space.shape[0], env.action_space.shape[0]
    assert f"a vector of {sizes[0]:,} numbers" in text
    assert f"An action has {sizes[1]} numbers" in text


def test_every_public_name_is_in_the_reference():
    text = (DOCS / "reference.md").read_text()
    assert sorted(re.findall(r"^\.\. auto\w+:: (\w+)", text, re.MULTILINE)) == cadenza.__all__


def test_the_architecture_lists_all_folders_and_what_they_stand_on():
    rows = re.findall(
        r"^\| `(\w+)/` \| .* \| (.*)\|$", (DOCS / "architecture.md").read_text(), re.MULTILINE
    )
    assert {folder: set(re.findall(r"\w+", below)) for folder, below in rows} == STANDS_ON


def test_the_picture_of_the_architecture_is_as_it_is_drawn():
    picture = runpy.run_path(str(ROOT / "tools" / "draw_architecture.py"))
    assert picture["PICTURE"].read_text() == picture["drawn"]()
    named = {box.folder.rstrip("/") for box in picture["BOXES"] if box.folder.endswith("/")}
    assert named == STANDS_ON.keys() - {"cli"}


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.stem)
def test_tables_are_as_the_results_have_them(page):
    text = page.read_text()
    tables = runpy.run_path(str(ROOT / "tools" / "write_tables.py"))
    assert text.count("<!-- table: ") == len(tables["MARKED"].findall(text))
    assert text == tables["written"](text), "make tables writes them anew"


@pytest.mark.parametrize("name", cadenza.__all__)
def test_every_public_name_says_what_it_is(name):
    value = getattr(cadenza, name)
    assert value.__doc__
    assert not value.__doc__.startswith(f"{name}(")  # what dataclass would write
    if inspect.isclass(value):
        for member, of in vars(value).items():
            if not member.startswith("_") and (inspect.isfunction(of) or isinstance(of, property)):
                assert inspect.getdoc(getattr(value, member)), f"{name}.{member}"


class Links(HTMLParser):
    """The ids of a page, and where its links lead."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.targets: set[str] = set()
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.add(value or "")
            elif name in ("href", "src"):
                self.targets.add(value or "")


@pytest.mark.slow
def test_the_site_plays_is_built_without_warnings_and_its_links_lead_somewhere(tmp_path):
    subprocess.run([sys.executable, DOCS / "gallery.py", tmp_path / "gallery"], check=True)
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--quiet", DOCS, tmp_path]
    built = subprocess.run(command, capture_output=True, text=True)
    assert (built.returncode, built.stderr) == (0, "")
    played = set((tmp_path / "gallery").glob("*.html"))
    assert len(played) == 4 + len(list((DOCS / "practised").iterdir()))
    longest = 26.1  # [s], Jingle Bells
    assert all(page.stat().st_size < 600_000 + 30_000 * longest for page in played)
    shown = {(tmp_path / target).resolve() for target in Links(tmp_path / "index.html").targets}
    assert played <= shown
    written = (page for page in tmp_path.rglob("*.html") if "_static" not in page.parts)
    pages = {page: Links(page) for page in written}
    assert {tmp_path / page.relative_to(DOCS).with_suffix(".html") for page in PAGES} <= set(pages)
    for page, links in pages.items():
        for target in map(urlsplit, links.targets):
            if target.scheme:
                continue
            path = (page.parent / unquote(target.path)).resolve() if target.path else page
            assert path.exists(), (page, target)
            if target.fragment and path in pages:
                assert target.fragment in pages[path].ids, (page, target)
    for name in cadenza.__all__:
        assert f"cadenza.{name}" in pages[tmp_path / "reference.html"].ids
