"""Makes demonstrations in this process, without search."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from cadenza.agents.planner.config import PlannerConfig
from cadenza.evaluation.collecting.collect import Demonstrator, EpisodeJob, episodes, record
from cadenza.evaluation.collecting.variation import Variation, collecting_task
from cadenza.evaluation.results import RUNS
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.midi import write_midi
from cadenza.music.libraries.library import open_library
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.scene.config import SceneConfig

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
    found = []
    for job in jobs(folder, variation, episodes, least_f1, scene, **task):
        found.append(folder / RUNS / job.spec.name)
        record(job, found[-1], num_threads=1)
    return found
