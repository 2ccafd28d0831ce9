"""An agent that performs each song once, undisturbed, and tracks this performance in episodes."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cadenza.agents.agent import Agent, Array, EpisodePlanner, PlannerPerEnv
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.rollout import play_episode
from cadenza.evaluation.collecting.variation import as_drawn
from cadenza.evaluation.jobs import key_of
from cadenza.files import FLOATS, ArrayOf, read_arrays, write_atomically
from cadenza.music.formats.written_score import WrittenScore
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View

_SEED = 0  # seed of performances: all episodes of a song track the same one
_ARRAYS = {
    "action": ArrayOf(FLOATS, ("steps", "actions"), needed=True, finite=True),
    "expected": ArrayOf(FLOATS, ("states", "servos", 2), needed=True, finite=True),
}


class ReferencePerformance(NamedTuple):
    """An agent's performance without randomness, T steps with A servos."""

    action: Array  # (T, A + 1) in actuator units, the pedal last
    expected: Array  # (T + 1, A, 2) position and speed of each servo

    @classmethod
    def of(cls, agent: Agent, track: GoalTrack) -> ReferencePerformance:
        """Have the agent play a track."""
        score = track.score if agent.keeps_fingering else track.score.without_fingers()
        with closing(PianoTask([score], _undisturbed(track.config), track.scene.config)) as task:
            played = play_episode(task, agent, _SEED, agent.progress).episode.arrays
        qpos = np.concatenate([played["hand_qpos0"][None], played["hand_qpos"]])
        qvel = np.concatenate([np.zeros_like(played["hand_qvel"][:1]), played["hand_qvel"]])
        return cls(played["action"], servos_of(track.scene).state(qpos, qvel))


class _PerformedEpisode(EpisodePlanner):
    def __init__(self, performance: ReferencePerformance, track: GoalTrack, view: View) -> None:
        self.plan = plan_song(track, view.state.hand_qpos[0])
        self._servos, self._pedal = servos_of(track.scene), performance.action[:, -1]
        gain = self.plan.nominal.tracking.gain
        self._tracking = Tracking(performance.action[:, :-1], gain, performance.expected)

    def act(self, view: View) -> Array:
        step, state = int(view.steps[0]), view.state
        servo_state = self._servos.state(state.hand_qpos[0], state.hand_qvel[0])
        return np.append(
            self._tracking.controls(self._servos, step, servo_state), self._pedal[step]
        )


class PerformedAgent(PlannerPerEnv[_PerformedEpisode]):
    """An agent that performs a song once, and tracks this performance in every episode.

    Its actions are thus a function of the step and the state, the same in all episodes of a song.
    They need no search when noise has moved the hands.
    """

    def __init__(self, agent: Agent, folder: Path, facts: Any) -> None:
        """Keep performances of `agent` in a folder, named after the song and `facts` in JSON."""
        super().__init__()
        self._agent, self._folder, self._facts = agent, folder, facts

    def begin(self, view: View, _rng: np.random.Generator) -> _PerformedEpisode:
        (track,) = view.tracks
        return _PerformedEpisode(self._performance(track), track, view)

    def _performance(self, track: GoalTrack) -> ReferencePerformance:
        task, score = _undisturbed(track.config), WrittenScore.of(track.score)
        content = [self._facts, asdict(task), asdict(track.scene.config), asdict(score)]
        path = self._folder / f"{key_of(content)}.npz"
        if path.exists():
            return ReferencePerformance(**read_arrays(path, _ARRAYS))
        self._agent.progress = self.progress
        performance = ReferencePerformance.of(self._agent, track)
        with write_atomically(path) as file:
            np.savez(file, allow_pickle=False, **performance._asdict())
        return performance


def _undisturbed(task: TaskConfig) -> TaskConfig:
    """The task for a drawn score, without other randomness."""
    return replace(as_drawn(task), randomization=DomainRandomization())
