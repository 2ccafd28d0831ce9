"""Damage of every kind is refused by whatever reads it, in a line that says what to do."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadenza.cli import main
from cadenza.demonstrations.dataset import kept, open_dataset
from cadenza.demonstrations.minari_export import write_minari
from cadenza.demonstrations.recorded_episode import PLAN, RESULT, SCORE, SONGS, STEPS, write_facts
from cadenza.errors import CadenzaError
from cadenza.files import sha256_of
from cadenza.learning.config import ImitationConfig
from cadenza.learning.imitation import Imitation
from cadenza.performing.replaying import replay_episode


def first(folder: Path) -> Path:
    return min((folder / "runs").iterdir())


def learn(folder: Path) -> None:
    Imitation(ImitationConfig(held_out=0), folder, folder / "clone")


def export(folder: Path) -> None:
    write_minari(open_dataset(folder), folder / "minari", "copied-v0", lambda *_: None)


def replay(folder: Path) -> None:
    replay_episode(kept(folder)[0])


READERS: tuple[Callable[[Path], None], ...] = (learn, export, replay)


def assert_refused(read: Callable[[Path], object], folder: Path, saying: str) -> None:
    with pytest.raises(CadenzaError, match=saying) as error:
        read(folder)
    assert "\n" not in str(error.value)


@contextmanager
def changed_result(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the content of result.json, to be changed along with its checksum."""
    path = first(folder) / RESULT
    result = json.loads(path.read_text())
    del result["seal"]
    yield result
    content = json.dumps([path.parent.name, result], sort_keys=True)
    result["seal"] = hashlib.sha256(content.encode()).hexdigest()
    path.write_text(json.dumps(result))


def changed(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """An array that was written wrongly: its checksum is right."""
    path = first(folder) / STEPS
    np.save(path, change(np.load(path)))
    with changed_result(folder) as result:
        result["files"][STEPS] = sha256_of(path)


@pytest.mark.parametrize("name", [STEPS, PLAN, SCORE])
@pytest.mark.parametrize("damage", ["bit", "gone"])
def test_damaged_files(copied, name, damage):
    path = first(copied) / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.unlink()
    if damage == "bit":
        path.write_bytes(content)
    for read in READERS[: 2 if name == PLAN else 3]:
        assert_refused(read, copied, f"{path}: .*delete its folder and collect again")


@pytest.mark.parametrize("damage", ["cut", "gone"])
def test_a_damaged_song(copied, damage):
    (path,) = (copied / SONGS).iterdir()
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-1])
    assert_refused(export, copied, str(path))


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text[:-20],
        lambda text: text.replace('"noise": 0', '"noise": 1'),
        lambda text: text.replace('"seal"', '"sealed"'),
    ],
)
def test_facts_that_were_changed(copied, change):
    path = first(copied) / RESULT
    path.write_text(change(path.read_text()))
    assert_refused(open_dataset, copied, str(path))


def test_an_episode_that_was_copied(copied):
    copy = first(copied).with_name("copy of it")
    shutil.copytree(first(copied), copy)
    assert_refused(open_dataset, copied, f"{copy / RESULT}: its checksum is another")


@pytest.mark.parametrize(
    ("value", "saying"), [(np.nan, "is not finite"), (10.0, "beyond the actions' limits")]
)
def test_actions_that_no_servo_takes(copied, value, saying):
    def spoil(steps: np.ndarray) -> np.ndarray:
        steps["action"][2, 5] = value
        return steps

    changed(copied, spoil)
    for read in (learn, export):
        assert_refused(read, copied, rf"steps\.npy: action {saying}")


def test_rows_that_are_missing(copied):
    changed(copied, lambda steps: steps[:-3])
    assert_refused(learn, copied, f"{first(copied) / STEPS}: not the")


def test_a_score_that_is_too_short(copied):
    path = first(copied) / SCORE
    score = json.loads(path.read_text())
    path.write_text(json.dumps(score | {"notes": score["notes"][:1]}))
    with changed_result(copied) as result:
        result["files"][SCORE] = sha256_of(path)
    saying = rf"{path}: has \d+ steps, the episode \d+; delete its folder and collect again"
    for read in (lambda folder: open_dataset(folder).batch(np.array([0])), replay):
        assert_refused(read, copied, saying)


def test_no_file_makes_it_import_a_module(copied, tmp_path, monkeypatch):
    (tmp_path / "stranger.py").write_text(
        "from pathlib import Path\nfrom cadenza.hands.shadow import SHADOW as HAND\n"
        f"Path({str(tmp_path / 'imported')!r}).touch()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    for episode in kept(copied):
        scene = replace(episode.facts.scene, hand="stranger:HAND")
        write_facts(episode.folder, replace(episode.facts, scene=scene))
    for read in (open_dataset, *READERS):
        assert_refused(read, copied, "give --hand stranger:HAND if you trust")
    assert not (tmp_path / "imported").exists()
    exported = ["export", str(copied), "-o", str(tmp_path / "new"), "--hand", "stranger:HAND"]
    main(["dataset", *exported])
    assert (tmp_path / "imported").exists()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with a name")
def test_a_pipe_is_not_waited_for(copied):
    path = first(copied) / STEPS
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(CadenzaError, match="no regular file"):
        open_dataset(copied).batch(np.array([0]))


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("metrics", "steps", -5),
        ("metrics", "f1", 2.0),
        ("drawn", "mirrored", 5),
        ("task", "control_timestep", 0.0),
        ("task", "initial_buffer_time", 1e300),
    ],
)
def test_a_result_that_cannot_be(copied, part, name, value):
    with changed_result(copied) as facts:
        facts[part][name] = value
    saying = f"{first(copied) / RESULT}: {name} .* cannot be.*delete its folder and collect again"
    assert_refused(open_dataset, copied, saying)


def test_hands_that_began_with_other_joints(copied):
    with changed_result(copied) as facts:
        facts["start"].append(0.0)
    assert_refused(replay, copied, f"{first(copied) / RESULT}: start is not that of")
