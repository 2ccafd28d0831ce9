"""What the version before has written is still read; its options are still taken."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from rl_examples import melody

from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaWarning
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.config import TrainingConfig
from cadenza.learning.policy_folder import load_policy
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import Training
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

# A run of 48 steps that was stopped after 32 of them.
RUN = Path(__file__).parents[1] / "data" / "older_run.zip"
CONFIG = TrainingConfig(
    learner=DroQConfig(
        hidden_sizes=(4,),
        batch_size=4,
        actor_ema=0.5,
        policy_delay=2,
        final_learning_rate_fraction=0.5,
    ),
    task=TaskConfig(n_steps_lookahead=0),
    scene=SceneConfig(hands="right", physics="fast"),
    num_steps=48,
    learning_starts=16,
    train_freq=4,
    gradient_steps=2,
    buffer_size=1000,
    prune_inputs=True,
    eval_interval=20,
    log_interval=8,
)


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    shutil.unpack_archive(RUN, tmp_path / "run")
    return RunFolder(tmp_path / "run")


@pytest.fixture(scope="module", autouse=True)
def _compiled_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(DroQConfig, "make", functools.cache(DroQConfig.make))
        yield


def test_a_run_goes_on(run: RunFolder, capsys: pytest.CaptureFixture[str]) -> None:
    config, score = run.settings()
    assert (config, score) == (CONFIG, melody(60, 64))
    with closing(Training(config, score, run)) as training:
        assert training.step == 32
        assert len(training._replay) == 32
        training.run(lambda: True)
    assert "begun by an older version; this version continues it" in capsys.readouterr().err
    assert [row["updates"] for row in run.rows() if "updates" in row] == [0, 0, 4, 8, 12, 16]
    with closing(Training(config, score, run)) as training:
        assert (training.step, len(training._replay)) == (48, 48)
    assert capsys.readouterr().err == ""  # it is of this version now


def test_another_end_is_written_in_the_names_of_this_version(run: RunFolder) -> None:
    run.set_end(replace(CONFIG, num_steps=64))
    text = (run.path / "run.json").read_text()
    assert "seed_steps" not in text
    assert run.settings()[0] == replace(CONFIG, num_steps=64)


def test_its_policy_plays(run: RunFolder) -> None:
    best = max(row["eval/f1"] for row in run.rows() if "eval/f1" in row)
    with pytest.warns(CadenzaWarning, match="older version"):
        learnt = load_policy(run.path / "best")
    with closing(PianoTask([learnt.score], learnt.task, learnt.scene)) as task:
        assert play_episode(task, learnt.agent).metrics["f1"] == best
