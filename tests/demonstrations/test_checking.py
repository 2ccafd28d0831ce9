"""Damage of every kind is told in a line that names the file and says what to do."""

import errno
import hashlib
import json
import os
import re
import shutil
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadenza.agents.agent import Agent
from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.cli import main
from cadenza.demonstrations import replay
from cadenza.demonstrations.checking import problems
from cadenza.demonstrations.dataset import kept, open_dataset
from cadenza.demonstrations.minari_export import write_minari
from cadenza.demonstrations.recorded_episode import PLAN, RESULT, SCORE, SONGS, STEPS, write_facts
from cadenza.demonstrations.transitions import transitions
from cadenza.errors import CadenzaError
from cadenza.files import sha256_of
from cadenza.learning.config import ImitationConfig
from cadenza.learning.imitation import Imitation
from cadenza.performing.replaying import replay_episode
from cadenza.tasks.piano_task import PianoTask
from refusals import refused


def test_nothing_is_wrong(made):
    assert list(problems(made, replays=2)) == []


def first(folder: Path) -> Path:
    return min((folder / "runs").iterdir())


def changed(folder: Path, name: str, change: Callable[[np.ndarray], None]) -> None:
    """An array that was written wrongly: its checksum is right."""
    array = np.load(first(folder) / name)
    change(array)
    np.save(first(folder) / name, array)
    with changed_result(folder) as result:
        result["files"][name] = sha256_of(first(folder) / name)


@contextmanager
def changed_result(folder: Path) -> Iterator[dict[str, Any]]:
    """Yields the content of result.json, to be changed, and its checksum with it."""
    path = first(folder) / RESULT
    result = json.loads(path.read_text())
    del result["seal"]
    yield result
    content = json.dumps([path.parent.name, result], sort_keys=True)
    result["seal"] = hashlib.sha256(content.encode()).hexdigest()
    path.write_text(json.dumps(result))


@pytest.mark.parametrize("name", [STEPS, PLAN, SCORE])
@pytest.mark.parametrize("damage", ["bit", "cut", "gone"])
def test_damaged_files(copied, name, damage):
    path = first(copied) / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(content if damage == "bit" else content[: len(content) // 2])
    (line,) = problems(copied, replays=0)
    assert line.startswith(f"{path}: ")
    assert line.endswith("delete its folder and collect again")


@pytest.mark.parametrize("name", [STEPS, PLAN, SCORE, RESULT])
def test_a_file_that_is_far_too_large_is_not_read_at_once(copied, name):
    os.truncate(first(copied) / name, 2**28)  # takes no room
    tracemalloc.start()
    (line,) = problems(copied, replays=0)
    assert tracemalloc.get_traced_memory()[1] < 2**26
    tracemalloc.stop()
    assert line.startswith(f"{first(copied) / name}: ")


@pytest.mark.parametrize("damage", ["cut", "gone"])
def test_a_damaged_song_is_told_of_all_its_episodes(copied, damage):
    (path,) = (copied / SONGS).iterdir()
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-1])
    told = list(problems(copied, replays=0))
    assert len(told) == 2
    assert all(line.startswith(f"{path}: ") for line in told)
    with pytest.raises(CadenzaError, match=str(path)):
        write_minari(open_dataset(copied), copied / "minari", "copied-v0", lambda *_: None)


def test_a_result_that_is_cut_off(copied):
    path = first(copied) / RESULT
    path.write_text(path.read_text()[:-20])
    (line,) = problems(copied, replays=0)
    assert str(path) in line
    assert "\n" not in line


def test_values_that_cannot_be(copied):
    def spoil(steps: np.ndarray) -> None:
        steps["hand_qvel"][3, 2] = np.nan
        steps["action"][2, 5] = 10.0

    changed(copied, STEPS, spoil)
    lines = list(problems(copied, replays=0))
    assert len(lines) == 2
    assert "hand_qvel is not finite" in lines[0]
    assert "action beyond the actions' limits" in lines[1]


def test_rows_that_are_missing(copied):
    path = first(copied) / STEPS
    np.save(path, np.load(path)[:-3])
    with changed_result(copied) as result:
        result["files"][STEPS] = sha256_of(path)
    (line,) = problems(copied, replays=0)
    assert f"{path}: not the" in line


def test_facts_that_were_changed_are_noticed_by_all(copied):
    path = first(copied) / RESULT
    path.write_text(path.read_text().replace('"noise": 0', '"noise": 1'))
    (line,) = problems(copied, replays=0)
    assert line.startswith(f"{path}: its checksum is another")
    with pytest.raises(CadenzaError, match="its checksum is another"):
        open_dataset(copied)


def test_a_result_that_is_gone(copied):
    path = first(copied) / RESULT
    path.unlink()
    (line,) = problems(copied, replays=0)
    assert line.startswith(f"{path.parent}: has no result.json, so it does not count")


def test_facts_without_their_checksum_are_refused(copied):
    path = first(copied) / RESULT
    result = json.loads(path.read_text())
    del result["seal"]
    path.write_text(json.dumps(result))
    with pytest.raises(CadenzaError, match="its checksum is another or gone"):
        open_dataset(copied)


@pytest.mark.parametrize("name", [STEPS, PLAN, SCORE])
def test_changed_files_are_refused_by_learners_exports_and_players(copied, name):
    with (first(copied) / name).open("ab") as file:
        file.write(b" ")  # which their formats allow
    with pytest.raises(CadenzaError, match="its checksum is another"):
        transitions(open_dataset(copied), 0)
    with pytest.raises(CadenzaError, match="its checksum is another"):
        Imitation(ImitationConfig(held_out=0), copied, copied / "clone")
    if name != PLAN:
        with pytest.raises(CadenzaError, match="its checksum is another"):
            replay_episode(kept(copied)[0])


def test_a_copied_episode_is_noticed(copied):
    copy = first(copied).with_name("copy of it")
    shutil.copytree(first(copied), copy)
    (line,) = problems(copied, replays=0)
    assert line.startswith(f"{copy / RESULT}: its checksum is another")


def test_a_score_that_is_too_short(copied):
    path = first(copied) / SCORE
    score = json.loads(path.read_text())
    path.write_text(json.dumps(score | {"notes": score["notes"][:1]}))
    with changed_result(copied) as result:
        result["files"][SCORE] = sha256_of(path)
    (line,) = problems(copied, replays=0)
    assert re.search(r": has \d+ steps, the episode \d+; delete its folder and collect again", line)
    assert line.startswith(str(path))
    with pytest.raises(CadenzaError, match="steps, the episode"):
        open_dataset(copied).batch(np.array([0]))
    with pytest.raises(CadenzaError, match="steps, the episode"):
        replay_episode(kept(copied)[0])


def test_no_file_makes_it_import_a_module(copied, tmp_path, monkeypatch, capsys):
    (tmp_path / "stranger.py").write_text(
        "from pathlib import Path\nfrom cadenza.hands.shadow import SHADOW as HAND\n"
        f"Path({str(tmp_path / 'imported')!r}).touch()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    for episode in kept(copied):
        scene = replace(episode.facts.scene, hand="stranger:HAND")
        write_facts(episode.folder, replace(episode.facts, scene=scene))
    line, *_ = problems(copied, replays=1)
    assert "no file makes Cadenza import a module; give --hand stranger:HAND if you trust" in line
    for refuses in (
        lambda: open_dataset(copied),
        lambda: replay_episode(kept(copied)[0]),
        lambda: Imitation(ImitationConfig(), copied, tmp_path / "run"),
    ):
        with pytest.raises(CadenzaError, match="no file makes Cadenza import a module"):
            refuses()
    assert not (tmp_path / "imported").exists()
    main(["dataset", "check", str(copied), "--hand", "stranger:HAND"])
    assert "nothing is wrong" in capsys.readouterr().out
    assert (tmp_path / "imported").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with a name")
def test_a_pipe_is_not_waited_for(copied):
    path = first(copied) / STEPS
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(CadenzaError, match="no regular file"):
        open_dataset(copied).batch(np.array([0]))


def test_what_was_not_played_so(copied):
    def spoil(steps: np.ndarray) -> None:
        steps["played"][5, 6] *= 0.99

    changed(copied, STEPS, spoil)
    (line,) = problems(copied, replays=2)
    assert "played again it differs: hand_qpos by" in line


def test_the_command_tells_all_and_fails(copied, made, capsys):
    main(["dataset", "check", str(made), "--replays", "0"])
    assert "nothing is wrong" in capsys.readouterr().out
    (first(copied) / PLAN).unlink()
    told = refused(capsys, "dataset", "check", copied, "--replays", 0).splitlines()
    assert "plan.npy: missing" in told[0]
    assert told[1] == f"cadenza: {copied}: 1 problem"


def test_files_that_cannot_be_opened_are_not_called_damaged(copied, monkeypatch):
    def too_many(*_: object, **__: object) -> np.ndarray:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(np, "load", too_many)
    told = list(problems(copied, replays=0))
    assert told
    assert all("Too many open files" in line and "delete" not in line for line in told)


def test_what_was_checked_is_not_kept_open(made):
    opened: list[int] = []

    def count(*_: int) -> None:
        opened.append(len(os.listdir("/proc/self/fd")))

    assert list(problems(made, replays=0, progress=count)) == []
    assert opened[-1] <= opened[0]


def test_an_episode_that_ends_earlier_than_it_did(copied, monkeypatch):
    def cut_short(task: PianoTask, agent: Agent) -> EpisodeResult:
        return play_episode(task, agent, stop=lambda: task.goals.steps_done[0] >= 3)

    monkeypatch.setattr(replay, "play_episode", cut_short)
    lines = list(problems(copied, replays=2))
    assert len(lines) == 2
    assert all("played again it differs: the number of steps by" in line for line in lines)


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("metrics", "steps", -5),
        ("metrics", "steps", None),
        ("metrics", "f1", 2.0),
        ("drawn", "mirrored", 5),
        ("task", "control_timestep", 0.0),
        ("task", "control_timestep", 5e-324),
        ("task", "initial_buffer_time", -1.0),
        ("task", "initial_buffer_time", 1e300),
    ],
)
def test_a_result_that_cannot_be_is_refused_by_all(copied, part, name, value):
    with changed_result(copied) as told:
        told[part][name] = value
    with pytest.raises(CadenzaError, match=rf"result.json: {name} .* cannot be"):
        open_dataset(copied)
    (said,) = problems(copied, 0)
    assert said.startswith(f"{first(copied) / RESULT}: {name}")
    assert said.endswith("delete its folder and collect again")


def test_hands_that_began_with_other_joints(copied):
    with changed_result(copied) as told:
        told["start"].append(0.0)
    (said,) = problems(copied, 1)
    assert said.startswith(f"{first(copied) / RESULT}: start is not that of")


def test_learners_and_exports_refuse_what_is_not_finite(copied):
    def spoil(steps: np.ndarray) -> None:
        steps["action"][3] = np.nan

    changed(copied, STEPS, spoil)
    with pytest.raises(CadenzaError, match=r"steps\.npy: action is not finite"):
        transitions(open_dataset(copied), 0)
    with pytest.raises(CadenzaError, match=r"steps\.npy: action is not finite"):
        Imitation(ImitationConfig(held_out=0), copied, copied / "clone")
