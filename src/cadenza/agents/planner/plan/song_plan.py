"""The plan of a song: its fingers, its goals, and the nominal trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planner.plan.nominal_trajectory import NominalTrajectory, nominal_plans
from cadenza.errors import CadenzaError
from cadenza.music.goals import Goals
from cadenza.scene.scene import Scene, build_scene
from cadenza.tasks.goal_track import GoalTrack


class SongPlan(NamedTuple):
    """The plan of a song for the hands of a scene, as far as it goes."""

    scene: Scene
    """The hands and the keys."""
    track: GoalTrack
    """The song, with the fingers that play it."""
    goals: Goals
    """Goals of the whole track."""
    nominal: NominalTrajectory
    """The trajectory of the first steps."""

    @property
    def complete(self) -> bool:
        """Whether all steps have been planned."""
        return self.nominal.num_steps == self.goals.num_steps


def plan_song(
    track: GoalTrack,
    start: Array,
    progress: Progress = silent,
    later: NDArray[np.integer] | int = 0,
    haste: float = 1.0,
) -> SongPlan:
    """The plan of the whole song: the last of `song_plans`."""
    *_, whole = song_plans(track, start, progress, later, haste)
    return whole


def song_plans(
    track: GoalTrack,
    start: Array,
    progress: Progress = silent,
    later: NDArray[np.integer] | int = 0,
    haste: float = 1.0,
) -> Iterator[SongPlan]:
    """Plans what the hands of a task are to play.

    Args:
        track: what is to be played.
        start: (J,) joint positions of the hands where the song begins [m, rad].
        progress: is told of "fingers" and "postures".
        later: (T, H) by how many steps later than usual a hand lets go to be in time for what it
            presses in each step, or for all.
        haste: times the acceleration with which the hands are known to jump.

    Yields:
        The plan as far as it goes, every time a few more seconds of music; the last one is the
        whole.

    Raises:
        CadenzaError: there are no hands in the scene.
    """
    scene = scene_planned_with(track)
    track = track.fingered(partial(progress, "fingers"))
    goals, dt = track.goals, track.config.control_timestep
    asked = goals.keys, goals.fingers
    for nominal in nominal_plans(scene, *asked, start, dt, progress, later, haste):
        yield SongPlan(scene, track, goals, nominal)


def scene_planned_with(track: GoalTrack) -> Scene:
    """The scene that a task's configuration describes: if the task's was changed, no plan knows.

    It is the same object for the same task, and nobody changes it.

    Raises:
        CadenzaError: there are no hands in it.
    """
    if not track.scene.sides:
        raise CadenzaError(
            "cannot plan: this scene has no hands; choose some, or an agent that needs none "
            "(zero, random)"
        )
    return _as_described(track.scene)


@lru_cache(maxsize=8)  # the same plan asks more than once, and other songs of the task do, too
def _as_described(scene: Scene) -> Scene:
    return build_scene(scene.config)
