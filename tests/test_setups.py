"""Setups: several options by one name, over which those win that are given beside it."""

from pathlib import Path

import gymnasium
import pytest

import cadenza
from cadenza.cli import main
from cadenza.files import read_json
from cadenza.music.score import Note, Score
from cadenza.tasks.setups import NamedSetup

TWO_NOTES = Score((Note(0.0, 0.2, 60), Note(0.3, 0.5, 64)), title="Two notes")
RIGHT_HAND = NamedSetup({"hand": "allegro", "hands": "right", "forearm_dofs": ("tx",)}, "zero")


def test_no_such_setup():
    with pytest.raises(cadenza.CadenzaError, match="did you mean allegro"):
        cadenza.play(TWO_NOTES, setup="alegro")


def test_a_setup_has_no_other_options_than_scenes_and_tasks():
    with pytest.raises(cadenza.CadenzaError, match="no option 'knees'"):
        NamedSetup({"hands": "both", "knees": 2})


def settings(*words: str) -> dict[str, object]:
    main(["play", "CMajorScaleOneHand", "-o", "played", "--no-video", "-q", *words])
    return read_json(Path("played/settings.json"), dict[str, object])


def test_on_the_command_line(tmp_path, monkeypatch):
    """Whether it stands before other options or after them."""
    monkeypatch.chdir(tmp_path)
    setup = f"{__name__}:RIGHT_HAND"
    chosen = settings("--setup", setup)
    assert chosen["agent"] == "zero"
    assert chosen["scene"]["hand"] == "allegro"  # type: ignore[index]
    assert chosen["scene"]["forearm_dofs"] == ["tx"]  # type: ignore[index]
    chosen = settings("--hands", "left", "--all-notes", f"--setup={setup}", "--agent", "random")
    assert chosen["agent"] == "random"
    assert chosen["scene"]["hands"] == "left"  # type: ignore[index]
    assert chosen["scene"]["hand"] == "allegro"  # type: ignore[index]


def test_in_gymnasium():
    env = gymnasium.make("cadenza/Piano-v0", song=TWO_NOTES, setup="allegro", hands="right")
    assert env.unwrapped.task.scene.hand.name == "allegro"  # type: ignore[attr-defined]
    assert env.unwrapped.task.scene.sides == ("right",)  # type: ignore[attr-defined]
    env.close()


def test_in_python():
    task = cadenza.TaskConfig(energy_coefficient=0.0)
    performance = cadenza.play(TWO_NOTES, setup=f"{__name__}:RIGHT_HAND", task=task)
    assert performance.settings["agent"] == "zero"
    assert performance.settings["scene"]["hands"] == "right"
    assert performance.settings["task"]["energy_coefficient"] == 0.0
    with pytest.raises(cadenza.CadenzaError, match="give a setup or a scene"):
        cadenza.play(TWO_NOTES, setup="allegro", scene=cadenza.SceneConfig())
