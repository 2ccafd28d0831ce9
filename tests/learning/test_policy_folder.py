"""Policies play as the actor that learns does, on any machine, without what learning needs."""

import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import melody, random_params
from scipy.stats import kstest

from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.errors import CadenzaError
from cadenza.files import ANY, read_tensors, write_tensors
from cadenza.learning import pretrained
from cadenza.learning.actions import reference_of
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.droq.learner import actor_weights
from cadenza.learning.algorithms.droq.networks import Actor
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.observation import GoalTable, Inputs, ObservationSpec, pruned
from cadenza.learning.policy import Perceptron
from cadenza.learning.policy_folder import POLICY_FILE, load_policy, save_policy
from cadenza.learning.ranges import ranges_of
from cadenza.music.libraries.library import songs
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from learnt import random_policy
from numbered import finger

# Times that no decimal of a few digits says exactly.
SONG = Score(
    (
        Note(0.0, 1 / 3, 60, 99, finger=finger(2)),
        Note(0.1 + 0.2, 0.7, 64),
        Note(float(np.nextafter(0.7, 1)), 0.9, 60),
    ),
    (PedalEvent(np.pi / 10, 127), PedalEvent(0.8, 3)),
    "Stück № 1",
    ("two notes were mended",),
)


def some_policy(
    residual: bool = False, ranged: bool = False, prune: bool = True, **task: Any
) -> LearntPolicy:
    config = TaskConfig(initial_buffer_time=0.1, **task)
    scene = SceneConfig(hands="right", forearm_dofs=("tx", "ty"))
    shown = PianoTask([SONG], config, scene)
    scores = GoalTable(shown.spec, shown.tracks)
    observation = ObservationSpec.of(shown.spec, residual)
    inputs = pruned(observation, *scores.goals_used()) if prune else observation.inputs
    sizes = len(inputs.kept), shown.spec.action_size, 16, 16
    policy = random_policy(*sizes, activation="gelu", size=0.2)
    reference = reference_of(shown) if residual else None
    ranges = ranges_of(shown) if ranged else None
    return LearntPolicy(policy, observation, inputs, reference, ranges, config, scene, SONG)


def played(learnt: LearntPolicy) -> EpisodeResult:
    return play_episode(PianoTask([learnt.score], learnt.task, learnt.scene), learnt.agent)


@pytest.mark.parametrize("kind", ["plain", "residual", "ranged"])
def test_comes_back_exactly_and_plays_the_same(tmp_path, kind):
    learnt = some_policy(kind == "residual", kind == "ranged")
    save_policy(tmp_path, learnt, {"step": 3})
    again = load_policy(tmp_path)
    nothing: dict[str, Any] = {"policy": None, "reference": None, "ranges": None}
    assert replace(again, **nothing) == replace(learnt, **nothing)
    assert again.residual == learnt.residual == (kind == "residual")
    assert (again.ranges is None) == (learnt.ranges is None) == (kind != "ranged")
    for ours, theirs in ((again.reference, learnt.reference), (again.ranges, learnt.ranges)):
        for name, array in (theirs._asdict() if theirs else {}).items():
            assert_array_equal(getattr(ours, name), array)
    assert [note.start.hex() for note in again.score.notes] == [n.start.hex() for n in SONG.notes]
    assert again.policy.weights.keys() == learnt.policy.weights.keys()
    for name, array in learnt.policy.weights.items():
        assert again.policy.weights[name].dtype == np.float32
        assert_array_equal(again.policy.weights[name], array)
    first, second = played(learnt), played(again)
    for name, array in first.episode.arrays.items():
        if name != "metrics":  # times
            assert_array_equal(second.episode.arrays[name], array)
    assert first.metrics["f1"] == second.metrics["f1"]
    assert np.ptp(first.episode.arrays["action"], axis=0).max() > 0


def test_plays_by_what_it_is_shown():
    """Its action depends on the goal: another song gets others from the same start.

    Where it is given all that can be observed, also those of keys that its own song never uses.
    """
    learnt = some_policy(prune=False)
    songs = [SONG, melody(72, 50), melody(72, 51)]
    first = [played(replace(learnt, score=song)).episode.arrays["action"][0] for song in songs]
    for one, other in combinations(first, 2):
        assert (one != other).any()


def test_corrections_are_of_the_song_that_was_learnt():
    other = replace(some_policy(residual=True), score=melody(60, 64, 67, 72, 76))
    with pytest.raises(CadenzaError, match="can only play the song"):
        played(other)


def test_playing_needs_nothing_that_learning_needs(tmp_path):
    save_policy(tmp_path, some_policy(), {})
    program = f"""
import sys
from pathlib import Path
from cadenza.learning.policy import Perceptron
from cadenza.learning.policy_folder import load_policy
from cadenza.agents.rollout import play_episode
from cadenza.tasks.piano_task import PianoTask
learnt = load_policy(Path({str(tmp_path)!r}))
metrics = play_episode(PianoTask([learnt.score], learnt.task, learnt.scene), learnt.agent).metrics
learning = {{"jax", "jaxlib", "flax", "optax", "orbax", "tensorboardX", "wandb"}}
print(metrics["steps"], sorted(learning & {{name.split(".")[0] for name in sys.modules}}))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.stdout == "21 []\n"


# What is refused


def assert_refused(folder: Path, saying: str) -> None:
    with pytest.raises(CadenzaError, match=saying) as error:
        load_policy(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("option", ["hand", "keyboard"])
def test_no_file_has_a_module_imported(tmp_path, option):
    """Nobody has asked for what this module does when it is imported."""
    learnt = some_policy()
    scene = replace(learnt.scene, **{option: "antigravity:HAND"})
    save_policy(tmp_path, replace(learnt, scene=scene), {})
    assert_refused(tmp_path, f"--{option} antigravity:HAND")
    assert "antigravity" not in sys.modules


@pytest.mark.parametrize(
    ("change", "saying"),
    [
        ({"format": 99}, "format 99, but this version reads only 3; install the version"),
        ({"task": {"tempo": 3}}, r"policy\.safetensors: .*task"),
        (
            {"score": {"notes": 3, "pedal": [], "title": "", "remarks": []}},
            r"policy\.safetensors: .*score",
        ),
        ({"observation": {"goal": 3}}, r"policy\.safetensors: .*observation"),
        ({"inputs": {"kept": [2, 1], "total": 5}}, r"policy\.safetensors: .*inputs"),
        ({"activation": "swish"}, r"policy\.safetensors: .*activation"),
        ({"log_std_range": [1, 2, 3]}, r"policy\.safetensors: .*log_std_range"),
    ],
)
def test_facts_that_do_not_fit_are_refused(tmp_path, change, saying):
    """With the right digest."""
    save_policy(tmp_path, some_policy(), {})
    arrays, facts = read_tensors(tmp_path / POLICY_FILE, ANY, 2**28)
    write_tensors(tmp_path / POLICY_FILE, arrays, facts | change)
    assert_refused(tmp_path, saying)


@pytest.mark.parametrize("name", ["hidden_0/kernel", "hidden_1/bias", "mean/kernel"])
def test_weights_that_do_not_fit_are_refused(tmp_path, name):
    learnt = some_policy()
    for weights in (
        {n: w for n, w in learnt.policy.weights.items() if n != name},
        learnt.policy.weights | {name: learnt.policy.weights[name][:-1]},
    ):
        policy = Perceptron(weights, "gelu", (-20.0, 2.0))
        save_policy(tmp_path, replace(learnt, policy=policy), {})
        assert_refused(tmp_path, "not a policy that this version can read|from another version")
    learnt.policy.weights[name].flat[3] = np.nan
    save_policy(tmp_path, learnt, {})
    assert_refused(tmp_path, "numbers that are not finite")


def test_a_task_that_shows_something_else_is_refused():
    learnt = some_policy()
    with pytest.raises(CadenzaError, match="trained with hands right, but here it is both"):
        play_episode(PianoTask([SONG], learnt.task, SceneConfig()), learnt.agent)


def test_a_folder_without_a_policy_is_refused(tmp_path):
    assert_refused(tmp_path, "holds no policy.safetensors, so it is no policy; name another")
    assert_refused(tmp_path / "nowhere", "so it is no policy; name another")
    (tmp_path / "file").write_text("no folder")
    assert_refused(tmp_path / "file", "so it is no policy; name another")
    # Nor is one with a checkpoint.
    write_tensors(tmp_path / POLICY_FILE, {}, {"command": "cadenza train", "step": 3})
    assert_refused(tmp_path, "not a policy that this version can read|has format None")


FOLDERS = sorted(
    path.parent for path in Path(pretrained.__file__).parent.glob("*/policy.safetensors")
)


def test_there_are_three_and_they_are_small():
    assert len(FOLDERS) >= 3
    for folder in FOLDERS:
        assert folder.name in {piece.name for piece in songs()}
        assert sum(path.stat().st_size for path in folder.iterdir()) < 3e6


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_they_play_what_they_have_learnt(folder):
    learnt = load_policy(folder)
    with closing(PianoTask([learnt.score], learnt.task, learnt.scene)) as task:
        metrics = play_episode(task, learnt.agent).metrics
    assert metrics["f1"] >= 0.98
    assert metrics["note_onset_f1"] >= 0.98


INPUTS, ACTIONS = 30, 3


class Both:
    """An actor with random weights, biases too, and the policy of the same weights."""

    def __init__(self, activation: Any, **options: Any) -> None:
        self.rng = np.random.default_rng(0)
        config = DroQConfig(hidden_sizes=(32, 16, 24), activation=activation, **options)
        actor = Actor(config, Inputs(tuple(range(INPUTS)), INPUTS), ACTIONS)
        params = random_params(actor, self.rng, np.zeros((1, INPUTS)), size=0.15)
        apply = jax.jit(actor.apply)
        self.actor = lambda x: tuple(map(np.asarray, apply({"params": params}, x)))
        limits = (config.log_std_min, config.log_std_max)
        self.policy = Perceptron(actor_weights(params), activation, limits)

    def observations(self, number: int) -> np.ndarray:
        return self.rng.standard_normal((number, INPUTS)).astype(np.float32)


@pytest.mark.parametrize("activation", ["relu", "gelu"])
def test_the_mode_is_the_squashed_mean_of_the_actor(activation):
    both = Both(activation)
    observation = both.observations(100)
    best = both.policy.mode(observation)
    assert best.dtype == np.float32
    assert_allclose(best, np.tanh(both.actor(observation)[0]), atol=1e-5)
    assert np.ptp(best) > 0.3


@pytest.mark.parametrize(
    ("activation", "limits"),
    [("relu", {}), ("gelu", {}), ("relu", {"log_std_min": -0.7, "log_std_max": -0.6})],
)
def test_draws_come_from_the_distribution_of_the_actor(activation, limits):
    """Draws before tanh are normal, with the actor's mean and deviation for each observation."""
    both = Both(activation, **limits)
    observation = np.repeat(both.observations(4), 3000, axis=0)
    drawn = both.policy.sample(observation, np.random.default_rng(1))
    assert drawn.dtype == np.float32
    assert np.abs(drawn).max() <= 1
    mean, log_std = both.actor(observation)
    normal = (np.arctanh(drawn.astype(np.float64)) - mean) / np.exp(log_std)
    for action in range(ACTIONS):
        for part in normal[:, action].reshape(4, -1):
            assert kstest(part, "norm").pvalue > 1e-4
    assert np.abs(np.corrcoef(normal.T) - np.eye(ACTIONS)).max() < 5 / np.sqrt(len(normal))
