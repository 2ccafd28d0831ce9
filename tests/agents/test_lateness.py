"""Agents that know that they are late: they play early, for the state that they will act in."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from begun import begun
from cadenza import CadenzaError, DomainRandomization, Note, Score, TaskConfig
from cadenza.agents.generalist.generalist import Generalist
from cadenza.agents.lateness import Lateness, StateEstimator, earlier
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import play_episode
from cadenza.scene.scene import Scene
from cadenza.tasks.piano_task import PianoTask

# Bars of one hand, in which a step of delay is a miss.
TUNE = Score(
    tuple(Note(0.4 * k, 0.4 * k + 0.3, pitch) for k, pitch in enumerate((60, 62, 64, 65, 67, 64))),
    title="A tune",
)


def task_of(scene: Scene, **options: Any) -> PianoTask:
    config = TaskConfig(randomization=DomainRandomization(**options))
    return begun(PianoTask([TUNE], config, scene))


def actions(task: PianoTask, steps: int) -> np.ndarray:
    rng, low, high = np.random.default_rng(3), task.spec.action_low, task.spec.action_high
    return (low + high) / 2 + 0.2 * rng.uniform(-1, 1, (steps, len(low))) * (high - low)


def estimated(task: PianoTask, late: Lateness) -> tuple[np.ndarray, np.ndarray]:
    """What an estimator says at each step of where the joints will be, and what sensors say."""
    estimator = StateEstimator(task.scene, 0.05, late, task.sensed)
    there, seen = [], []
    for ctrl in actions(task, 10):
        there.append(estimator.estimate(task.sensed).hand_qpos[0].copy())
        seen.append(task.sensed.hand_qpos[0].copy())
        estimator.send(ctrl[:-1])
        task.step(ctrl[None])
    return np.array(there), np.array(seen)


@pytest.mark.parametrize(
    ("acting", "sensing"), [(0.05, 0.0), (0.1, 0.05), (0.035, 0.02), (0.0, 0.03)]
)
def test_the_state_is_that_in_which_an_action_arrives(scene, acting, sensing):
    """It is where a robot that is not late would have been with the same actions."""
    task = task_of(scene, latency=(acting,) * 2, observation_latency=(sensing,) * 2)
    there, _ = estimated(task, Lateness(acting, sensing, (0.0, 0.0, 0.0)))
    prompt = task_of(scene)
    for k, ctrl in enumerate(actions(prompt, 10)):
        assert_allclose(there[k], prompt.state.hand_qpos[0], atol=2e-3 if acting else 1e-4)
        prompt.step(ctrl[None])


def test_noise_is_filtered_and_a_robot_that_differs_is_followed(scene):
    task = task_of(scene, joint_noise=0.03, servo_gain=(0.8, 0.8))
    estimator = StateEstimator(scene, 0.05, Lateness(0.0, 0.0, (0.03, 0.0, 0.0)), task.sensed)
    off, noise = [], []
    for ctrl in actions(task, 12):
        off.append(estimator.estimate(task.sensed).hand_qpos[0] - task.state.hand_qpos[0])
        noise.append(task.sensed.hand_qpos[0] - task.state.hand_qpos[0])
        estimator.send(ctrl[:-1])
        task.step(ctrl[None])
    assert np.std(off[4:]) < 0.75 * np.std(noise[4:])


@pytest.mark.parametrize("seconds", [0.05, 0.1, 0.02])
def test_a_song_begins_earlier_with_the_same_fingers(scene, seconds):
    (track,) = PianoTask([TUNE], None, scene).tracks
    moved = earlier(track, seconds)
    starts = [[n.start for n in each.delayed_score.notes] for each in (track, moved)]
    assert_allclose(np.subtract(*starts), seconds)
    assert [n.finger for n in moved.score.notes] == [n.finger for n in track.score.notes]


def test_a_song_that_begins_too_early_is_refused(scene):
    config = TaskConfig(
        initial_buffer_time=0.1, randomization=DomainRandomization(latency=(0.2, 0.2))
    )
    with pytest.raises(
        CadenzaError, match=r"actions arrive 0.2 s late.*initial_buffer_time of 0.2"
    ):
        play_episode(PianoTask([TUNE], config, scene), Planner())


@pytest.mark.parametrize("agent", [Planner, Generalist])
def test_a_known_delay_of_a_step_costs_nearly_nothing(scene, agent):
    late = task_of(scene, latency=(0.05, 0.05))
    results = [play_episode(task, agent()).metrics for task in (task_of(scene), late)]
    for name, most in (("f1", 0.02), ("note_onset_f1", 0.05)):
        assert results[1][name] >= results[0][name] - most


def test_who_is_not_late_plays_as_ever(scene):
    played = [
        play_episode(task, Planner()).episode["action"]
        for task in (task_of(scene), task_of(scene, mass=(1.0, 1.0), seed=3))
    ]
    assert_array_equal(*played)
