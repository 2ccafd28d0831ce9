"""Tests of the presets, against what the paper and the published run script say."""

import subprocess
import sys
from dataclasses import asdict, replace

import pytest
from rl_examples import melody

from cadenza.errors import CadenzaError
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.config import TrainingConfig, check, preset
from cadenza.learning.run_folder import RunFolder
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.setups import setup_named


def test_the_defaults_of_the_learner_are_the_table_of_the_paper():
    """RoboPianist (Zakka et al., CoRL 2023), appendix: hyperparameters of DroQ."""
    config = DroQConfig()
    assert config.num_critics == 2
    assert config.hidden_sizes == (256, 256, 256)
    assert config.activation == "relu"
    assert (config.dropout, config.layer_norm) == (0.01, True)
    assert config.tau == 0.005
    assert (config.log_std_min, config.log_std_max) == (-20, 2)
    assert config.initial_temperature == 1.0
    assert config.target_entropy is None  # minus half the number of actions
    assert {
        config.actor_learning_rate, config.critic_learning_rate, config.temperature_learning_rate
    } == {3e-4}  # fmt: skip
    assert (config.adam_beta1, config.adam_beta2) == (0.9, 0.999)
    assert config.discount == 0.99
    assert config.batch_size == 256
    assert config.policy_delay == 1
    assert config.actor_ema == 1.0  # none: the actor itself is evaluated


def test_the_paper_s_preset_is_its_table():
    config = preset("paper")
    assert config.learner == DroQConfig()
    assert config.learning_starts == 5_000
    assert config.num_steps == 5_000_000
    assert config.buffer_size == 1_000_000
    assert config.eval_interval == 10_000
    # One environment, one update a step, as in the published code.
    assert (config.num_envs, config.train_freq, config.gradient_steps) == (1, 1, 1)
    assert (config.parallel, config.residual, config.song_range) == (False, False, False)
    assert config.task.n_steps_lookahead == 10
    assert config.task.control_timestep == 0.05
    assert config.task.trim_silence
    assert (config.task.repeats, config.task.onset_goals) == ("published", False)
    assert config.task.initial_buffer_time == 0
    assert (config.task.sustain_term, config.task.forearm_term) == (False, False)  # three terms
    assert config.scene.reduced_action_space
    assert config.scene.gravity_compensation
    assert config.scene.primitive_fingertips


def test_the_published_preset_differs_in_what_the_published_script_sets():
    """run.sh of robopianist-rl: discount 0.8; networks with its default activation, GELU."""
    published, paper = preset("published"), preset("paper")
    assert replace(paper, task=TaskConfig(), scene=SceneConfig()) == TrainingConfig()
    assert published.learner == replace(paper.learner, discount=0.8, activation="gelu")
    assert published.task == replace(paper.task, sustain_term=True, forearm_term=True)
    assert replace(published, learner=paper.learner, task=paper.task) == paper


def test_the_fast_preset_learns_the_default_task():
    assert (preset("fast").task, preset("fast").scene) == (TaskConfig(), SceneConfig())


def test_from_nothing_the_fast_preset_changes_rewards_only():
    from_nothing = preset("fast", residual=False)
    given, usual = asdict(from_nothing.task), asdict(TaskConfig())
    changed = {name for name in usual if given[name] != usual[name]}
    assert changed == {"key_press", "fingering_margin", "energy_coefficient"}
    published = setup_named("published")
    assert published.applied_to(from_nothing).task == published.applied_to(TrainingConfig()).task


@pytest.mark.parametrize("name", ["fast", "paper", "published"])
def test_comes_back_from_the_folder_of_a_run(name, tmp_path):
    config = replace(
        preset(name, residual=True),  # type: ignore[arg-type]
        scene=SceneConfig(forearm_dofs=("ty", "yaw")),
        task=TaskConfig(n_seconds_lookahead=1 / 3),
    )
    assert config.residual
    run = RunFolder(tmp_path)
    run.begin(config, [melody(60)])
    assert run.settings() == (config, (melody(60),))


def test_naming_the_options_does_not_load_what_learning_needs():
    """The command line shows them."""
    program = "import sys, cadenza.learning.config; print({'jax', 'mujoco'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "set()\n"


@pytest.mark.parametrize("name", ["paper", "published", "fast"])
def test_the_presets_make_sense(name):
    check(preset(name))
    check(preset(name, residual=True))


def test_a_setup_changes_the_fast_preset_only():
    """Settings of a run and of its learner."""
    otherwise = setup_named("mini-allegro").training
    fast = preset("fast", otherwise=otherwise)
    both = asdict(fast) | asdict(fast.learner)
    assert otherwise
    assert {name: both[name] for name in otherwise} == otherwise
    assert preset("paper", otherwise=otherwise) == preset("paper")
    assert preset("fast", True, otherwise=otherwise) == preset("fast", True)


@pytest.mark.parametrize(
    "options",
    [
        *({name: 0} for name in ("eval_interval", "log_interval", "train_freq")),
        *({name: 0} for name in ("gradient_steps", "num_envs", "num_steps")),
        *({name: -1} for name in ("seed", "learning_starts", "checkpoint_interval")),
    ],
)
def test_options_that_make_no_sense_are_refused_by_name(options):
    (name,) = options
    with pytest.raises(CadenzaError, match=name):
        check(TrainingConfig(**options))


@pytest.mark.parametrize(
    "options",
    [
        *({name: 0} for name in ("batch_size", "num_critics", "policy_delay")),
        *({name: 0.0} for name in ("initial_temperature", "actor_learning_rate")),
        *({"hidden_sizes": sizes} for sizes in ((), (256, 0))),
        *({"dropout": 1.0}, {"discount": float("nan")}),
    ],
)
def test_options_of_the_learner_too(options):
    (name,) = options
    with pytest.raises(CadenzaError, match=name):
        check(TrainingConfig(learner=DroQConfig(**options)))
