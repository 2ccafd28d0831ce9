"""What all that plan a whole song begin with: its fingers, its goals, and the nominal plan."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planning.nominal import Nominal, nominal_plan
from cadenza.errors import CadenzaError
from cadenza.model.scene import build_scene
from cadenza.music.fingering import Dropped, find_fingering
from cadenza.music.goals import Goals
from cadenza.music.score import Score
from cadenza.tasks.music import goals_of
from cadenza.tasks.piano_task import PianoTask


class SongPlan(NamedTuple):
    """How the hands of a scene are to play a song."""

    score: Score
    """With the fingers that play it."""
    dropped: tuple[Dropped, ...]
    """Notes that no finger is there for."""
    goals: Goals
    """That score per control step."""
    nominal: Nominal


def plan_song(task: PianoTask, score: Score, progress: Progress = silent) -> SongPlan:
    """Plans `score` for the hands of a task, from where those of its first environment are.

    The scene that is planned with is the one that the task's configuration describes: where the
    task's own was changed, the plan does not know.

    Args:
        task: one that has been reset.
        score: as the task plays it.
        progress: is told of "fingers" and "postures".

    Raises:
        CadenzaError: there are no hands in the scene.
    """
    if not task.scene.sides:
        raise CadenzaError("a plan is for hands to play, and this scene has none")
    score, dropped = find_fingering(score, task.scene.sides, partial(progress, "fingers"))
    goals = goals_of(score, task.config)
    scene, dt = build_scene(task.scene.config), task.config.control_timestep
    # BLAS shares small products among threads, which takes longer, and other bits come out.
    with threadpool_limits(1):
        start = task.state.hand_qpos[0]
        nominal = nominal_plan(scene, goals.keys, goals.fingers, start, dt, progress)
    return SongPlan(score, dropped, goals, nominal)
