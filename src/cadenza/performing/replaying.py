"""Replays of episodes that were recorded in a folder of demonstrations."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, replace

import numpy as np

from cadenza.agents.agent import Progress, silent
from cadenza.agents.playback import Playback
from cadenza.demonstrations.recorded_episode import (
    MAKE_AGAIN,
    RESULT,
    STEPS,
    RecordedEpisode,
    played_actions,
)
from cadenza.errors import CadenzaError
from cadenza.performing.performance import Performance, perform
from cadenza.performing.setup import Setup
from cadenza.scene.scene import Scene
from cadenza.tasks.piano_task import PianoTask


@contextmanager
def task_of(recorded: RecordedEpisode, scene: Scene) -> Iterator[PianoTask]:
    """Yield the task of an episode in its `scene`, with the hands where they began.

    Raises CadenzaError if they cannot begin there, or a file is not as it was written.
    """
    recorded.check_files((STEPS,))
    start = np.array(recorded.facts.start)
    if len(start) != len(scene.hand_joint_names) or not np.isfinite(start).all():
        raise CadenzaError(
            f"{recorded.folder / RESULT}: start is not that of {len(scene.hand_joint_names)} "
            f"joints; {MAKE_AGAIN}"
        )
    recorded.goals(scene)  # or says that the score is shorter than the episode
    # Fingers are those of the score; looking for others would take longer than playing.
    config = replace(recorded.facts.task, fingering="off")
    with closing(PianoTask([recorded.score], config, replace(scene, hand_start=start))) as task:
        yield task


def replay_episode(recorded: RecordedEpisode, progress: Progress = silent) -> Performance:
    """Play a recorded episode again, with the noise that it was recorded with."""
    facts = recorded.facts
    scene = recorded.build_scene()
    with task_of(recorded, scene) as task:
        settings = {
            "song": facts.song,
            "agent": facts.job["agent"],
            "seed": facts.job["seed"],
            "plan": None,
            "arrangement": facts.job["arrangement"],
            "task": asdict(facts.task),
            "scene": asdict(facts.scene),
            "drawn": facts.drawn,
        }
        player = Playback(played_actions(recorded.steps, scene))
        setup = Setup(recorded.score, player, task, 0, settings, {})
        return perform(setup, progress)
