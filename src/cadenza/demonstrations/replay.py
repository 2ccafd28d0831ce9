"""Plays a recorded episode again, from its start and with the actions that were played."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np

from cadenza.agents.playback import Playback
from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.demonstrations.recorded_episode import (
    MAKE_AGAIN,
    RESULT,
    STEPS,
    RecordedEpisode,
    played_actions,
)
from cadenza.errors import CadenzaError
from cadenza.scene.scene import Scene
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.reward import key_state

_COMPARED = ("hand_qpos", "hand_qvel", "fingertip_xpos", "key_state")


def wrong_start(recorded: RecordedEpisode, scene: Scene) -> str | None:
    """What is wrong with the joint positions at the start; None if nothing is."""
    start, joints = recorded.facts.start, len(scene.hand_joint_names)
    if len(start) == joints and np.isfinite(start).all():
        return None
    return f"{recorded.folder / RESULT}: start is not that of {joints} joints; {MAKE_AGAIN}"


@contextmanager
def task_of(recorded: RecordedEpisode, scene: Scene) -> Iterator[PianoTask]:
    """Yield the task of an episode in its `scene`, with the hands where they began.

    Raises CadenzaError if they cannot begin there, or a file is not as it was written.
    """
    recorded.check_files((STEPS,))
    if wrong := wrong_start(recorded, scene):
        raise CadenzaError(wrong)
    begun = replace(scene, hand_start=np.array(recorded.facts.start))
    recorded.goals(scene)  # or says that the score is shorter than the episode
    # Fingers are those of the score; looking for others would take longer than playing.
    config = replace(recorded.facts.task, fingering="off")
    with closing(PianoTask([recorded.score], config, begun)) as task:
        yield task


def replayed(recorded: RecordedEpisode, scene: Scene) -> EpisodeResult:
    """Play the recorded actions again."""
    with task_of(recorded, scene) as task:
        return play_episode(task, Playback(played_actions(recorded.steps, scene)))


def differences(recorded: RecordedEpisode, scene: Scene) -> dict[str, float]:
    """The largest difference of each quantity when an episode is played again.

    Arrays are compared bit for bit, in the precision of the recording.
    """
    result, errors = replayed(recorded, scene), dict[str, float]()
    again = result.episode
    if missing := recorded.facts.num_steps - again.num_steps:
        errors["the number of steps"] = float(missing)
        return errors
    depth = key_state(again["key_qpos"], scene.keyboard.travel)
    seen = {**again.arrays, "key_state": depth}
    for name in _COMPARED:
        was = recorded.steps[name][1:]
        now = seen[name].astype(was.dtype)
        if not np.array_equal(was, now):
            errors[name] = float(np.abs(was.astype(np.float64) - now).max())
    if result.metrics["f1"] != recorded.facts.metrics["f1"]:
        errors["f1"] = abs((result.metrics["f1"] or 0.0) - recorded.facts.f1)
    return errors
