"""The plan of a song: its fingers, its goals, and the nominal trajectory."""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planner.plan.nominal_trajectory import Delays, MotionPlanner, NominalTrajectory
from cadenza.agents.planner.plan.strike_model import NO_STRIKES, PlannedStrikes, planned_strikes
from cadenza.errors import CadenzaError
from cadenza.music.goals import Goals
from cadenza.scene.scene import Scene, shared_scene
from cadenza.tasks.goal_track import GoalTrack


class SongPlan(NamedTuple):
    """The plan of a song, or of its first steps, for the hands of a scene."""

    scene: Scene  # the hands and the keys
    track: GoalTrack  # the song, with the fingers that play it
    goals: Goals  # goals of the whole track
    nominal: NominalTrajectory  # the trajectory of the first steps
    strikes: PlannedStrikes = NO_STRIKES  # targets of timed strikes

    @property
    def complete(self) -> bool:
        """Whether all steps have been planned."""
        return self.nominal.num_steps == self.goals.num_steps

    def ends_before(self, step: int) -> bool:
        """Whether there are steps before `step` that have not been planned yet."""
        return self.nominal.num_steps < min(step, self.goals.num_steps)


def plan_song(
    track: GoalTrack,
    start: Array,
    progress: Progress = silent,
    release_delays: Delays = 0,
    strikes: bool = False,
) -> SongPlan:
    """Plan the whole song: the last of `song_plans`."""
    *_, last = song_plans(track, start, progress, release_delays, strikes)
    return last


def song_plans(
    track: GoalTrack,
    start: Array,
    progress: Progress = silent,
    release_delays: Delays = 0,
    strikes: bool = False,
    scene: Scene | None = None,
) -> Iterator[SongPlan]:
    """Plan a song for the hands of a task.

    Raises CadenzaError if there are no hands in the scene.

    Args:
        track: the song.
        start: (J,) joint positions of the hands at the beginning [m, rad].
        progress: receives the stages "fingers" and "postures".
        release_delays: see `MotionPlanner`.
        strikes: whether strikes have the times within control steps, and the loudness, of the song;
            otherwise, only the control steps matter.
        scene: the hands to plan for, by default those of `planning_scene`.

    Yields:
        Plans that each go on for some more seconds of music; the last is of the whole song.
    """
    scene = scene or planning_scene(track)
    track = track.fingered(partial(progress, "fingers"))
    goals, dt = track.goals, track.config.control_timestep
    planned = planned_strikes(goals.onsets, scene, dt) if strikes else NO_STRIKES
    planner = MotionPlanner(scene, dt)
    for nominal in planner.plans(goals.fingers, start, progress, release_delays, planned):
        yield SongPlan(scene, track, goals, nominal, planned)


def planning_scene(track: GoalTrack) -> Scene:
    """Scene of a task's options, without the randomisation of the task's own scene.

    It is one object for the same options, and must not be changed. Raises CadenzaError if there are
    no hands in it.
    """
    if not track.scene.sides:
        raise CadenzaError(
            "cannot plan: this scene has no hands; choose some, or an agent that needs none "
            "(zero, random)"
        )
    return shared_scene(track.scene.config)
