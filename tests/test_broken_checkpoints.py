"""Whatever is wrong with a checkpoint, the run goes on from it, or it is refused in one line."""

import functools
import shutil
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mutations
from cadenza.errors import CadenzaError
from cadenza.files import ANY, read_tensors
from cadenza.learning.algorithms import on_jax
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.config import TrainingConfig
from cadenza.learning.observation import Inputs
from cadenza.learning.problem import problem_of
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import Training
from cadenza.music.score import Note, Score
from cadenza.resumable import CHECKPOINT
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from rounds import so_often

SONG = Score((Note(0, 0.2, 60),))
CONFIG = TrainingConfig(
    learner=DroQConfig(hidden_sizes=(16,), batch_size=8),
    task=TaskConfig(initial_buffer_time=0.1),
    scene=SceneConfig(hands="right", physics="fast"),
    num_steps=64,
    num_envs=2,
    learning_starts=16,
    train_freq=4,
    eval_interval=1000,
    log_interval=20,
)


@pytest.fixture(scope="module", autouse=True)
def _compiled_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DroQConfig, "make", functools.cache(DroQConfig.make))
        yield


def go_on(path: Path, rounds: int = 2) -> int:
    """The step from which a run goes on; it does some rounds more."""
    with closing(Training(problem_of(CONFIG, [SONG]), RunFolder(path))) as run:
        first = run.step
        run.run(so_often(rounds))
    return first


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """With two files of experience."""
    path = tmp_path_factory.mktemp("run")
    go_on(path, 3)
    go_on(path, 2)
    return path


@pytest.fixture
def copy(begun, tmp_path):
    return Path(shutil.copytree(begun, tmp_path / "copy"))


def change(rng: np.random.Generator, run: Path) -> None:
    """Something in its checkpoint or experience, mostly with a digest that is right."""
    checkpoint, chunk = run / CHECKPOINT, max((run / "replay").iterdir())
    match rng.integers(4):
        case 0 | 1:
            checkpoint.write_bytes(mutations.other_tensors(rng, checkpoint))
        case 2:
            with np.load(chunk) as file:
                changed = mutations.other_arrays(rng, dict(file))
            chunk.write_bytes(mutations.npz_bytes(changed))
        case _:
            chunk.write_bytes(mutations.other_bytes(rng, chunk.read_bytes()))


@pytest.mark.parametrize("number", [3, pytest.param(200, marks=pytest.mark.slow)])
def test_goes_on_or_says_what_is_wrong(number, begun, tmp_path):
    for seed in range(number):
        run = tmp_path / str(seed)
        shutil.copytree(begun, run)
        change(np.random.default_rng(seed), run)
        with mutations.at_most_refused():
            assert go_on(run) == 40


@pytest.mark.parametrize("lost", ["checkpoint.safetensors", "replay/000000000024.0.npz"])
@pytest.mark.parametrize("keep", [0, 0.5, None])
def test_what_is_cut_off_or_missing_is_refused_in_a_line(copy, lost, keep):
    """Without its checkpoint, a run begins anew."""
    path = copy / lost
    if keep is None:
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
    if keep is None and lost == CHECKPOINT:
        assert go_on(copy) == 0
        return
    with pytest.raises(CadenzaError, match=path.name) as error:
        go_on(copy)
    assert "\n" not in str(error.value)


def test_another_end_and_since_when_it_holds_is_kept(copy, monkeypatch):
    """Learning rates that fall know where they are: the learner is told all ends of the run."""
    longer = replace(CONFIG, num_steps=128)
    with closing(Training(problem_of(longer, [SONG]), RunFolder(copy))) as run:
        run.run(lambda: run.step < 80)
    calls, make = list[object](), DroQConfig.make
    monkeypatch.setattr(DroQConfig, "make", lambda *given: calls.append(given[-1]) or make(*given))
    with closing(Training(problem_of(longer, [SONG]), RunFolder(copy))):
        pass
    assert calls == [tuple(tuple(map(longer.updates_by, end)) for end in ((0, 64), (40, 128)))]


def test_a_run_whose_learner_has_other_threads_says_so(copy, monkeypatch, capsys):
    """Its bits are not those of other runs with the same seed."""
    make = DroQConfig.make.__wrapped__  # type: ignore[attr-defined]
    for threads, count in ((2, 0), (None, 0), (7, 1)):
        monkeypatch.setattr(on_jax, "_num_threads", lambda threads=threads: threads)
        assert make(CONFIG.learner, Inputs((0, 1), 2), 1).num_threads == threads
        assert capsys.readouterr().err.count("JAX was started before this run with 7") == count
    monkeypatch.setattr(DroQConfig, "make", make)
    go_on(copy, 1)
    assert read_tensors(copy / CHECKPOINT, ANY, 2**28)[1]["own"]["threads"] == 7
