"""Whatever is given in place of an option, a song or an agent is refused in one line."""

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import cadenza
from cadenza import CadenzaError, Note, SceneConfig, Score, TaskConfig
from cadenza.cli import main
from cadenza.configs import as_config
from cadenza.files import content_of, opened
from cadenza.scene.scene import build_scene

TUNE = Score((Note(0.0, 0.25, 60),), title="A tune")
OPTIONS = [(kind, field.name) for kind in (TaskConfig, SceneConfig) for field in fields(kind)]
NAMES = {"hand", "keyboard"}  # any text may be one


def line(error: pytest.ExceptionInfo[CadenzaError]) -> str:
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(("kind", "name"), OPTIONS)
@pytest.mark.parametrize(
    "value",
    ["x", b"1", object(), np.array([1, 2]), [None]],
    ids=["text", "bytes", "object", "array", "list"],
)
def test_an_option_of_another_type(kind, name, value):
    if name in NAMES and isinstance(value, str):
        pytest.skip("text is what it should be")
    with pytest.raises(CadenzaError) as error:
        as_config(kind(**{name: value}), kind)
    assert line(error).startswith(name)


@pytest.mark.parametrize("name", sorted(NAMES))
def test_a_name_that_nothing_has(name):
    with pytest.raises(CadenzaError) as error:
        build_scene(SceneConfig(**{name: "x"}))
    assert line(error).startswith(f"no {name} 'x'")


def test_options_become_plain_values():
    config = as_config(TaskConfig(stretch=2, transpose=np.int64(3)), TaskConfig)  # type: ignore[arg-type]
    assert config == TaskConfig(stretch=2.0, transpose=3)
    assert [type(config.stretch), type(config.transpose)] == [float, int]
    assert as_config(SceneConfig(forearm_dofs=["tx"]), SceneConfig).forearm_dofs == ("tx",)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "options",
    [
        {"task": 5},
        {"scene": TaskConfig()},
        {"num_envs": "x"},
        {"num_envs": 1.5},
        {"num_envs": 10**9},
        {"num_threads": 10**9},
        {"reward_terms": 5},
        {"reward_terms": {"a": 5}},
        {"song": 5},
        {"song": [b"x"]},
        {"hand_collisions": float("nan")},
    ],
    ids=repr,
)
def test_environments_of_what_they_cannot_be_made_of(options):
    with pytest.raises(CadenzaError) as error:
        gym.make_vec("cadenza/Piano-v0", **{"song": TUNE, "num_envs": 1, **options})
    assert len(line(error)) < 200  # and not all fields of what was given instead


@pytest.mark.parametrize("value", ["text", None, [1, 2], [[1.0]], [float("nan")]], ids=repr)
def test_a_reward_that_is_none(value):
    env = gym.make("cadenza/Piano-v0", song=TUNE, reward_terms={"mine": lambda _: value})
    env.reset(seed=0)
    with pytest.raises(CadenzaError, match="reward term 'mine' returned") as error:
        env.step(env.action_space.sample())
    line(error)


@pytest.mark.parametrize("song", [5, None, b"x", [], {}, 3.5], ids=repr)
def test_what_is_no_song(song):
    for play in (cadenza.load_song, cadenza.play, cadenza.plan):
        with pytest.raises(CadenzaError, match=r"song .*: give|plays any song; name one") as error:
            play(song)
        line(error)


@pytest.mark.parametrize(
    ("agent", "options"),
    [
        (5, {}),
        ([], {}),
        (cadenza.Agent, {}),
        ("zero", {"seed": "x"}),
        ("zero", {"seed": 1.5}),
        ("zero", {"task": {}}),
        ("zero", {"scene": "x"}),
        ("playback", {"plan": 5}),
    ],
    ids=repr,
)
def test_what_nobody_can_play_with(agent, options):
    with pytest.raises(CadenzaError) as error:
        cadenza.play(TUNE, agent, **options)
    line(error)


def test_a_class_in_place_of_an_agent_is_named():
    class Mine(cadenza.Agent):
        def act(self, view: cadenza.View) -> Any:
            raise AssertionError

    with pytest.raises(CadenzaError, match="agent Mine: is a class; give an instance of it"):
        cadenza.play(TUNE, Mine)  # type: ignore[arg-type]


BROKEN = {
    "syntax": "def (",
    "exits": "import sys; sys.exit(0)",
    "raises": "raise RuntimeError('two\\nlines')",
    "wants": "class A(Agent):\n    def __init__(self, more): pass",
    "reset": "class A(Agent):\n    def reset(self, *_): 1 / 0\n    def act(self, view): pass",
    "act": "class A(Agent):\n    def act(self, view): raise SystemExit",
    "text": "class A(Agent):\n    def act(self, view): return 'x'",
    "plan": "class A(Agent):\n    def act(self, view): return [view.task.action_low]\n"
    "    def song_plan(self, env_id): return 5",
    "nan": "class A(Agent):\n"
    "    def act(self, view): return [[float('nan')] * view.task.action_size]",
}


@pytest.mark.parametrize("name", BROKEN)
def test_agents_of_others_that_break(name, tmp_path, monkeypatch, capsys):
    (tmp_path / f"broken_{name}.py").write_text(f"from cadenza import Agent\n{BROKEN[name]}")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["play", "CMajorScaleOneHand", "--agent", f"broken_{name}:A", "--no-video", "-q"])
    assert end.value.code == 1
    (message,) = capsys.readouterr().err.splitlines()
    assert message.startswith("cadenza: agent ")


def test_an_agent_s_own_error_is_the_cause():
    class Breaks(cadenza.Agent):
        def reset(self, env_ids: Any, rngs: Any) -> None:
            raise KeyError("here")

        def act(self, view: Any) -> Any: ...

    with pytest.raises(CadenzaError, match=r"Breaks: reset\(\): KeyError") as error:
        cadenza.play(TUNE, Breaks())
    assert isinstance(error.value.__cause__, KeyError)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="a pipe with a name")
def test_a_file_that_never_ends_is_not_waited_for(tmp_path):
    pipe = tmp_path / "pipe.mid"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), Path("/dev/null")):
        with pytest.raises(CadenzaError, match="no regular file"):
            content_of(path)
        with pytest.raises(OSError, match="no regular file"), opened(path):
            pass
    for read in (lambda: cadenza.load_song(pipe), lambda: cadenza.load_episode(pipe)):
        with pytest.raises(CadenzaError) as error:
            read()
        line(error)


def test_a_name_of_two_lines_is_shown_in_one(tmp_path, monkeypatch, capsys):
    (tmp_path / "two\nlines").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["play", "two\nlines", "--agent", "zero"])
    (message,) = capsys.readouterr().err.splitlines()
    assert message.startswith(r"cadenza: two\nlines: is no song; give a piece or a music file")
