"""What all that plan a song begin with: its fingers, its goals, and the nominal plan."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planning.nominal import Nominal, nominal_plans
from cadenza.errors import CadenzaError
from cadenza.fingering.search import Dropped, find_fingering
from cadenza.music.goals import Goals
from cadenza.music.score import Score
from cadenza.scene.scene import Scene, build_scene
from cadenza.tasks.music import goals_of, players_of
from cadenza.tasks.view import TaskSpec


class SongPlan(NamedTuple):
    """How the hands of a scene are to play a song, as far as that has been planned."""

    scene: Scene
    """The hands and the keys."""
    score: Score
    """With the fingers that play it."""
    dropped: tuple[Dropped, ...]
    """Notes that no finger is there for."""
    goals: Goals
    """That score per control step, all of it."""
    nominal: Nominal
    """Of the first steps."""

    @property
    def complete(self) -> bool:
        """Whether all steps have been planned."""
        return self.nominal.num_steps == self.goals.num_steps


def plan_song(task: TaskSpec, score: Score, start: Array, progress: Progress = silent) -> SongPlan:
    """The last of `song_plans`: all of the song."""
    *_, whole = song_plans(task, score, start, progress)
    return whole


def song_plans(
    task: TaskSpec, score: Score, start: Array, progress: Progress = silent
) -> Iterator[SongPlan]:
    """Plans `score` for the hands of a task.

    The scene that is planned with is the one that the task's configuration describes: where the
    task's own was changed, the plan does not know.

    Args:
        task: what is played in.
        score: as the task plays it.
        start: (J,) joint positions of the hands where the song begins [m, rad].
        progress: is told of "fingers" and "postures".

    Yields:
        The plan as far as it goes, every time a few more seconds of music; the last one is the
        whole.

    Raises:
        CadenzaError: there are no hands in the scene.
    """
    if not task.scene.sides:
        raise CadenzaError("cannot plan: this scene has no hands")
    score, dropped = find_fingering(score, players_of(task.scene), partial(progress, "fingers"))
    goals = goals_of(score, task.config, task.scene.keyboard)
    scene, dt = build_scene(task.scene.config), task.config.control_timestep
    for nominal in nominal_plans(scene, goals.keys, goals.fingers, start, dt, progress):
        yield SongPlan(scene, score, dropped, goals, nominal)
