"""Agents play the same with the same seed, and planning pays."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from begun import begun
from cadenza.agents.agent import Agent, ZeroAgent
from cadenza.agents.baselines.predictive_sampling import PredictiveSampling, SamplingPlanner
from cadenza.agents.planner.config import PredictiveSamplingConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.playback import Playback, load_plan
from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.episode import load_episode
from cadenza.errors import CadenzaError
from cadenza.files import write_tensors
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.tasks.config import DomainRandomization, TaskConfig, task_identity
from cadenza.tasks.piano_task import PianoTask
from melodies import TUNE
from watched import watched

RECORDING = Path(__file__).parents[1] / "data/episode_d.npz"

CONFIG = TaskConfig(initial_buffer_time=0.3)
ONE_CANDIDATE = PredictiveSamplingConfig(num_candidates=1)
FEW_CANDIDATES = PredictiveSamplingConfig(num_candidates=3)
STEPS = 19


def perform(agent: Agent, scene: Scene, seed: int = 0, score: Score = TUNE) -> EpisodeResult:
    return play_episode(PianoTask([score], CONFIG, scene), agent, seed)


def test_a_plan_is_measured_by_the_goals_of_the_steps_in_which_it_is_carried_out(
    right_hand, monkeypatch
):
    """Every 10 ms, of control steps of 50 ms: those of the next step first."""
    measured = watched(monkeypatch, SamplingPlanner, "cost")
    perform(PredictiveSampling(FEW_CANDIDATES), right_hand)
    expected = [[step + k // 5 for k in range(20)] for step in range(STEPS)]
    assert [rows.tolist() for (*_, rows), _ in measured] == expected


def test_a_plan_is_held_over_each_step_goes_on_a_step_later_and_stays_at_its_end(
    right_hand, monkeypatch
):
    planner = PredictiveSampling(ONE_CANDIDATE)
    task = begun(PianoTask([TUNE], CONFIG, right_hand), planner)
    planner.act(task.view())
    here, there = np.random.default_rng(1).uniform(
        task.spec.action_low, task.spec.action_high, (2, 20)
    )
    planner.planners[0].nominal = np.stack([here, there])[:, :-1]  # at 0 and at 0.2 s
    rolled_out = watched(monkeypatch, PlanningSimulation, "rollout")
    action = planner.act(task.view())[0]
    assert_allclose(action[:-1], here[:-1])
    held = [here + share * (there - here) for share in (0, 0.25, 0.5, 0.75) for _ in range(5)]
    (((_, tried), _),) = rolled_out
    assert_allclose(tried, np.stack([held])[..., :-1])
    moved = 0.75 * here + 0.25 * there
    assert_allclose(planner.planners[0].nominal, np.stack([moved, there])[:, :-1])


def test_a_plan_costs_the_same_alone_and_among_others(right_hand, monkeypatch):
    planner = PredictiveSampling(PredictiveSamplingConfig(num_candidates=4))
    alone = PredictiveSampling(ONE_CANDIDATE)
    task = begun(PianoTask([TUNE], CONFIG, right_hand), planner, alone)
    compared = watched(monkeypatch, SamplingPlanner, "costs")
    for agent in (planner, alone):
        agent.act(task.view())
    (_, candidates, _), costs = compared[0]
    for candidate, expected in zip(candidates, costs, strict=True):
        assert alone.planners[0].costs(candidate[None], task.view())[0] == expected


def test_planning_pays(right_hand):
    planner = PredictiveSampling(PredictiveSamplingConfig(iterations=4))
    planned, resting = perform(planner, right_hand), perform(ZeroAgent(), right_hand)
    assert planned.metrics["f1"] > resting.metrics["f1"] + 0.1
    assert planned.metrics["return"] > resting.metrics["return"] + 5


def test_plans_for_a_song_without_fingering(right_hand):
    unfingered = Score(tuple(Note(n.start, n.end, n.pitch) for n in TUNE.notes))
    planner = PredictiveSampling(PredictiveSamplingConfig(iterations=2))
    planned = perform(planner, right_hand, score=unfingered)
    resting = perform(ZeroAgent(), right_hand, score=unfingered)
    assert planned.metrics["reward/fingering"] > resting.metrics["reward/fingering"]


# What is recorded


def test_the_record_of_an_episode(right_hand, tmp_path):
    performance = perform(PredictiveSampling(FEW_CANDIDATES), right_hand)
    episode, metrics = performance.episode, performance.metrics
    assert (episode.song, episode.dt, episode.num_steps) == ("A tune", 0.05, STEPS)
    terms = {n: episode[f"reward_{n}"] for n in ("key_press", "fingering", "energy")}
    np.testing.assert_allclose(sum(terms.values()), episode["reward_total"])
    np.testing.assert_allclose(metrics["return"], episode["reward_total"].sum())
    for name, term in terms.items():
        np.testing.assert_allclose(metrics[f"reward/{name}"], term.sum())
    assert metrics["steps"] == STEPS
    assert metrics["planning_seconds"] > 0 < metrics["playing_seconds"]
    assert json.loads(str(episode["metrics"])) == metrics
    episode.save(tmp_path / "episode.npz")
    loaded = load_episode(tmp_path / "episode.npz")
    assert (loaded.song, loaded.dt, loaded.scene) == (episode.song, episode.dt, episode.scene)
    assert loaded.arrays.keys() == episode.arrays.keys()
    for name, array in loaded.arrays.items():
        assert_array_equal(array, episode[name], err_msg=name)


def test_progress_counts_the_steps(right_hand):
    reports: list[tuple[str, int, int]] = []
    play_episode(
        PianoTask([TUNE], CONFIG, right_hand), ZeroAgent(), 0, lambda *step: reports.append(step)
    )
    assert reports == [("playing", step, STEPS) for step in range(1, STEPS + 1)]


def test_an_episode_that_ends_early_is_recorded_up_to_there():
    scene = build_scene(SceneConfig(hands="none"))
    plan = np.zeros((STEPS, len(scene.action_low)))
    plan[4:, 0] = scene.action_high[0]
    config = TaskConfig(initial_buffer_time=0.3, wrong_press_termination=True)
    performance = play_episode(PianoTask([TUNE], config, scene), Playback(plan))
    assert performance.metrics["steps"] == performance.episode.num_steps == 5
    assert {len(performance.episode[n]) for n in ("goal_keys", "key_qpos", "goal_obs")} == {5}


def test_an_episode_has_the_plan_of_an_agent_that_plans(right_hand):
    plan = perform(Planner(), right_hand).plan
    assert plan is not None
    assert plan.complete
    assert [note.pitch for note in plan.track.score.notes] == [note.pitch for note in TUNE.notes]
    assert perform(ZeroAgent(), right_hand).plan is None


# Replaying


def test_replaying_a_recorded_performance():
    with np.load(RECORDING) as file:
        published = json.loads(str(file["metrics"]))
        song, trim = str(file["song"]), bool(file["trim_silence"])
    config = TaskConfig(trim_silence=trim, initial_buffer_time=0.0, repeats="published")
    task = PianoTask([load_score(song)], config)
    performance = play_episode(task, Playback(load_plan(RECORDING).actions))
    for name, value in published.items():
        assert abs(performance.metrics[name] - value) < 0.005, name


@pytest.mark.parametrize(
    ("shape", "sizes"),
    [((STEPS, 39), "39 .* 20"), ((STEPS - 4, 20), "15 .* 19"), ((STEPS, 0), "0 .* 20")],
)
def test_a_plan_of_another_size_is_refused(right_hand, shape, sizes):
    with pytest.raises(CadenzaError, match=sizes):
        perform(Playback(np.zeros(shape)), right_hand)


def saved(path: Path, **arrays: Any) -> Path:
    np.savez_compressed(path, allow_pickle=True, **arrays)
    return path


def text(path: Path) -> Path:
    path.write_text("plan: play it well")
    return path


BROKEN: dict[str, tuple[Callable[[Path], Path], str]] = {
    "missing": (lambda p: p, "no such file"),
    "folder": (lambda p: p.parent, "not a readable .npz"),
    "text": (text, "not a readable .npz"),
    "pickled": (lambda p: saved(p, action=np.array([{}, []], object)), "not a readable .npz"),
    "no action": (lambda p: saved(p, actions=np.zeros((3, 39))), "no array named action"),
    "nan": (lambda p: saved(p, action=np.full((3, 39), np.nan)), "numbers that are not finite"),
    "1-D": (lambda p: saved(p, action=np.zeros(39)), r"of shape \(39,\)"),
}


@pytest.mark.parametrize("broken", BROKEN)
def test_a_broken_recording_is_refused_in_one_line(broken, tmp_path):
    make, message = BROKEN[broken]
    path = make(tmp_path / "recording.npz")
    with pytest.raises(CadenzaError, match=message) as error:
        load_plan(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


FACTS = {"song": "", "dt": 0.05, "metrics": {}, "options": {}}
ACTION = np.zeros((3, 39))
NO_FINGERS = np.zeros((0, 3))


@pytest.mark.parametrize(
    ("arrays", "facts", "message"),
    [
        ({"fingering": NO_FINGERS}, FACTS, "no array named action"),
        ({"action": ACTION, "fingering": NO_FINGERS}, {}, "header: .*song"),
        ({"action": ACTION, "fingering": NO_FINGERS}, FACTS | {"options": 3}, "header: .*options"),
        (
            {"action": ACTION, "fingering": NO_FINGERS},
            FACTS | {"options": {"physics": "slow"}},
            "options: .*slow",
        ),
    ],
)
def test_a_broken_plan_is_refused_in_one_line(arrays, facts, message, tmp_path):
    path = tmp_path / "plan.safetensors"
    write_tensors(path, arrays, facts)
    with pytest.raises(CadenzaError, match=message) as error:
        load_plan(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("broken", ["missing", "text", "no action"])
def test_a_broken_episode_or_plan_is_refused_in_one_line(broken, tmp_path):
    for read, name in (load_episode, "episode.npz"), (load_plan, "plan.safetensors"):
        path = BROKEN[broken][0](tmp_path / name)
        with pytest.raises(CadenzaError) as error:
            read(path)
        assert str(error.value).startswith(f"{path}: ")
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("drawn", [True, False])
def test_a_plan_needs_its_seed_only_where_something_is_drawn(drawn):
    noise = DomainRandomization(control_noise=0.1)
    task = TaskConfig(random_stretch=0.1 if drawn else 0.0, randomization=noise)
    assert task_identity(task, SceneConfig(), seed=3).get("seed") == (3 if drawn else None)


def test_a_negative_seed_is_refused(right_hand):
    with pytest.raises(CadenzaError, match="seed -1: choose 0 or more"):
        perform(ZeroAgent(), right_hand, seed=-1)
