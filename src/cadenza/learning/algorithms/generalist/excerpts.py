"""Excerpts of songs as environments, in which planned hands are corrected.

Each finger has its own reward: what its keys lack, wrong keys that it is nearest to, how far its
strikes are off their times and speeds, and its fingertip from the plan.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Progress, silent
from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.agents.planner.search.fingertip_correction import MAX_ERROR
from cadenza.agents.planner.search.horizon_cost import HARMLESS_DEPTH
from cadenza.agents.planner.search.strikes import log_speed, strike_costs
from cadenza.learning.algorithms.generalist.hand_networks import Array
from cadenza.music.score import Score
from cadenza.scene.scene import Scene
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

# Weights of the costs of a step, as in the planner's search, except that a key of a chord counts
# less the more keys the chord has.
_WRONG, _EARLY, _OFF_PLAN, _STRIKE = 3.0, 1.5, 0.3, 0.3
_AXES = np.array([0.55, 1.0, 1.0])  # weights of distances: those along a key count less
_MAX_COST = 15.0  # greatest cost of a finger in a step

# The distribution of velocities.
_VELOCITIES = 30, 100
_SWELL = 3.0, 8.0  # [s] in which they rise and fall
_ACCENT = 8.0  # standard deviation of each note's own


class FingerCosts:
    """The costs of F fingers for what they fail to do in each of the T steps of a song.

    Attributes:
        num_steps: T.
        dt: control step [s].
        keyboard: The keyboard.
        strikes: the strikes of keys that the plan holds.
    """

    def __init__(self, plan: SongPlan) -> None:
        scene, goals, nominal = plan.scene, plan.goals, plan.nominal
        hands = [HandGoals(plan, side) for side in scene.sides]
        self.dt = plan.track.config.control_timestep
        self.num_steps, self.keyboard = goals.num_steps, scene.keyboard
        self._held = np.any([hand.planned for hand in hands], axis=0)
        self._due = self._held & np.any([hand.onset_due for hand in hands], axis=0)
        self._early = np.any([hand.onset_wrong for hand in hands], axis=0)
        self._fingers, self._wrong = goals.fingers, ~goals.keys
        self._share = 2.0 / (1 + goals.keys.sum(axis=1))
        self._fingertips = nominal.fingertips
        self._weight = _OFF_PLAN * np.concatenate([hand.weight for hand in hands], axis=1)
        self.strikes = StrikesOfPlan.of(plan, self._held)
        self._top = scene.keyboard.centre[:, 2] + scene.keyboard.half_size[:, 2]

    def holds(self, step: int, key: int) -> bool:
        """Whether the plan holds a key down after a step."""
        return step < self.num_steps and bool(self._held[step, key])

    def after(self, step: int, state: State, sounded: Array) -> tuple[Array, Array]:
        """Costs (F,) of the fingers after a step, and the keys (K,) that sound.

        Args:
            step: The step of the song.
            state: The state of one simulation after it.
            sounded: (K,) keys that sounded before it.
        """
        key_qpos, fingertips = state.key_qpos[0], state.fingertip_xpos[0]
        keyboard, held, share = self.keyboard, self._held[step], self._share[step]
        sounding, depth = key_qpos >= keyboard.sounds_from, key_qpos / keyboard.travel
        lacking = ~sounding + np.clip(1 - depth, 0, 1) ** 2
        missed = _WRONG * share * held * lacking + _WRONG * (self._due[step] & ~sounding)
        wrong = (
            _WRONG
            * share
            * self._wrong[step]
            * (sounding + np.maximum(depth - HARMLESS_DEPTH, 0) ** 2)
        )
        wrong += _EARLY * (self._early[step] & sounding & ~sounded)
        off = (fingertips - self._fingertips[step + 1]) * _AXES
        costs = self._weight[step + 1] * np.minimum((off * off).sum(axis=1), MAX_ERROR**2)
        keys = np.flatnonzero(missed)
        np.add.at(costs, self._fingers[step, keys], missed[keys])
        keys = np.flatnonzero(wrong)
        along = fingertips[:, 1] - keyboard.centre[keys, 1, None]
        above = np.maximum(fingertips[:, 2] - self._top[keys, None], 0)
        np.add.at(costs, (along**2 + above**2).argmin(axis=1), wrong[keys])
        fingers, strikes = self.strikes.costs(step, state)
        np.add.at(costs, fingers, _STRIKE * strikes)
        return np.minimum(costs, _MAX_COST), sounding


class StrikesOfPlan(NamedTuple):
    """The N strikes of a plan, by step."""

    step: Array  # (N,)
    key: Array  # (N,)
    finger: Array  # (N,) the fingers of both hands that strike
    # (N, 2) times in the steps [s], and log2 of the angular speeds of the keys [rad/s]
    target: Array

    @classmethod
    def of(cls, plan: SongPlan, held: Array) -> StrikesOfPlan:
        """Take the strikes of keys that the plan holds, as `held` (T, K) says."""
        step, key, time, speed = plan.strikes
        target = np.column_stack([time, np.log2(speed)])
        rows = held[step, key]
        return cls(step[rows], key[rows], plan.goals.fingers[step, key][rows], target[rows])

    def at(self, step: int) -> Iterator[tuple[int, int, Array]]:
        """Yield the key, the finger and the target of each strike of a step."""
        rows = slice(*np.searchsorted(self.step, [step, step + 1]))
        key, finger = self.key[rows].tolist(), self.finger[rows].tolist()
        yield from zip(key, finger, self.target[rows], strict=True)

    def costs(self, step: int, state: State) -> tuple[Array, Array]:
        """Fingers (M,) that strike in a step, and the costs (M,) of how they did."""
        rows = slice(*np.searchsorted(self.step, [step, step + 1]))
        key = self.key[rows]
        outcome = np.column_stack([state.key_onset[0, key], log_speed(state.key_speed[0, key])])
        return self.finger[rows], strike_costs(outcome, self.target[rows])


class PlannedExcerpt(NamedTuple):
    """A planned excerpt of a song."""

    costs: FingerCosts
    hands: CorrectedHands
    start: Array  # (J,) initial joint positions [m, rad]


def planned_excerpts(scores: Sequence[Score], progress: Progress = silent) -> list[PlannedExcerpt]:
    """Plan each of the scores for the hands and the keyboard of the default scene."""
    excerpts, config = [], TaskConfig(initial_buffer_time=0.0)
    for i, score in enumerate(scores):
        progress("plans", i, len(scores))
        with closing(PianoTask([score.without_fingers()], config)) as task:
            start = task.state.hand_qpos[0].copy()
            (track,) = task.tracks
            plan = plan_song(track, start, strikes=True)
        excerpts.append(PlannedExcerpt(FingerCosts(plan), CorrectedHands(plan), start))
    return excerpts


def with_dynamics(score: Score, rng: np.random.Generator) -> Score:
    """The score with velocities from soft to loud, which rise and fall, drawn at random.

    Many files of music have the same velocity throughout.
    """
    middle, half = sum(_VELOCITIES) / 2, (_VELOCITIES[1] - _VELOCITIES[0]) / 2
    period, phase = rng.uniform(*_SWELL), rng.uniform(0, 2 * np.pi)
    start = np.array([note.start for note in score.notes])
    velocity = middle + half * np.sin(2 * np.pi * start / period + phase)
    velocity += _ACCENT * rng.standard_normal(len(start))
    drawn = np.rint(np.clip(velocity, *_VELOCITIES)).astype(int).tolist()
    notes = zip(score.notes, drawn, strict=True)
    return replace(score, notes=tuple(replace(note, velocity=own) for note, own in notes))


class ExcerptEpisode:
    """An episode in which one excerpt is played in one of the simulations.

    Attributes:
        excerpt: the excerpt.
        hands: the hands that play it.
        step: the next step.
    """

    def __init__(self, excerpt: PlannedExcerpt) -> None:
        self.excerpt, self.step, self._total = excerpt, 0, 0.0
        self.hands = copy(excerpt.hands)
        self.hands.output = np.zeros_like(self.hands.output)
        self._sounding = np.zeros(len(excerpt.costs.keyboard.travel), bool)

    @property
    def over(self) -> bool:
        return self.step == self.excerpt.costs.num_steps

    @property
    def mean_cost(self) -> float:
        """The mean over the steps so far of the cost of all fingers together."""
        return self._total / self.step

    def inputs(self, state: State) -> Array:
        """Inputs (H, D) of the networks in a state of one simulation."""
        inputs, self._planned = self.hands.observe(self.step, state)
        return inputs

    def ctrl(self, corrections: Array, touch: Array | None) -> Array:
        """Controls (H A,) of a step with corrections (H, A) and touches (H, F, 2)."""
        planned = self._planned
        if touch is not None:
            planned, corrections = self.hands.touched(self.step, planned, corrections, touch)
        return self.hands.corrected(planned, corrections)

    def costs(self, state: State) -> Array:
        """Costs (H, F) of the fingers of each hand in the step that led to a state."""
        costs, self._sounding = self.excerpt.costs.after(self.step, state, self._sounding)
        self.step += 1
        self._total += float(costs.sum())
        return costs.reshape(len(self.hands.output), -1)


class ExcerptRollout(NamedTuple):
    """T steps of N hands."""

    inputs: Array  # (T + 1, N, D)
    corrections: Array  # (T, N, A) with noise
    rewards: Array  # (T, N, F) of each finger
    ends: Array  # (T, N) true if the excerpt ended with the step


class ExcerptEnvs:
    """Simulations that play excerpts, more often the more they cost when last played.

    Attributes:
        episodes: The present episode in each of the E simulations.
    """

    def __init__(
        self,
        excerpts: Sequence[PlannedExcerpt],
        scene: Scene,
        num_envs: int,
        rng: np.random.Generator,
    ) -> None:
        self._excerpts, self._rng = excerpts, rng
        self._unplayed = rng.permutation(len(excerpts)).tolist()
        self._last_cost = np.ones(len(excerpts))
        self._simulation = MujocoSimulation(scene, num_envs)
        self._playing = [0] * num_envs  # indices of excerpts
        self.episodes = [self._next_episode(i) for i in range(num_envs)]

    def rollout(self, policy: Callable[[Array], Array], steps: int, noise: float) -> ExcerptRollout:
        """Play the next steps, with Gaussian noise added to the policy's corrections (N, A)."""
        inputs, corrections, rewards, ends = [self.inputs()], [], [], []
        for _ in range(steps):
            mean = policy(inputs[-1])
            action = mean + noise * self._rng.standard_normal(mean.shape).astype(np.float32)
            _, costs, over = self.step(action)
            corrections.append(action)
            rewards.append(-costs)
            ends.append(np.repeat(over, len(action) // len(over)))
            inputs.append(self.inputs())
        return ExcerptRollout(*map(np.array, (inputs, corrections, rewards, ends)))

    def inputs(self) -> Array:
        """The inputs (N, D) of the networks for the hands of all simulations."""
        return np.concatenate([e.inputs(self._state(i)) for i, e in enumerate(self.episodes)])

    def step(self, corrections: Array, touch: Array | None = None) -> tuple[State, Array, Array]:
        """Take a step with corrections (N, A), and touches (N, F, 2) of fingers that strike.

        Returns the state after it, costs (N, F) of the fingers, and which excerpts (E,) are over.
        Other excerpts then begin.
        """
        count = len(self.episodes)
        touches = [None] * count if touch is None else np.split(touch, count)
        each = zip(self.episodes, np.split(corrections, count), touches, strict=True)
        self._simulation.step(np.stack([episode.ctrl(own, how) for episode, own, how in each]))
        state = self._simulation.state
        costs = [episode.costs(self._state(i)) for i, episode in enumerate(self.episodes)]
        over = np.array([episode.over for episode in self.episodes]) | state.unstable
        for i in np.flatnonzero(over).tolist():
            self._last_cost[self._playing[i]] = self.episodes[i].mean_cost
            self.episodes[i] = self._next_episode(i)
        return state, np.concatenate(costs), over

    def _next_episode(self, env: int) -> ExcerptEpisode:
        if self._unplayed:
            index = self._unplayed.pop()
        else:
            p = self._last_cost / self._last_cost.sum()
            index = int(self._rng.choice(len(self._excerpts), p=p))
        self._playing[env] = index
        episode = ExcerptEpisode(self._excerpts[index])
        self._simulation.reset([env], episode.excerpt.start[None])
        return episode

    def _state(self, env: int) -> State:
        return State._make(values[env : env + 1] for values in self._simulation.state)
