"""Whatever is wrong with a file, it is played, or refused in one line."""

import json
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mutations
from cadenza.agents.agent import ZeroAgent
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.practice.plan_variants import Variant
from cadenza.agents.planner.practice.practised_planner import PractisedPlan
from cadenza.agents.playback import load_plan, save_plan
from cadenza.agents.rollout import play_episode
from cadenza.episode import load_episode
from cadenza.fingers import Fingers
from cadenza.learning.config import TrainingConfig
from cadenza.learning.policy_folder import POLICY_FILE, load_policy
from cadenza.learning.pretrained import pretrained_folder
from cadenza.learning.run_folder import RunFolder
from cadenza.music.formats.fingering_file import read_fingering, write_fingering
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.report.html_pages import write_page
from cadenza.report.performance_page import performance_page
from cadenza.report.training_page import Curve, training_page
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig, task_identity
from cadenza.tasks.piano_task import PianoTask

SONG = Score((Note(0, 0.1, 60), Note(0.1, 0.2, 64)), (PedalEvent(0.05, 127),), "Für")
TASK, SCENE = TaskConfig(), SceneConfig(hands="right")


@pytest.fixture(scope="module")
def performance():
    with closing(PianoTask([SONG], TASK, SCENE)) as task:
        return play_episode(task, ZeroAgent())


def draws(number: int) -> Iterator[tuple[int, np.random.Generator]]:
    return ((seed, np.random.default_rng(seed)) for seed in range(number))


def other_npz(rng: np.random.Generator, path: Path) -> bytes:
    """With arrays changed, also JSON in them, or bytes, or members."""
    content = path.read_bytes()
    with np.load(path) as file:
        arrays = dict(file)
    match rng.integers(6):
        case 0:
            return mutations.other_bytes(rng, content)
        case 1:
            return mutations.other_members(rng, content)
        case 2:
            changed = mutations.other_json(rng, json.loads(str(arrays["scene"])))
            arrays["scene"] = np.str_(mutations.json_bytes(changed).decode())
        case _:
            arrays = mutations.other_arrays(rng, arrays)
    return mutations.npz_bytes(arrays, compressed=True)


def many(fast: int, slow: int) -> Any:
    return pytest.mark.parametrize("number", [fast, pytest.param(slow, marks=pytest.mark.slow)])


@many(150, 3000)
def test_plans(number, performance, tmp_path):
    intact, path = tmp_path / "whole.safetensors", tmp_path / "plan.safetensors"
    options = task_identity(TASK, SCENE, 0)
    hands = Fingers(per_hand=5)
    ctrl = performance.episode["action"][:, :-1]
    expected, later = np.zeros((len(ctrl) + 1, ctrl.shape[1], 2)), np.zeros((len(ctrl), 1), np.int8)
    practised = PractisedPlan(
        Tracking(ctrl, expected[1:], expected), Variant(np.array([0, 1]), later)
    )
    save_plan(intact, performance.episode, performance.metrics, options, SONG, hands, practised)
    read_back = load_plan(intact).practised
    assert read_back is not None
    assert read_back.variant.equals(Variant(np.array([-1, -1]), later))
    for _, rng in draws(number):
        path.write_bytes(mutations.other_tensors(rng, intact))
        with mutations.at_most_refused():
            load_plan(path).check(options)


@many(50, 2000)
def test_episodes(number, performance, tmp_path):
    """Shown, and played back."""
    intact, path = tmp_path / "whole.npz", tmp_path / "episode.npz"
    performance.episode.save(intact)
    for _, rng in draws(number):
        path.write_bytes(other_npz(rng, intact))
        with mutations.at_most_refused():
            load_plan(path).check({"physics": "published"})
        with mutations.at_most_refused():
            episode = load_episode(path)
            page = performance_page(episode, {}, {}, np.zeros((100, 2), np.float32))
            write_page(tmp_path / "page.html", page)


@many(6, 400)
@pytest.mark.parametrize("song", ["TwinkleTwinkleLittleStar", "OdeToJoy"])
def test_policies(number, song, tmp_path):
    """With the ranges of a song, and with a plan."""
    for _, rng in draws(number):
        changed = mutations.other_tensors(rng, pretrained_folder(song) / POLICY_FILE)
        (tmp_path / POLICY_FILE).write_bytes(changed)
        with mutations.at_most_refused():
            learnt = load_policy(tmp_path)
            with closing(PianoTask([learnt.score], learnt.task, learnt.scene)) as task:
                task.reset([np.random.default_rng(0)], [0])
                agent = learnt.agent
                agent.reset([0], [np.random.default_rng(0)])
                for _ in range(3):
                    task.step(agent.act(task.view()))


@many(100, 3000)
def test_runs(number, tmp_path):
    run = RunFolder(tmp_path)
    run.begin(TrainingConfig(), [SONG])
    intact = (tmp_path / "run.json").read_bytes()
    for seed, rng in draws(number):
        if seed % 4:
            changed = mutations.json_bytes(mutations.other_json(rng, json.loads(intact)))
        else:
            changed = mutations.other_bytes(rng, intact)
        (tmp_path / "run.json").write_bytes(changed)
        with mutations.at_most_refused():
            config, _ = run.settings()
            assert isinstance(run.id, str)
            assert json.dumps(asdict(config))


ROW = {"step": 100, "seconds": 2.5, "eval_step": 90, "eval/f1": 0.5, "train/value": None}


@many(100, 3000)
def test_figures(number, tmp_path):
    lines = [json.dumps(ROW | {"step": step}).encode() for step in range(100, 600, 100)]
    for seed, rng in draws(number):
        content = list(lines)
        at = rng.integers(len(lines))
        content[at] = mutations.json_bytes(mutations.other_json(rng, json.loads(lines[at])))
        intact = b"\n".join([*content, b""])
        changed = intact if seed % 3 else mutations.other_bytes(rng, intact)
        (tmp_path / "metrics.jsonl").write_bytes(changed)
        with mutations.at_most_refused():
            rows = RunFolder(tmp_path).metrics.rows()
            assert len(rows) >= (4 if seed % 3 else 0)
            if not any(abs(v or 0) > 1e15 for row in rows for v in row.values()):
                write_page(tmp_path / "page.html", training_page("", [Curve("run", rows)], {}))


@many(200, 5000)
def test_fingerings(number, tmp_path):
    path = tmp_path / "song.fingering"
    write_fingering(SONG, path)
    intact = path.read_bytes()
    for _, rng in draws(number):
        path.write_bytes(mutations.other_bytes(rng, intact))
        with mutations.at_most_refused():
            read_fingering(path, SONG)
