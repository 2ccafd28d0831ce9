"""Training runs: the same bits however often they are stopped, killed and resumed."""

import errno
import functools
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rl_examples
from numpy.testing import assert_array_equal
from rl_examples import TINY, melody

import cadenza
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import play_episode, play_episodes
from cadenza.errors import CadenzaError
from cadenza.files import ANY, read_tensors
from cadenza.learning.algorithms.ppo.config import PPOConfig
from cadenza.learning.config import TrainingConfig
from cadenza.learning.policy_folder import load_policy, remarks_on
from cadenza.learning.problem import problem_of
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import Training
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask

SONG = melody(60, 64, 67)
train = partial(rl_examples.train, songs=[SONG])
pytestmark = pytest.mark.usefixtures("compiled_once")
CONFIG = TrainingConfig(
    learner=TINY,
    task=TaskConfig(initial_buffer_time=0.1),
    scene=SceneConfig(hands="right", physics="fast"),
    num_steps=208,
    num_envs=2,
    learning_starts=48,
    train_freq=4,
    gradient_steps=2,
    buffer_size=120,
    prune_inputs=True,
    eval_interval=60,
    log_interval=40,
)
WAYS = {
    "in turn": CONFIG,
    "parallel": replace(CONFIG, parallel=True, song_range=True),
    "residual": replace(
        CONFIG, parallel=True, residual=True, learner=replace(TINY, initial_mean=0.0)
    ),
    # Its score is drawn anew every time.
    "stretched": replace(CONFIG, task=replace(CONFIG.task, random_stretch=0.3)),
}
# How long things took, and when they were noted.
TIMES = {"seconds", "step", "eval/planning_seconds", "eval/playing_seconds"}


@pytest.fixture
def runs(tmp_path):
    def new() -> RunFolder:
        path = tmp_path / str(len(list(tmp_path.iterdir())))
        path.mkdir()
        return RunFolder(path)

    return new


def evaluations(run: RunFolder) -> list[dict[str, Any]]:
    rows = [row for row in run.metrics.rows() if "eval_step" in row]
    return [{name: v for name, v in row.items() if name not in TIMES} for row in rows]


def figures(run: RunFolder) -> list[dict[str, Any]]:
    """The rows between evaluations."""
    rows = [row for row in run.metrics.rows() if "eval_step" not in row]
    return [{name: v for name, v in row.items() if name != "seconds"} for row in rows]


def checkpoint(run: RunFolder) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays and the facts of its checkpoint."""
    return read_tensors(run.checkpoint, ANY, 2**28)


def assert_same_runs(run: RunFolder, other: RunFolder) -> None:
    """Weights and all else that the last checkpoint holds; policies; figures."""
    (arrays, facts), (other_arrays, other_facts) = checkpoint(run), checkpoint(other)
    assert arrays.keys() == other_arrays.keys()
    for name, array in arrays.items():
        assert_array_equal(array, other_arrays[name], err_msg=name)
    for name in ("step", "rng"):
        assert facts[name] == other_facts[name]
    for name in ("collector", "finished"):
        assert facts["own"][name] == other_facts["own"][name]
    for name in ("best", "last"):
        ours, theirs = (load_policy(r.path / name) for r in (run, other))
        nothing: dict[str, Any] = {"policy": None, "reference": None, "ranges": None}
        assert replace(ours, **nothing) == replace(theirs, **nothing)
        for layer, array in ours.policy.weights.items():
            assert_array_equal(array, theirs.policy.weights[layer], err_msg=f"{name}: {layer}")
    assert evaluations(run) == evaluations(other)
    assert figures(run) == figures(other)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], RunFolder]:
    @functools.cache
    def run(way: str) -> RunFolder:
        folder = RunFolder(tmp_path_factory.mktemp(way.replace(" ", "_")))
        train(WAYS[way], folder)
        return folder

    return run


# What a run leaves behind


@pytest.mark.parametrize("way", ["in turn", "residual"])
def test_a_run_evaluates_and_keeps_the_best_and_the_last(way, undisturbed):
    """The best plays again what its evaluation says; a residual begins with the planner's play."""
    run = undisturbed(way)
    rows = evaluations(run)
    begins = [0] if WAYS[way].residual else []
    assert [row["eval_step"] for row in rows] == [*begins, 64, 120, 184, 208]  # last at the end
    if begins:
        task = PianoTask([SONG], CONFIG.task, CONFIG.scene)
        by_planner = play_episode(task, Planner()).metrics
        for name in ("f1", "note_onset_f1"):
            assert rows[0][f"eval/{name}"] == pytest.approx(by_planner[name], rel=1e-6)
    about = remarks_on(run.path / "best")
    notes, frames, off = "eval/note_onset_f1", "eval/f1", "eval/velocity_error"
    best = max(rows, key=lambda row: (row[notes], row[frames], -row.get(off, np.inf)))
    assert about["eval/f1"] == best["eval/f1"]
    assert about["eval_step"] == best["eval_step"]
    learnt = load_policy(run.path / "best")
    assert learnt.residual == WAYS[way].residual
    task = PianoTask([learnt.score], learnt.task, learnt.scene)
    metrics = play_episode(task, learnt.agent).metrics
    for name in ("f1", "precision", "return", "reward/key_press", "steps"):
        assert metrics[name] == best[f"eval/{name}"]


def test_where_chance_decides_an_evaluation_is_the_mean_of_several_episodes(runs):
    noise = DomainRandomization(control_noise=0.05)
    run = runs()
    train(replace(CONFIG, task=replace(CONFIG.task, randomization=noise)), run)
    learnt, about = load_policy(run.path / "best"), remarks_on(run.path / "best")
    with closing(PianoTask([SONG], learnt.task, learnt.scene, 8)) as task:
        played = [one.metrics["return"] for one in play_episodes(task, learnt.agent, range(8))]
    assert len(set(played)) == 8
    assert about["eval/return"] == pytest.approx(np.mean(played), rel=1e-6)


def test_an_evaluation_that_ends_early_is_not_the_best_for_what_it_played(runs, monkeypatch):
    """Everything is right before the first note, and a wrong key may end an episode there.

    Whole notes decide, and F1 only where they are equal.
    """
    results = iter([(0.9, 0.9, 2), (0.6, 0.7, 13), (0.7, 0.7, 13), (0.9, 0.6, 14)])

    def played(*_: object) -> Any:
        metrics = dict(zip(("f1", "note_onset_f1", "steps"), next(results), strict=True))
        return [SimpleNamespace(metrics=metrics)]

    monkeypatch.setattr("cadenza.learning.training.play_episodes", played)
    run = runs()
    train(CONFIG, run)
    about = remarks_on(run.path / "best")
    assert (about["eval/f1"], about["eval/steps"]) == (0.7, 13)


ON_POLICY = {
    "learner": PPOConfig(hidden_sizes=(16,), batch_size=8),
    "learning_starts": 0,
    "buffer_size": TrainingConfig.buffer_size,
}


@pytest.mark.parametrize("options", [{}, ON_POLICY], ids=["droq", "ppo"])
def test_reward_terms_of_ones_own_are_gathered_and_evaluated(options, tmp_path):
    config = replace(CONFIG, **options)
    terms = {"seven": lambda outcome: np.full(len(outcome.ctrl), 7.0)}
    metrics = cadenza.train(SONG, tmp_path, config, reward_terms=terms).metrics
    assert metrics["eval/reward/seven"] == 7 * metrics["eval/steps"] > 0
    assert metrics["episodes/return"] > metrics["eval/reward/seven"] / 2  # others are penalties
    with pytest.raises(CadenzaError, match="reward terms seven and cannot be resumed"):
        RunFolder(tmp_path).settings()


def test_figures_come_at_their_interval(undisturbed):
    rows = [row for row in undisturbed("in turn").metrics.rows() if "eval_step" not in row]
    assert [row["step"] for row in rows] == [40, 80, 120, 160, 200]
    # 48 steps at random, then two updates with every eight steps.
    assert [row["updates"] for row in rows] == [2 * max(row["step"] - 48, 0) // 8 for row in rows]
    assert all(np.isfinite(row["train/critic_loss"]) for row in rows[1:])
    assert 0 <= rows[-1]["episodes/note_onset_f1"] <= 1
    assert 0 <= rows[-1]["episodes/f1"] <= 1


def test_a_figure_that_no_update_has_had_is_left_out(runs):
    """The actor waits for more updates than there are between two rows."""
    run = runs()
    train(replace(CONFIG, learner=replace(TINY, policy_delay=1000)), run)
    rows = figures(run)
    assert "train/actor_loss" in rows[1]
    assert "train/actor_loss" not in rows[-1]
    assert np.isfinite(rows[-1]["train/critic_loss"])


def test_a_policy_that_diverges_is_not_kept(runs):
    run = runs()
    wild = replace(TINY, actor_learning_rate=1e38, critic_learning_rate=1e38)
    with pytest.raises(CadenzaError, match="no longer finite; start a new run with smaller"):
        train(replace(CONFIG, learner=wild, checkpoint_interval=0), run)
    weights = load_policy(run.path / "last").policy.state()[1]
    assert all(np.isfinite(array).all() for array in weights.values())


def test_keys_can_be_learnt_to_move_by_themselves(runs):
    """There is no forearm whose range could be the song's."""
    run = runs()
    train(replace(CONFIG, scene=SceneConfig(hands="none"), song_range=True, num_steps=64), run)
    assert load_policy(run.path / "best").ranges is None
    assert evaluations(run)[-1]["eval/steps"] > 0


# Interrupted


@pytest.mark.parametrize(
    ("way", "stops"),
    [
        ("in turn", [0, 3, 5, 1, 9]),
        ("parallel", [7, 1, 0, 11, 2]),
        ("residual", [4, 13]),
        ("stretched", [8, 9]),
    ],
)
def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(way, stops, runs, undisturbed):
    """It stops before anything, among random actions, at an evaluation, and twice at once."""
    stopped = runs()
    train(WAYS[way], stopped, stops=stops)
    assert_same_runs(stopped, undisturbed(way))


@pytest.mark.parametrize("way", [pytest.param("in turn", marks=pytest.mark.slow), "parallel"])
def test_checkpoints_on_the_way_change_nothing(way, runs, undisturbed):
    """One after every round, the last of them right before the end's."""
    often = runs()
    train(replace(WAYS[way], checkpoint_interval=0.0), often, stops=[13])
    assert_same_runs(often, undisturbed(way))
    # And from the one at the end all experience is there.
    longer, other = replace(WAYS[way], num_steps=WAYS[way].num_steps + 40), runs()
    shutil.copytree(undisturbed(way).path, other.path, dirs_exist_ok=True)
    for run in (often, other):
        train(longer, run)
    assert_same_runs(often, other)


class Killed(BaseException):
    """Nothing catches it for good."""


@contextmanager
def killed_after(calls: int) -> Iterator[list[str]]:
    """Let all changes of the disk but the first ones fail, also those that clean up.

    Yields the names of the calls.
    """
    made: list[str] = []

    def mortal(owner: Any, name: str) -> Callable[..., Any]:
        real = getattr(owner, name)

        def call(*args: Any, **options: Any) -> Any:
            if len(made) >= calls:
                raise Killed
            made.append(name)
            return real(*args, **options)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in ("fsync", "replace", "rename"):
            patch.setattr(os, name, mortal(os, name))
        patch.setattr(shutil, "rmtree", mortal(shutil, "rmtree"))
        patch.setattr(Path, "unlink", mortal(Path, "unlink"))
        yield made


@pytest.mark.parametrize("way", ["in turn", pytest.param("residual", marks=pytest.mark.slow)])
def test_a_run_that_is_killed_at_any_write_of_its_end_goes_on(way, runs, undisturbed):
    """The last evaluation, the best policy, the last checkpoint, what it drops, the last policy."""
    begun = runs()
    with closing(Training(problem_of(WAYS[way], [SONG]), begun)) as one:
        one.run(lambda: one.step < 176)
    for calls in count():
        killed = runs()
        shutil.copytree(begun.path, killed.path, dirs_exist_ok=True)
        with killed_after(calls) as made:
            try:
                train(WAYS[way], killed)
            except Killed:
                pass
            else:
                break
        train(WAYS[way], killed)
        assert_same_runs(killed, undisturbed(way))
    assert made.count("replace") >= 4  # experience, a checkpoint, the best policy and the last


def test_a_run_that_goes_on_to_another_end_learns_as_if_begun_with_it(runs, undisturbed):
    run = runs()
    train(replace(CONFIG, num_steps=104), run)
    train(CONFIG, run)
    arrays, expected = checkpoint(run)[0], checkpoint(undisturbed("in turn"))[0]
    assert arrays.keys() == expected.keys()
    for name, array in arrays.items():
        assert_array_equal(array, expected[name], err_msg=name)


def test_a_run_that_is_to_end_where_it_is_has_a_best_policy(runs):
    """This also holds if it has not been evaluated before."""
    run = runs()
    with closing(Training(problem_of(CONFIG, [SONG]), run)) as one:
        one.run(lambda: one.step < 8)
    assert not (run.path / "best").exists()
    train(replace(CONFIG, num_steps=one.step), run)
    assert load_policy(run.path / "best").score == SONG
    assert [row["eval_step"] for row in run.metrics.rows() if "eval_step" in row] == [one.step]


@pytest.mark.parametrize("damage", ["gone", "changed"])
def test_a_best_policy_that_is_lost_is_made_up_for(damage, runs, capsys):
    """The best of the evaluations to come makes up for it."""
    run = runs()
    with closing(Training(problem_of(CONFIG, [SONG]), run)) as one:
        one.run(lambda: one.step < 100)
        one.best["eval/f1"] = 2.0  # none is better
        one.run(lambda: one.step < 120)
    assert one.best["eval/f1"] == 2.0
    if damage == "gone":
        shutil.rmtree(run.path / "best")
    else:
        (run.path / "best" / "policy.safetensors").write_text("{}")
    train(CONFIG, run)
    assert str(run.path / "best") in capsys.readouterr().err
    about = remarks_on(run.path / "best")
    assert about["eval_step"] > 120


def test_a_full_disk_ends_a_run_with_what_to_do(runs, undisturbed, monkeypatch):
    """Whatever finds no room: figures, the best policy, a checkpoint, the last policy."""
    run, room = runs(), 0

    def nearly_full(_: int) -> None:
        nonlocal room
        room -= 1
        if room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    failed = []
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", nearly_full)
        for files in range(20):
            room = files
            try:
                train(replace(CONFIG, num_steps=64), run)
            except CadenzaError as error:
                failed.append(str(error).removeprefix(str(run.path)))
            else:
                break
    assert all("could not be written (No space left on device" in message for message in failed)
    assert {message.partition(":")[0] for message in failed} == {"", "/best", "/last"}
    assert len(failed) > 4  # two rows, the best policy, experience, a checkpoint, ...
    train(CONFIG, run)
    assert_same_runs(run, undisturbed("in turn"))


# Killed

PROGRAM = """
import sys
from contextlib import closing
from pathlib import Path
from cadenza.learning.problem import problem_of
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import Training
run = RunFolder(Path(sys.argv[1]))
config, score = run.settings()
with run.locked(), closing(Training(problem_of(config, score), run)) as training:
    print("begins", training.step, flush=True)
    training.run(lambda: True)
"""


def started(run: RunFolder) -> subprocess.Popen[str]:
    """The process, once it has begun to train."""
    command = [sys.executable, "-c", PROGRAM, str(run.path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().startswith("begins")
    return process


@pytest.mark.slow
@pytest.mark.parametrize("way", ["in turn", "residual"])
def test_a_run_that_is_killed_at_any_moment_goes_on(way, runs):
    """SIGKILL at random times, while there is a checkpoint at every round."""
    uninterrupted, killed = runs(), runs()
    config = replace(WAYS[way], num_steps=480, checkpoint_interval=0.0)
    for run in (uninterrupted, killed):
        run.begin(config, [SONG])
    process, began = started(uninterrupted), time.monotonic()
    assert process.wait() == 0
    longest = (time.monotonic() - began) / 6  # of which some went into compiling
    rng, kills, code = random.Random(0), 0, None
    while code != 0:
        process = started(killed)
        timer = threading.Timer(rng.uniform(0, longest), process.kill)
        timer.start()
        code = process.wait()
        timer.cancel()
        assert code in (0, -signal.SIGKILL)
        kills += code != 0
        longest *= 1.2
    assert kills > 2
    assert_same_runs(killed, uninterrupted)
