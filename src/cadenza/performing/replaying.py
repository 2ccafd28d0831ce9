"""Replays an episode that was recorded in a folder of demonstrations."""

from dataclasses import asdict

from cadenza.agents.agent import Progress, silent
from cadenza.agents.playback import Playback
from cadenza.demonstrations.recorded_episode import RecordedEpisode, played_actions
from cadenza.demonstrations.replay import task_of
from cadenza.performing.performance import Performance, perform
from cadenza.performing.setup import Setup


def replay_episode(recorded: RecordedEpisode, progress: Progress = silent) -> Performance:
    """Play a recorded episode again, with the noise that it was recorded with."""
    about = recorded.facts
    scene = recorded.build_scene()
    with task_of(recorded, scene) as task:
        settings = {
            "song": about.song,
            "agent": about.job["agent"],
            "seed": about.job["seed"],
            "plan": None,
            "arrangement": about.job["arrangement"],
            "task": asdict(about.task),
            "scene": asdict(about.scene),
            "drawn": about.drawn,
        }
        player = Playback(played_actions(recorded.steps, scene))
        setup = Setup(recorded.score, player, task, 0, settings, {})
        return perform(setup, progress)
