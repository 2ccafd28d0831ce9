"""What other installed packages add by entry points, and what is wrong with some of them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import cadenza
from cadenza.agents.registry import AGENTS
from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.music.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.registry import Entry, Registry

TUNE = Score((Note(0.0, 0.2, 60), Note(0.2, 0.4, 64)))
AGENT = """
import numpy as np

class Still:
    def reset(self, env_ids, rngs):
        pass
    def act(self, view):
        return np.zeros((len(view.env_ids), view.task.action_size))

still = Still()
"""
Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Puts a package with a module and entry points where Python finds it."""
    installed = []

    def install(name: str, code: str, entry_points: str) -> Path:
        folder = tmp_path / f"site of {name}"
        about = folder / f"{name}-1.0.dist-info"
        about.mkdir(parents=True)
        (folder / f"{name}.py").write_text(code)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(entry_points)
        monkeypatch.syspath_prepend(folder)
        installed.append(name)
        return folder

    yield install
    for name in installed:
        sys.modules.pop(name, None)


def test_an_agent_of_another_package_plays(
    install: Install, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    install("quiet", AGENT, "[cadenza.agents]\nstill = quiet:Still\n")
    write_midi(TUNE, tmp_path / "tune.mid")
    tune, out = str(tmp_path / "tune.mid"), tmp_path / "out"
    main(["play", tune, "--agent", "still", "--no-video", "-o", str(out)])
    assert json.loads((out / "settings.json").read_text())["agent"] == "still"
    capsys.readouterr()
    main(["info"])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "agent still" in line]
    assert line.split(maxsplit=2)[2] == "from the package quiet"


@pytest.mark.parametrize(
    ("code", "entry", "said"),
    [
        (
            "import nowhere",
            "still = loud:Still",
            "agent still (from the package loud): cannot import 'loud': ModuleNotFoundError: ",
        ),
        (
            AGENT,
            "still = loud:Moving",
            "agent still (from the package loud): there is no 'Moving' in loud",
        ),
        (AGENT, "still = loud", "agent still (from the package loud): there is no '' in loud"),
        (
            AGENT,
            "still = loud:still",
            "agent still (from the package loud): loud:still is of type Still; give a class",
        ),
        (AGENT, "stil = loud:Still", "no agent 'still': did you mean stil? choose from planner, "),
    ],
)
def test_a_broken_package_is_named_and_harms_nobody_else(
    code: str, entry: str, said: str, install: Install
) -> None:
    install("loud", code, f"[cadenza.agents]\n{entry}\n")
    with pytest.raises(CadenzaError) as error:
        cadenza.make_agent("still")
    assert str(error.value).startswith(said)
    cadenza.make_agent("zero")
    assert entry.split()[0] in AGENTS.entries()


def test_broken_metadata_harms_nobody(install: Install) -> None:
    install("loud", AGENT, "[cadenza.agents]\nnonsense\n")
    install("quiet", AGENT, "[cadenza.agents]\nstill = quiet:Still\n")
    assert type(cadenza.make_agent("still")).__module__ == "quiet"


def test_a_name_of_two_packages_is_of_neither(install: Install) -> None:
    install("loud", AGENT, "[cadenza.agents]\nstill = loud:Still\nzero = loud:Still\n")
    install("quiet", AGENT, "[cadenza.agents]\nstill = quiet:Still\n")
    with pytest.raises(CadenzaError, match=r"have this name; give (quiet|loud):Still or"):
        cadenza.make_agent("still")
    assert type(cadenza.make_agent("quiet:Still")).__module__ == "quiet"
    assert type(cadenza.make_agent("zero")).__module__ == "cadenza.agents.agent"


def test_what_a_registry_gives_is_of_the_kind_asked_for(install: Install) -> None:
    install(
        "numbers_of", "ONE = 1\nclass Of:\n    two = 2\n", "[cadenza.tests]\none = numbers_of:ONE"
    )
    numbers = Registry("number", "cadenza.tests", {"two": Entry("numbers_of:Of.two", "a number")})
    assert (numbers.load("one", int), numbers.load("two", int)) == (1, 2)
    assert numbers.load("numbers_of:ONE", int) == 1
    assert list(numbers.entries()) == ["two", "one"]
    with pytest.raises(CadenzaError, match=r"number two: .* is of type int; give a str"):
        numbers.load("two", str)
    with pytest.raises(CadenzaError, match=r"no number 'three': choose from two, one, or give "):
        numbers.load("three", int)


# Songs

SONGS = """
from pathlib import Path

def songs():
    return Path(__file__).parent / "songs"

nowhere = "nowhere"
"""


def test_songs_of_another_package(install: Install, capsys: pytest.CaptureFixture[str]) -> None:
    folder = install("notes", SONGS, "[cadenza.songs]\nown = notes:songs\nlost = notes:nowhere\n")
    (folder / "songs").mkdir()
    write_midi(TUNE, folder / "songs" / "Tune.mid")
    write_midi(TUNE, folder / "songs" / "No. 2.mid")
    for name in ("own/Tune", "own/tune", "own/No. 2"):
        assert len(cadenza.load_song(name).notes) == 2
    with pytest.raises(CadenzaError, match="no song named 'own/tun': did you mean own/Tune"):
        cadenza.load_song("own/tun")
    with pytest.raises(CadenzaError, match="song library lost: 'nowhere' is not a folder"):
        cadenza.load_song("lost/Tune")
    with pytest.raises(CadenzaError, match="no song named 'other/Tune'"):
        cadenza.load_song("other/Tune")
    main(["songs"])
    said = capsys.readouterr()
    assert [line.split("  ")[0] for line in said.out.splitlines()][-2:] == ["own/No. 2", "own/Tune"]
    assert said.err == "song library lost: 'nowhere' is not a folder\n"
