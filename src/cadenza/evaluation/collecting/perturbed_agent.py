"""Agents for demonstrations that show how to recover: with noise on the actions of another.

That one performs each song once, undisturbed, and goes back to that wherever it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Agent, Array, EpisodePlanner, PlannerPerEnv
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.rollout import play_episode
from cadenza.evaluation.collecting.variation import as_drawn
from cadenza.evaluation.jobs import key_of
from cadenza.files import FLOATS, ArrayOf, read_arrays, write_atomically
from cadenza.music.formats.written_score import WrittenScore
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View, observed_key_onsets

_SEED = 0  # of every performance, so that all episodes of a song go back to the same one
_ARRAYS = {
    "action": ArrayOf(FLOATS, ("steps", "actions"), needed=True, finite=True),
    "expected": ArrayOf(FLOATS, ("states", "servos", 2), needed=True, finite=True),
}


class ReferencePerformance(NamedTuple):
    """What an agent played where nothing was random, T steps with A servos."""

    action: Array  # (T, A + 1) in actuator units, the pedal last
    expected: Array  # (T + 1, A, 2) position and speed of each servo

    @classmethod
    def of(cls, agent: Agent, track: GoalTrack) -> ReferencePerformance:
        """Have the agent play a track as it was drawn."""
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
        here = self._servos.state(state.hand_qpos[0], state.hand_qvel[0])
        return np.append(self._tracking.controls(self._servos, step, here), self._pedal[step])


class PerformedAgent(PlannerPerEnv[_PerformedEpisode]):
    """An agent that performs a song once, and in every episode tracks what it played.

    What it chooses is thus a function of the step and the state, the same in all episodes of a
    song, and takes no search where noise has led the hands astray.
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
        played = [self._facts, asdict(task), asdict(track.scene.config), asdict(score)]
        path = self._folder / f"{key_of(played)}.npz"
        if path.exists():
            return ReferencePerformance(**read_arrays(path, _ARRAYS))
        self._agent.progress = self.progress
        performance = ReferencePerformance.of(self._agent, track)
        with write_atomically(path) as file:
            np.savez(file, allow_pickle=False, **performance._asdict())
        return performance


def _undisturbed(task: TaskConfig) -> TaskConfig:
    """Return the task for a score that has been drawn, where nothing else is."""
    return replace(as_drawn(task), randomization=DomainRandomization())


_NOISE_TIME = 0.15  # [s] after which noise has fallen to 1 / e
_TURN = 1.0  # [s] mean time after which it is drawn anew who plays
_STUDENT_SHARE = 0.5  # share of the turns in which the student plays


class Shown(NamedTuple):
    """What one environment shows that the recorded states do not tell."""

    pedal: float  # how far the pedal is down, from 0 to 1: actions may arrive late
    # (K,) when keys began to sound in the last step, see `observed_key_onsets`
    key_onset: NDArray[np.float32]
    key_velocity: NDArray[np.float32]  # (K,) how loud they did


def shown_by(view: View) -> Shown:
    """What the only environment of a view shows, without noise."""
    task = view.task
    pedal = float(view.observation[0, task.observation_layout["pedal"]][0])
    dt, keyboard = task.config.control_timestep, task.scene.keyboard
    onset, velocity = observed_key_onsets(view.simulation.state, keyboard, dt)
    return Shown(pedal, onset[0], velocity[0])


class PerturbedAgent(Agent):
    """Plays in one environment what another agent chooses, with noise, and keeps both.

    The agent sees where the noise has led, and corrects it. Where there is a student, it plays half
    of the time, and the agent sees where that has led (DAgger: Ross, Gordon & Bagnell, A Reduction
    of Imitation Learning and Structured Prediction to No-Regret Online Learning, 2011).

    Attributes:
        chosen: (A + 1,) of each step, without noise, in actuator units, as float32.
        played: (A + 1,) of each step, with noise, from -1 to 1, as float32.
        shown: what the environment showed before each step.
        start: the state before the first step.
    """

    def __init__(
        self, agent: Agent, scene: Scene, noise: float, student: Agent | None = None
    ) -> None:
        """Take the standard deviation of the noise in units of that of the planner's search."""
        self._agent, self._student = agent, student
        self._sigma = noise * np.append(servos_of(scene).noise, 0.0)
        self.chosen: list[NDArray[np.float32]] = []
        self.played: list[NDArray[np.float32]] = []
        self.shown: list[Shown] = []
        self.start: State | None = None
        self._students_turn = False

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        (rng,) = rngs
        agent_rng, self._rng = rng.spawn(2)
        self._agent.progress = self.progress
        self._agent.reset(env_ids, [agent_rng])
        if self._student is not None:
            self._student.reset(env_ids, self._rng.spawn(1))
            self._students_turn = self._rng.random() < _STUDENT_SHARE
        self._noise = np.zeros_like(self._sigma)
        self.chosen.clear()
        self.played.clear()
        self.shown.clear()
        self.start = None

    def act(self, view: View) -> Array:
        task = view.task
        if self.start is None:
            self.start = view.simulation.state.copy()
        self.shown.append(shown_by(view))
        chosen = self._agent.act(view)[0]
        # A first-order autoregressive process, whose standard deviation is sigma.
        kept = np.exp(-task.config.control_timestep / _NOISE_TIME)
        fresh = np.sqrt(1 - kept**2) * self._sigma
        self._noise = kept * self._noise + fresh * self._rng.standard_normal(len(fresh))
        played = np.clip(
            self._agent_or_student(chosen, view) + self._noise, task.action_low, task.action_high
        )
        within = np.clip(chosen, task.action_low, task.action_high)
        self.chosen.append(within.astype(np.float32))
        # What is recorded is what environments take, so that they can play exactly that again.
        self.played.append(task.unscale_action(played).astype(np.float32))
        return task.scale_action(self.played[-1])[None]

    def song_plan(self, env_id: int) -> Any:
        return self._agent.song_plan(env_id)

    def close(self) -> None:
        """Close the student; the agent belongs to the caller."""
        if self._student is not None:
            self._student.close()

    def _agent_or_student(self, chosen: Array, view: View) -> Array:
        """Return the action (A + 1,) of the agent, or of the student where it is its turn."""
        if self._student is None:
            return chosen
        if self._rng.random() < view.task.config.control_timestep / _TURN:
            self._students_turn = self._rng.random() < _STUDENT_SHARE
        student = self._student.act(view)[0]
        return student if self._students_turn else chosen
