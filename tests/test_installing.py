"""The line that installs an extra fits the way in which Cadenza was installed."""

import json
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
CLONE = {"url": "file:///home/me/my%20clone", "dir_info": {"editable": True}}
GIT = {"url": "https://host/cadenza", "vcs_info": {"vcs": "git", "commit_id": "0a1b"}}


def said(
    monkeypatch: pytest.MonkeyPatch,
    origin: dict[str, Any] | None,
    extra: str,
    installer: str = "pip",
) -> str:
    texts = {"INSTALLER": installer, "direct_url.json": origin and json.dumps(origin)}
    found = SimpleNamespace(read_text=texts.get)
    monkeypatch.setattr(installing, "distribution", lambda _: found)
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
    for extra, wanted in project["optional-dependencies"].items():
        names = [name.split(">=")[0].replace("-", "_").lower() for name in wanted]
        there = all(f"\n{name}==" in locked for name in names)
        assert there == (extra not in ("brax", "gpu", "wandb")), extra


def test_without_an_installation_the_sources_are_named(monkeypatch):
    def none(_: str) -> None:
        raise PackageNotFoundError

    monkeypatch.setattr(installing, "distribution", none)
    assert install_line("hub").endswith(f" --editable '{ROOT}[hub]'")
