"""What of a release can be checked at any time; `make release-check` has the rest."""

import re
import runpy
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CHECK = runpy.run_path(str(ROOT / "tools" / "release_check.py"))
SIZE = 1000  # bytes


def test_package_citation_and_changelog_tell_one_version():
    CHECK["versions"]()


def test_all_links_lead_somewhere():
    CHECK["links"]()


def test_a_link_that_leads_nowhere_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# A page (of *two*)\n[a](#a-page-of-two) [b](#gone) [c](gone.md) [d](page.md#gone)\n"
        "[e](https://example.com/#x) [f](htps://example.com) `[g](gone)` [h](page.md)\n"
    )
    assert list(CHECK["broken_links"](page)) == [
        "#gone",
        "gone.md",
        "page.md#gone",
        "htps://example.com",
    ]


@pytest.fixture
def wheel():
    """Names of all files of a good wheel, and their sizes [bytes]."""
    tracked = CHECK["output"]("git", "ls-files", "src").splitlines()
    about = f"cadenza-{CHECK['version']()}.dist-info"
    names = [name.removeprefix("src/") for name in tracked]
    names += [f"{about}/METADATA", *(f"{about}/licenses/{name}" for name in CHECK["LICENCES"])]
    return dict.fromkeys(names, SIZE)


def test_a_wheel_has_the_package_and_the_licences_only(wheel):
    problems = CHECK["problems_of_wheel"]
    assert list(problems(wheel)) == []
    for name in ("tests/test_a.py", "cadenza/__pycache__/a.pyc", "cadenza/tests/a.py"):
        assert [said for said in problems(wheel | {name: SIZE}) if name in said], name
    assert list(problems(wheel | {"cadenza/music.npz": 3 * 2**20})) == [
        "cadenza/music.npz takes 3,145,728 bytes"
    ]
    for name in ("cadenza/py.typed", *(name for name in wheel if "LICENSE" in name)):
        less = {other: size for other, size in wheel.items() if other != name}
        assert [said for said in problems(less) if said.endswith("is missing")], name


def test_the_image_is_made_of_files_that_docker_is_shown():
    image = (ROOT / "Dockerfile").read_text()
    shown = re.findall(r"^!(.+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE)
    assert sorted(re.findall(r"/context/(\S+)", image)) == sorted(shown)
    (python,) = re.findall(r"^FROM python:([\d.]+)-slim$", image, re.MULTILINE)
    assert python in CHECK["PYTHONS"]
    last = re.findall(r"^(USER|ENTRYPOINT) (.+)$", image, re.MULTILINE)
    assert last == [("USER", "nobody"), ("ENTRYPOINT", '["cadenza"]')]


def test_the_image_is_built_as_documented():
    commands = (ROOT / "docs" / "installing.md").read_text() + (ROOT / ".ci" / "run").read_text()
    for command in ("docker build --tag cadenza .", "docker run --rm "):
        assert commands.count(command) == 2, command


def test_every_extra_is_documented():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    page = (ROOT / "docs" / "installing.md").read_text()
    listed = re.findall(r"^\| `([\w-]+)` \|", page, re.MULTILINE)
    assert sorted(listed) == sorted(project["optional-dependencies"])


def test_the_licences_of_all_that_is_installed_are_listed():
    page = (ROOT / "docs" / "licences.md").read_text()
    rows = re.findall(r"^\| [^|]+ \| (.+) \|$", page, re.MULTILINE)
    listed = {canonical(name) for row in rows for name in row.split(", ")}
    lock = (ROOT / "requirements-dev.lock").read_text()
    pinned = {canonical(name) for name in re.findall(r"^([\w.-]+)==[^;\n]+$", lock, re.MULTILINE)}
    assert len(pinned) > 100
    assert pinned - listed <= {"wcwidth"}  # pip-licenses does not list what it needs itself


def canonical(name: str) -> str:
    """The name of a package as lock files write it."""
    return re.sub(r"[-_.]+", "-", name).lower()
