"""What of a release can be checked at any time, and what people type to install it."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cadenza import installing
from cadenza.installing import install_line

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
        assert [message for message in problems(wheel | {name: SIZE}) if name in message], name
    assert list(problems(wheel | {"cadenza/music.npz": 3 * 2**20})) == [
        "cadenza/music.npz takes 3,145,728 bytes"
    ]
    for name in ("cadenza/py.typed", *(name for name in wheel if "LICENSE" in name)):
        less = {other: size for other, size in wheel.items() if other != name}
        assert [message for message in problems(less) if message.endswith("is missing")], name


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


SONGS = (
    "song.mid",
    "my song.mid",
    "a  (live) [take 2] {x}.mid",
    "it's.mid",
    'the "best" one.mid',
    "5$ and $HOME $(id) `id`.mid",
    "a;b|c&d>e*?#!\\.mid",
    "-v.mid",
    "Für Elise, № 1.mid",
)


@pytest.fixture
def installed(tmp_path):
    """A virtual environment, as make takes it, in which `cadenza` prints its arguments."""
    if shutil.which("make") is None:
        pytest.skip("there is no make")
    stub = tmp_path / "bin" / "cadenza"
    stub.parent.mkdir()
    stub.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    stub.chmod(0o755)
    (tmp_path / "plays").touch()
    return tmp_path


def make(*arguments: str, **environment: str) -> str:
    env = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    command = ["make", "--silent", "--no-print-directory", "-C", str(ROOT), *arguments]
    done = subprocess.run(command, env=env | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("song", SONGS)
def test_a_song_may_have_any_name(installed, song):
    there = f"VENV={installed}"
    assert make("play", there, f"SONG={song}").splitlines() == ["play", "--", song]
    assert make("play", there, SONG=song).splitlines() == ["play", "--", song]
    assert f"SONG={song}," in make("help", f"SONG={song}")


def test_a_song_is_played_if_none_is_named(installed):
    *_, song = make("play", f"VENV={installed}").split()
    assert song == "TwinkleTwinkleLittleStar"


def pins(name: str) -> dict[str, str]:
    lines = re.findall(r"^([\w.-]+)==(.+)$", (ROOT / name).read_text(), re.MULTILINE)
    versions: dict[str, str] = {}
    for package, version in lines:  # a package may have one for each Python
        versions[package] = versions.get(package, "") + version
    return versions


def test_playing_installs_little_and_the_lock_files_agree():
    playing, everything = pins("requirements.lock"), pins("requirements-dev.lock")
    assert playing.items() <= everything.items()
    assert {"mujoco", "gymnasium", "starlette", "uvicorn"} <= playing.keys()
    assert not {"jax", "jaxlib", "flax", "pyarrow", "sphinx", "mypy"} & playing.keys()


def test_the_quick_tests_are_there(installed):
    (installed / "smokes").touch()
    named = re.findall(r"\btests/\S+", make("--dry-run", "smoke", f"VENV={installed}"))
    assert len(named) > 20
    assert [name for name in named if not (ROOT / name).exists()] == []


CLONE = {"url": "file:///home/me/my%20clone", "dir_info": {"editable": True}}
GIT = {"url": "https://host/cadenza", "vcs_info": {"vcs": "git", "commit_id": "0a1b"}}


def said(
    monkeypatch: pytest.MonkeyPatch,
    origin: dict[str, Any] | None,
    extra: str,
    installer: str = "pip",
) -> str:
    texts = {"INSTALLER": installer, "direct_url.json": origin and json.dumps(origin)}
    distribution = SimpleNamespace(read_text=texts.get)
    monkeypatch.setattr(installing, "distribution", lambda _: distribution)
    return install_line(extra)


@pytest.mark.parametrize(
    ("origin", "line"),
    [
        (None, "pip install 'cadenza[hub]'"),  # of an index
        (
            {"url": "file:///a.whl", "archive_info": {}},
            "pip install 'cadenza[hub] @ file:///a.whl'",
        ),
        ({"url": "file:///clone", "dir_info": {}}, "pip install 'cadenza[hub] @ file:///clone'"),
        (GIT, "pip install 'cadenza[hub] @ git+https://host/cadenza@0a1b'"),
        (CLONE, "pip install --editable '/home/me/my clone[hub]'"),
    ],
)
def test_an_extra_comes_from_where_cadenza_came_from(monkeypatch, origin, line):
    monkeypatch.setattr("shutil.which", lambda _: str(Path(sys.executable).with_name("pip")))
    assert said(monkeypatch, origin, "hub") == line
    monkeypatch.setattr("shutil.which", lambda _: "/usr/bin/pip")  # of another environment
    assert said(monkeypatch, origin, "hub") == line.replace("pip", f"{sys.executable} -m pip")
    uv = line.replace("pip install", f"uv pip install --python {sys.prefix}")
    assert said(monkeypatch, origin, "hub", "uv\n") == uv


def test_in_the_environment_of_a_clone_make_installs(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "prefix", str(tmp_path / ".venv"))
    clone = CLONE | {"url": tmp_path.as_uri()}
    assert said(monkeypatch, clone, "hub") == f"make -C {tmp_path} install"
    monkeypatch.chdir(tmp_path)
    assert said(monkeypatch, clone, "hub") == "make install"
    assert said(monkeypatch, clone, "gpu").endswith(f" --editable '{tmp_path}[gpu]'")


def test_make_installs_all_that_its_line_is_told_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    locked = (ROOT / "requirements-dev.lock").read_text().replace("-", "_").lower()
    for extra, expected in project["optional-dependencies"].items():
        names = [name.split(">=")[0].replace("-", "_").lower() for name in expected]
        there = all(f"\n{name}==" in locked for name in names)
        assert there == (extra not in ("brax", "gpu", "rsl-rl", "wandb")), extra


def test_without_an_installation_the_sources_are_named(monkeypatch):
    def none(_: str) -> None:
        raise PackageNotFoundError

    monkeypatch.setattr(installing, "distribution", none)
    assert install_line("hub").endswith(f" --editable '{ROOT}[hub]'")
