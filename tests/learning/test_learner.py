"""A learner of somebody else's: found by its name, trained, stopped, resumed and played."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from rl_examples import melody

from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.files import ANY, read_tensors, write_tensors
from cadenza.learning.learner import LearnerConfig
from cadenza.learning.policy_folder import POLICY_FILE, load_policy, save_policy
from cadenza.learning.run_folder import RunFolder
from cadenza.music.formats.midi import write_midi
from learnt import from_nothing
from refusals import refused

# Linear regression on the actions, those that were rewarded most first; in numpy alone.
PACKAGE = """
from __future__ import annotations
from dataclasses import dataclass
import numpy as np
from cadenza.learning.learner import LearnerConfig
from cadenza.learning.policy import Perceptron

@dataclass(frozen=True)
class RegressionConfig(LearnerConfig):
    step_size: float = 0.01
    \"\"\"How far each update goes.\"\"\"

    def make(self, inputs, action_size, ends):
        return Regression(self, len(inputs.kept), action_size)

class Regression:
    num_threads = None

    def __init__(self, config, inputs, actions):
        self.config, self.shape = config, (inputs, actions)

    def init(self, seed):
        return {"mean": np.random.default_rng(seed).normal(0, 0.1, self.shape).astype("f")}

    def update(self, state, batches):
        mean, losses = state["mean"].copy(), []
        for observation, action, reward, _, _ in zip(*batches):
            error = (observation @ mean - action) * np.exp(reward - reward.max())[:, None]
            mean -= np.float32(self.config.step_size / len(reward)) * (observation.T @ error)
            losses.append((error ** 2).mean())
        return {"mean": mean}, {"loss": np.array(losses)}

    def policy(self, state):
        bias = np.zeros(self.shape[1], "f")
        weights = {"mean/kernel": state["mean"], "mean/bias": bias}
        weights |= {"log_std/kernel": 0 * state["mean"], "log_std/bias": bias - 1}
        return Perceptron(weights, "relu", (-5.0, 2.0))

    behavior_policy = policy

    def to_arrays(self, state):
        return state

    def from_arrays(self, arrays):
        return arrays

# The same with a policy of its own, which is saved and read by the learner's name.

@dataclass(frozen=True)
class LinearConfig(RegressionConfig):
    def make(self, inputs, action_size, ends):
        return LinearLearner(self, len(inputs.kept), action_size)

    @classmethod
    def policy_of(cls, facts, arrays):
        if arrays["kernel"].ndim != 2:
            raise ValueError("no matrix")
        return Linear(arrays["kernel"], facts["noise"])

class LinearLearner(Regression):
    def policy(self, state):
        return Linear(state["mean"], 0.1)

    behavior_policy = policy

class Linear:
    def __init__(self, kernel, noise):
        self.kernel, self.noise = kernel, noise

    def mode(self, observation):
        return np.tanh(observation @ self.kernel)

    def sample(self, observation, rng):
        best = self.mode(observation)
        return np.clip(best + rng.normal(0, self.noise, best.shape), -1, 1)  # in float64

    def state(self):
        return {"noise": self.noise}, {"kernel": self.kernel}

@dataclass(frozen=True)
class NoLearner:
    pass
"""
OPTIONS = ["--no-video", "--num-steps", "200", "--learning-starts", "64", "--eval-interval", "100"]
OPTIONS += ["--log-interval", "50", "--train-freq", "8", "--batch-size", "16"]


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Installed, as far as Python can tell."""
    site = tmp_path / "site"
    about = site / "regression-1.0.dist-info"
    about.mkdir(parents=True)
    (site / "regression.py").write_text(PACKAGE)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: regression\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[cadenza.learners]\n"
        "regression = regression:RegressionConfig\n"
        "linear = regression:LinearConfig\n"
        "none = regression:NoLearner\n"
    )
    monkeypatch.syspath_prepend(site)
    yield site
    sys.modules.pop("regression", None)


@pytest.fixture
def tune(tmp_path):
    path = tmp_path / "tune.mid"
    write_midi(melody(60, 64, 67), path)
    return path


def newest(run: Path) -> dict[str, np.ndarray]:
    return read_tensors(run / "checkpoint.safetensors", ANY, 2**28)[0]


def test_a_learner_of_another_package_trains_resumes_and_plays(package, tune, tmp_path, capsys):
    unbroken, stopped = tmp_path / "whole", tmp_path / "stopped"
    train = ["train", str(tune), "--learner", "regression", "--step-size", "0.05", *OPTIONS]
    main([*train, "-o", str(unbroken)])
    rows = [json.loads(line) for line in (unbroken / "metrics.jsonl").read_text().splitlines()]
    losses = [row["train/loss"] for row in rows if "train/loss" in row]
    assert losses[-1] < losses[0]
    best = max(row["eval/f1"] for row in rows if "eval/f1" in row)
    assert json.loads((unbroken / "best_played" / "metrics.json").read_text())["f1"] == best
    config, _ = RunFolder(unbroken).settings()
    assert (type(config.learner).__name__, config.learner.batch_size) == ("RegressionConfig", 16)
    assert config.learner.step_size == 0.05  # type: ignore[attr-defined]

    main([*train, "-o", str(stopped), "--num-steps", "104"])
    main(["train", "--resume", str(stopped), "--num-steps", "200", "--no-video"])
    for name, array in newest(unbroken).items():
        assert_array_equal(array, newest(stopped)[name], err_msg=name)
    assert_array_equal(
        load_policy(stopped / "last").policy.weights["mean/kernel"],
        newest(unbroken)["learner:mean"],
    )
    assert "its own options" in refused(capsys, "train", "--resume", unbroken, "--step-size", 1)
    # A perceptron is read without the learner that made it.
    (package / "regression-1.0.dist-info" / "entry_points.txt").write_text("")
    main(["play", "--agent", str(unbroken / "best"), "--no-video", "-o", str(tmp_path / "out")])
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["f1"] == best


def test_a_learner_may_make_policies_of_another_kind(package, tune, tmp_path, capsys):
    unbroken = tmp_path / "whole"
    main(["train", str(tune), "--learner", "linear", *OPTIONS, "-o", str(unbroken)])
    assert type(load_policy(unbroken / "last").policy).__name__ == "Linear"
    arrays, facts = read_tensors(unbroken / "last" / POLICY_FILE, ANY, 2**28)
    assert (facts["learner"], facts["policy"]) == ("linear", {"noise": 0.1})
    assert_array_equal(arrays["policy/kernel"], newest(unbroken)["learner:mean"])

    rows = [json.loads(line) for line in (unbroken / "metrics.jsonl").read_text().splitlines()]
    best = max(row["eval/f1"] for row in rows if "eval/f1" in row)
    main(["play", "--agent", str(unbroken / "best"), "--no-video", "-o", str(tmp_path / "out")])
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["f1"] == best

    wrong = arrays | {"policy/kernel": np.zeros(3)}
    write_tensors(unbroken / "last" / POLICY_FILE, wrong, facts)
    assert f"{unbroken / 'last'}: cannot be read: ValueError: no matrix (" in refused(
        capsys, "play", "--agent", unbroken / "last"
    )
    (package / "regression-1.0.dist-info" / "entry_points.txt").write_text("")
    assert f"{unbroken / 'best'}: no learner 'linear': choose from droq, ppo, or give" in refused(
        capsys, "play", "--agent", unbroken / "best"
    )


def test_a_learner_need_not_be_installed(package, tune, tmp_path, capsys):
    (package / "regression-1.0.dist-info" / "entry_points.txt").write_text("")
    name = ["--learner", "regression:LinearConfig"]
    run, page = tmp_path / "run", tmp_path / "curves.html"
    train = ["train", str(tune), *name, *OPTIONS, "--step-size", "0.05", "-o", str(run)]
    main([*train, "--num-steps", "104"])
    assert load_policy(run / "best").learner == name[1]
    again = (
        ["train", "--resume", run, "--num-steps", "112", "--no-video"],
        ["play", "--agent", run, "--no-video", "-o", tmp_path / "out"],
        ["curves", run, "-o", page],
    )
    for command in again:
        del sys.modules["regression"]  # as in another process
        message = refused(capsys, *command)
        assert "no file makes Cadenza import a module; give --learner regression:Lin" in message
        assert "regression" not in sys.modules
        main([str(word) for word in (*command, *name)])
    assert page.exists()


def test_no_policy_has_a_module_imported(tmp_path, capsys):
    """Nobody has asked for what a module does when it is imported."""
    save_policy(tmp_path / "whole", from_nothing(melody(60, 64)), {})
    arrays, facts = read_tensors(tmp_path / "whole" / POLICY_FILE, ANY, 2**28)
    facts = {n: v for n, v in facts.items() if n not in ("activation", "log_std_range")}
    others = {"learner": "antigravity:Config", "policy": {}}
    ranges = {name: array for name, array in arrays.items() if name.startswith("ranges/")}
    write_tensors(tmp_path / "policy" / POLICY_FILE, ranges, facts | others)
    assert "learner antigravity:Config: " in refused(capsys, "play", "--agent", tmp_path / "policy")
    assert "antigravity" not in sys.modules


@pytest.mark.usefixtures("package")
def test_help_lists_the_options_of_the_learner(capsys):
    shown = {}
    for name in ("regression", "droq"):
        with pytest.raises(SystemExit):
            main(["train", "--learner", name, "--help"])
        shown[name] = " ".join(capsys.readouterr().out.split())
    assert "--step-size FLOAT How far each update goes. (default: 0.01)" in shown["regression"]
    assert "--discount" not in shown["regression"]
    assert "--step-size" not in shown["droq"]


@pytest.mark.usefixtures("package")
def test_who_is_no_learner_is_refused(tune, tmp_path, capsys):
    def said(name: str) -> str:
        return refused(capsys, "train", tune, "--learner", name, "-o", tmp_path / "run")

    assert "did you mean droq?" in said("drqo")
    assert "NoLearner is no LearnerConfig of cadenza" in said("none")
    assert "cannot import 'nowhere'" in said("nowhere:Config")
    assert not (tmp_path / "run").exists()


def test_the_options_of_every_learner_are_checked():
    for size in 0, 10**8:
        with pytest.raises(CadenzaError, match=f"batch_size {size}: choose 1 to 65536"):
            LearnerConfig(batch_size=size).check()
