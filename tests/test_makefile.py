"""What people type first: make."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
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
    (installed / "installed").touch()
    named = re.findall(r"\btests/\S+", make("--dry-run", "smoke", f"VENV={installed}"))
    assert len(named) > 20
    assert [name for name in named if not (ROOT / name).exists()] == []
