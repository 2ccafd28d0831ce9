"""Makes demonstrations in this process, without search."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.demonstrations.recorded_episode import RecordedEpisode, played_actions
from cadenza.evaluation.collecting.collect import Demonstrator, EpisodeJob, episodes, record
from cadenza.evaluation.collecting.variation import Variation, collecting_task
from cadenza.evaluation.results import RUNS
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.library import open_library
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.performing.replaying import task_of
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene
from cadenza.tasks.reward import key_state

NOTES = ((0.0, 0.4, 60), (0.2, 0.6, 52), (0.6, 1.0, 64), (0.6, 1.0, 55))
SCORE = Score(tuple(Note(*note) for note in NOTES), (PedalEvent(0.3, 127),))


def jobs(
    folder: Path,
    variation: Variation,
    count: int,
    least_f1: float = 0.0,
    scene: SceneConfig | None = None,
    **task: Any,
) -> list[EpisodeJob]:
    """Episodes of the songs that lie beside the folder, one if there are none."""
    songs = folder.parent / f"{folder.name}-songs"
    if not songs.exists():
        write_midi(SCORE, songs / "song.mid")
    who = demonstrator(variation, scene, **task)
    return episodes(open_library(songs), who, range(count), least_f1)


VARIED = {"random_stretch": 0.2, "random_pitch_shift": 3}


def demonstrator(
    variation: Variation, scene: SceneConfig | None = None, **task: Any
) -> Demonstrator:
    return Demonstrator(
        agent="planner",
        config=PlannerConfig(method="none"),
        task=replace(collecting_task(), **(VARIED | task)),
        scene=scene or SceneConfig(),
        arrangement=Arrangement(),
        variation=variation,
    )


def collected(
    folder: Path,
    variation: Variation,
    episodes: int = 1,
    least_f1: float = 0.0,
    scene: SceneConfig | None = None,
    **task: Any,
) -> list[Path]:
    """The folders of the episodes."""
    recorded = []
    for job in jobs(folder, variation, episodes, least_f1, scene, **task):
        recorded.append(folder / RUNS / job.spec.name)
        record(job, recorded[-1], num_threads=1)
    return recorded


def differences(recorded: RecordedEpisode, scene: Scene) -> set[str]:
    """The arrays that are not the same to the bit when an episode is played again."""
    with task_of(recorded, scene) as task:
        result = play_episode(task, Playback(played_actions(recorded.steps, scene)))
    assert result.episode.num_steps == recorded.facts.num_steps
    seen = {**result.episode.arrays}
    seen["key_state"] = key_state(result.episode["key_qpos"], scene.keyboard.travel)
    return {
        name
        for name in ("hand_qpos", "hand_qvel", "fingertip_xpos", "key_state")
        if (seen[name].astype(recorded.steps[name].dtype) != recorded.steps[name][1:]).any()
    } | ({"f1"} if result.metrics["f1"] != recorded.facts.f1 else set())
