"""Names that other installed packages add by entry points, some of which are broken."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cadenza
from cadenza.agents.registry import AGENTS, PRACTISED, agent_options
from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.registry import Entry, Registry

TUNE = Score((Note(0.0, 0.2, 60), Note(0.2, 0.4, 64)))
AGENT = """
import cadenza
import numpy as np

class Still(cadenza.Agent):
    def reset(self, env_ids, rngs):
        pass
    def act(self, view):
        return np.zeros((len(view.env_ids), view.task.action_size))

still = Still()
"""
Install = Callable[..., Path]
LOUD = "agent still (from the package loud): "  # begins errors


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put a package with a module and entry points where Python finds it."""
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


def test_an_agent_of_another_package_plays(install, tmp_path, capsys):
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
    ("code", "entry", "message"),
    [
        (
            "import nowhere",
            "still = loud:Still",
            f"{LOUD}cannot import 'loud': ModuleNotFound",
        ),
        (AGENT, "still = loud:Moving", f"{LOUD}there is no 'Moving' in loud"),
        (AGENT, "still = loud", f"{LOUD}there is no '' in loud"),
        (AGENT, "still = loud:still", f"{LOUD}loud:still is of type Still; give a class"),
        (AGENT, "stil = loud:Still", "no agent 'still': did you mean stil? choose from planner, "),
    ],
)
def test_a_broken_package_is_named_and_harms_nobody_else(code, entry, message, install):
    install("loud", code, f"[cadenza.agents]\n{entry}\n")
    with pytest.raises(CadenzaError) as error:
        cadenza.make_agent("still")
    assert str(error.value).startswith(message)
    cadenza.make_agent("zero")
    assert entry.split()[0] in AGENTS.entries()


def test_broken_metadata_harms_nobody(install):
    install("loud", AGENT, "[cadenza.agents]\nnonsense\n")
    install("quiet", AGENT, "[cadenza.agents]\nstill = quiet:Still\n")
    assert type(cadenza.make_agent("still")).__module__ == "quiet"


def test_a_name_of_two_packages_is_of_neither(install):
    install("loud", AGENT, "[cadenza.agents]\nstill = loud:Still\nzero = loud:Still\n")
    install("quiet", AGENT, "[cadenza.agents]\nstill = quiet:Still\n")
    with pytest.raises(CadenzaError, match=r"have this name; give (quiet|loud):Still or"):
        cadenza.make_agent("still")
    assert type(cadenza.make_agent("quiet:Still")).__module__ == "quiet"
    assert type(cadenza.make_agent("zero")).__module__ == "cadenza.agents.agent"


def test_what_a_registry_gives_is_of_the_kind_asked_for(install):
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


# Options of agents

BEATING = '''
from __future__ import annotations
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
import numpy as np
import cadenza

@dataclass(frozen=True)
class BeatConfig:
    """Beats time."""
    tempo: float = 60.0
    """Beats per minute."""
    hands: tuple[Literal["left", "right"], ...] = ("left", "right")
    most: int | None = None
    loud: bool = False

class SlowBeat(cadenza.Agent):
    def __init__(self, config: BeatConfig | None = None):
        self._tempo = (config or BeatConfig()).tempo
        if self._tempo <= 0:
            raise ValueError("tempo: more than 0")

    def act(self, view):
        low, high = view.task.action_low, view.task.action_high
        return np.tile(low + self._tempo / 1000 * (high - low), (len(view.env_ids), 1))

class Seed(SlowBeat):
    pass

@dataclass(frozen=True)
class Needed:
    tempo: float

class NeedsMore(SlowBeat):
    def __init__(self, config: Needed): ...

@dataclass(frozen=True)
class Unplain:
    where: Path = Path()

class NotPlain(SlowBeat):
    def __init__(self, config: Unplain): ...

class Unknown(SlowBeat):
    def __init__(self, config: Nowhere): ...

class OfItsOwn(SlowBeat):
    def __init__(self, config={"tempo": 3}):
        super().__init__()
'''


@pytest.fixture
def beating(install, tmp_path, monkeypatch):
    install("beating", BEATING, "[cadenza.agents]\nslow-beat = beating:SlowBeat\n")
    write_midi(TUNE, tmp_path / "tune.mid")
    monkeypatch.chdir(tmp_path)


def play(*words: str) -> None:
    main(["play", "tune.mid", *words, "--no-video", "-o", "out"])


def result(name: str) -> Any:
    return json.loads(Path("out", name).read_text())


def action_share(episode: cadenza.Episode) -> np.ndarray:
    """The place of each action in the range of its actuator."""
    low, high = episode["action_min"], episode["action_max"]
    return (episode["action"] - low) / (high - low)


@pytest.mark.usefixtures("beating")
@pytest.mark.parametrize("agent", ["slow-beat", "beating:SlowBeat"])
def test_an_agent_of_another_package_has_options(agent, capsys):
    with pytest.raises(SystemExit):
        play("--agent", agent, "--help")
    output = " ".join(capsys.readouterr().out.replace("│", "").split())
    assert "Beats time." in output
    assert "--slow-beat.tempo FLOAT Beats per minute. (default: 60.0)" in output
    options = ["--slow-beat.tempo", "90", "--slow-beat.hands", "left", "--slow-beat.loud"]
    play(f"--agent={agent}", *options)
    config = {"tempo": 90.0, "hands": ["left"], "most": None, "loud": True}
    assert result("settings.json")["slow_beat"] == config
    share = action_share(cadenza.load_episode(Path("out/episode.npz")))
    np.testing.assert_allclose(share, 0.09, atol=1e-6)


@pytest.mark.usefixtures("beating")
def test_options_of_another_package_in_python():
    from beating import BeatConfig  # type: ignore[import-not-found]

    agent = cadenza.make_agent("slow-beat", BeatConfig(tempo=np.int64(90)))
    np.testing.assert_allclose(action_share(cadenza.play(TUNE, agent).episode), 0.09, atol=1e-6)
    assert cadenza.play(TUNE, "slow-beat").settings["slow_beat"]["tempo"] == 60
    with pytest.raises(CadenzaError, match="tempo 'x': give a number"):
        cadenza.make_agent("slow-beat", BeatConfig(tempo="x"))
    with pytest.raises(CadenzaError, match="3: give a BeatConfig"):
        cadenza.make_agent("slow-beat", 3)
    with pytest.raises(CadenzaError, match="has no options"):
        cadenza.make_agent("beating:OfItsOwn", BeatConfig())


@pytest.mark.usefixtures("beating")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("slow-beat --slow-beat.tempo 0", "agent slow-beat: ValueError: tempo: more than 0 ("),
        ("beating:Seed", "agent beating:Seed: its options cannot be called --seed"),
        ("beating:NeedsMore", "tempo of Needed: give it a default"),
        ("beating:NotPlain", "where of Unplain: an option is a bool, int, "),
        ("beating:Unknown", "agent beating:Unknown: NameError: name 'Nowhere' is not defined"),
    ],
)
def test_options_of_agents_that_make_no_sense(words, message, capsys):
    with pytest.raises(SystemExit) as stop:
        play("--agent", *words.split())
    assert stop.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"cadenza: {message}")
    assert not Path("out").exists()


@pytest.mark.usefixtures("beating")
def test_two_agents_with_options_of_one_name(capsys):
    with pytest.raises(SystemExit):
        main(["bench", "--agents", "slow-beat,beating:SlowBeat", "-o", "out"])
    assert "its options cannot be called --slow-beat" in capsys.readouterr().err


def test_the_planner_and_what_was_practised_share_options(tmp_path, capsys):
    (tmp_path / PRACTISED).touch()
    with pytest.raises(SystemExit) as stop:
        main(["bench", "--agents", f"{tmp_path},planner", "--help-all"])
    assert stop.value.code == 0
    assert capsys.readouterr().out.count("--planner.effort") == 1


def test_our_agents_get_their_options_as_those_of_others(monkeypatch):
    """The table has them, too, so that --help need not import the planners."""
    monkeypatch.setattr("cadenza.agents.registry.AGENTS", Registry("agent", "nothing"))
    for name, entry in AGENTS.own.items():
        assert agent_options(entry.place) is entry.config, name


# Songs

SONGS = """
from pathlib import Path

def songs():
    return Path(__file__).parent / "songs"

nowhere = "nowhere"
"""


def test_songs_of_another_package(install, capsys):
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
    output = capsys.readouterr()
    assert [line.split("  ")[0] for line in output.out.splitlines()][-2:] == [
        "own/No. 2",
        "own/Tune",
    ]
    assert output.err == "song library lost: 'nowhere' is not a folder\n"
