"""Short songs, and plans of them for one hand."""

import numpy as np

from begun import begun
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from numbered import finger

BUFFER = TaskConfig(initial_buffer_time=0.5)
# Under the right hand where it starts.
TUNE = Score(
    (Note(0.0, 0.3, 72, finger=finger(1)), Note(0.3, 0.6, 76, finger=finger(3))),
    (PedalEvent(0.2, 127),),
    "A tune",
)
FINER, COARSER = 0.025, 0.1  # control steps [s] other than the usual 0.05


def melody(*pitches: int, length: float = 0.4, pedal: bool = False) -> Score:
    """One note after the other, with the pedal down in the middle if asked for."""
    events = (PedalEvent(length, 127), PedalEvent(2 * length, 0)) if pedal else ()
    notes = (Note(i * length, (i + 1) * length, p) for i, p in enumerate(pitches))
    return Score(tuple(notes), events)


def whole_plan(score: Score, delays: int | np.ndarray = 0) -> SongPlan:
    task = begun(PianoTask([score], BUFFER, SceneConfig(hands="right")))
    start = task.state.hand_qpos[0]
    return plan_song(task.goals.tracks[0], start, release_delays=delays)
