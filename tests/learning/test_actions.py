"""The performance that a residual policy corrects, against the planner, whose it is."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import melody

from begun import begun
from cadenza.agents.agent import Agent
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.errors import CadenzaError
from cadenza.learning.actions import ActionMapping, Reference, reference_of
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View

SONG = melody(60, 64, 67, 55, length=0.4, pedal=True)
BUFFER = {"initial_buffer_time": 0.5}


class Following(Agent):
    """A policy with the same correction of the plan at every step."""

    def __init__(self, correction: float = 0.0) -> None:
        self.correction = correction

    def act(self, view: View) -> Any:
        if view.steps[0] == 0:
            self.mapping = ActionMapping(view.task, self.reference)
        correction = np.full((1, view.task.action_size), self.correction, np.float32)
        return self.mapping.ctrl(correction, view.steps, view.state, view.goal[:, 0, -1])


@cache
def reference(**options: Any) -> Reference:
    """What the planner plays of the song; it takes long."""
    scene = SceneConfig(hands=options.pop("hands", "both"))
    return reference_of(PianoTask([SONG], TaskConfig(**BUFFER, **options), scene))


def performance(agent: Any, score: Score = SONG, **options: Any) -> EpisodeResult:
    if isinstance(agent, Following):
        agent.reference = reference(**options)
    scene = SceneConfig(hands=options.pop("hands", "both"))
    task = PianoTask([score], TaskConfig(**BUFFER, **options), scene)
    return play_episode(task, agent)


@pytest.mark.parametrize("options", [{}, {"fingering": "off"}, {"hands": "left"}])
def test_without_corrections_it_plays_what_the_planner_plays(options):
    """This also holds where the task ignores fingers and the score names none."""
    ours, planner = performance(Following(), **options), performance(Planner(), **options)
    for name in ("action", "hand_qpos"):
        assert_allclose(ours.episode.arrays[name], planner.episode.arrays[name], atol=1e-9)
    assert ours.metrics["f1"] == planner.metrics["f1"] > 0.9
    assert ours.metrics["sustain_f1"] == 1


def test_with_an_effort_it_plays_what_was_practised():
    ours = Following()
    ours.reference = reference_of(PianoTask([SONG], TaskConfig(**BUFFER)), effort=0.1)
    actions = [
        play_episode(PianoTask([SONG], TaskConfig(**BUFFER)), agent).episode.arrays["action"]
        for agent in (ours, Planner(PlannerConfig(effort=0.1)), Planner())
    ]
    assert_allclose(actions[0], actions[1], atol=1e-9)
    assert np.abs(actions[0] - actions[2]).max() > 1e-3


def test_where_robots_are_late_it_plays_as_much_earlier():
    """Feedback expects the states that late sensors measure."""
    late = DomainRandomization(latency=(0.03, 0.03), observation_latency=(0.01, 0.01))
    played = performance(Following(), randomization=late)
    assert played.metrics["note_onset_f1"] == 1
    assert abs(played.metrics["onset_delay"]) < 0.01
    assert len(played.episode.arrays["action"]) == len(reference(randomization=late).ctrl)


def test_it_begins_where_the_hands_do():
    """The start is not where all joints are at zero, as they are before the first reset."""
    task = PianoTask([SONG], TaskConfig(**BUFFER), SceneConfig(hand="allegro", hands="right"))
    expected = reference_of(task).expected
    task.reset([np.random.default_rng(0)], [0])
    begins = task.state.hand_qpos[0] @ servos_of(task.scene).of_joints
    assert np.abs(begins).max() > 1
    assert_allclose(expected[0, :, 0], begins, atol=1e-6)


def test_corrections_move_the_hands_within_their_reach_and_never_the_pedal():
    task = begun(PianoTask([SONG], TaskConfig(**BUFFER)))
    mapping = ActionMapping(task.spec, reference())
    plain, moved = (
        mapping.ctrl(
            np.full((1, task.spec.action_size), c, np.float32),
            np.zeros(1, int),
            task.state,
            np.zeros(1, bool),
        )[0]
        for c in (0.0, 1.0)
    )
    change = moved - plain
    assert change[-1] == 0
    assert (change[:-1] >= 0).all()
    assert (change[:-1] > 0).mean() > 0.8  # the others were at the end of their range
    assert (change[:-1] < 0.05).all()  # [m, rad]
    for name, by in zip(task.scene.actuator_names, change, strict=False):
        if name.endswith("forearm_tx"):
            assert_allclose(by, 0.003)
    moved = performance(Following(1.0)).metrics
    assert moved["sustain_f1"] == 1
    assert moved["velocity_error"] > performance(Following()).metrics["velocity_error"]


@pytest.mark.parametrize("rewarded", [False, True])
def test_the_pedal_is_as_written_unless_it_is_rewarded(rewarded):
    spec = PianoTask([SONG], TaskConfig(sustain_term=rewarded)).spec
    action = np.array([[0.0] * (spec.action_size - 1) + [down] for down in (-1.0, 1.0)])
    written, zeros = np.array([True, False]), np.zeros(2, int)
    ctrl = ActionMapping(spec).ctrl(action, zeros, None, written)  # type: ignore[arg-type]
    assert_array_equal(ctrl[:, -1], [0.0, 1.0] if rewarded else [1.0, 0.0])
    assert_allclose(ctrl[:, :-1], spec.scale_action(action)[:, :-1])


def test_the_actions_that_are_observed_are_what_is_done_but_for_corrections():
    played = performance(Following())
    task = PianoTask([SONG], TaskConfig(**BUFFER))
    plan = task.spec.scale_action(ActionMapping(task.spec, reference()).reference)
    done = played.episode.arrays["action"]
    assert plan.shape == done.shape
    size = task.spec.action_high - task.spec.action_low
    assert np.median(np.abs(plan - done) / size) < 0.02


def test_a_plan_is_for_one_score_and_for_hands():
    for option in ({"random_stretch": 0.1}, {"random_hand_position": 0.1}):
        task = PianoTask([SONG], TaskConfig(**option))  # type: ignore[arg-type]
        with pytest.raises(CadenzaError, match=f"leave out {next(iter(option))}"):
            reference_of(task)
    task = PianoTask([SONG], scene=SceneConfig(hands="none"))
    with pytest.raises(CadenzaError, match="this scene has no hands"):
        reference_of(task)
