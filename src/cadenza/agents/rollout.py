"""Rollouts of agents: episodes that are played and recorded."""

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Agent, Progress, silent
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.configs import MAX_SEED, whole_number
from cadenza.episode import KEY_EVENTS, Episode
from cadenza.errors import CadenzaError, by_others
from cadenza.music.metrics import expressive_metrics
from cadenza.scene.drawing import body_poses, drawing
from cadenza.sim.hands_apart import HandsApart
from cadenza.sim.protocol import State
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.reward import Transition, midi_velocity
from cadenza.tasks.view import View


@dataclass(frozen=True)
class EpisodeResult:
    """An episode, its metrics, and the plan that was followed."""

    episode: Episode
    metrics: dict[str, Any]
    """The metrics of `cadenza.music.metrics.playing_metrics` and those of
    `cadenza.music.metrics.expressive_metrics`, None if not defined; `return` and
    ``reward/<term>`` summed over the episode; `rewarded_fingers`, see `GoalTrack`; `steps`,
    `planning_seconds` spent by the agent, from its reset on, `playing_seconds` by the simulation,
    and whether the simulation became `unstable`; `combined`, true if each hand played alone."""
    plan: SongPlan | None
    """The plan that the agent followed, see `Agent.song_plan`."""


def begin_episodes(task: PianoTask, seeds: Sequence[int]) -> list[np.random.Generator]:
    """Begin an episode in every environment of `task`.

    Everything random in the task and in the agent follows from the seed of each environment. Raises
    CadenzaError if there are more or fewer seeds than environments, or one is negative. Returns a
    generator for each environment, which the agent draws from.
    """
    if len(seeds) != task.num_envs:
        raise CadenzaError(
            f"{len(seeds)} seeds for {task.num_envs} environments: give one for each"
        )
    seeds = [whole_number(seed, "seed", 0, MAX_SEED) for seed in seeds]
    spawned = [np.random.default_rng(seed).spawn(2) for seed in seeds]
    task.reset([task_rng for task_rng, _ in spawned], range(len(spawned)))
    return [agent_rng for _, agent_rng in spawned]


def play_episode(
    task: PianoTask,
    agent: Agent,
    seed: int = 0,
    progress: Progress = silent,
    stop: Callable[[], bool] = lambda: False,
) -> EpisodeResult:
    """Play one episode of a task that has one environment, see `play_episodes`."""
    (result,) = play_episodes(task, agent, [seed], progress, stop)
    return result


def play_episodes(
    task: PianoTask,
    agent: Agent,
    seeds: Sequence[int],
    progress: Progress = silent,
    stop: Callable[[], bool] = lambda: False,
) -> list[EpisodeResult]:
    """Play an episode in every environment of `task`, all at once, from the beginning.

    Raises CadenzaError if the agent cannot play this task, or a seed is negative.

    Args:
        task: the task to play.
        agent: the agent that plays.
        seeds: see `begin_episodes`. What happens in an environment does not depend on the others.
        progress: receives the stage "playing" after every step, with the number of steps done and
            in all, and the stages of long work of the agent.
        stop: called after every step; true ends the episodes there.
    """
    rngs, env_ids = begin_episodes(task, seeds), list(range(task.num_envs))
    name = type(agent).__name__
    agent.progress = progress
    started = time.perf_counter()
    with by_others(f"agent {name}: reset()"):
        agent.reset(env_ids, rngs)
    planning = (time.perf_counter() - started) / task.num_envs
    view = task.view()
    recorders = [_Recorder(task, env, view.observation[env], planning) for env in env_ids]
    while view.playing.any():
        started = time.perf_counter()
        with by_others(f"agent {name}: act()"):
            action = np.asarray(agent.act(view), np.float64)
        acted = time.perf_counter()
        _check_action(action, view, name)
        moving = np.flatnonzero(view.playing).tolist()
        transition = task.step(action, None if view.playing.all() else moving)
        stepped = time.perf_counter()
        view = task.view(view.playing & ~(transition.terminated | transition.truncated))
        for env in moving:
            recorder = recorders[env]
            recorder.planning_seconds += (acted - started) / len(moving)
            recorder.playing_seconds += (stepped - acted) / len(moving)
            recorder.add(action[env], transition, view.observation[env])
        progress("playing", int(view.steps.sum()), int(view.num_steps.sum()))
        if stop():
            break
    return [recorder.result(_song_plan(agent, env)) for env, recorder in enumerate(recorders)]


def _song_plan(agent: Agent, env_id: int) -> SongPlan | None:
    what = f"agent {type(agent).__name__}: song_plan()"
    with by_others(what):
        plan = agent.song_plan(env_id)
    if not isinstance(plan, SongPlan | None):
        raise CadenzaError(f"{what} returned {type(plan).__name__}: give a SongPlan or None")
    return plan


def _check_action(action: NDArray[np.float64], view: View, agent: str) -> None:
    needed = (len(view.env_ids), view.task.action_size)
    if action.shape != needed:
        raise CadenzaError(
            f"agent {agent}: act() returned actions of shape {action.shape}, "
            f"but the task needs {needed}"
        )
    if bad := np.argwhere(~np.isfinite(action) & view.playing[:, None]).tolist():
        env, servo = bad[0]
        raise CadenzaError(
            f"agent {agent}: act() returned {action[env, servo]} as action {servo} in control "
            f"step {view.steps[env]}; give finite numbers"
        )


def _key_events(state: State, task: PianoTask, env: int) -> dict[str, NDArray[np.float32]]:
    """Onsets, ends and velocities of keys in the last step, see `Episode`."""
    onset, offset, speed = (values[env] for values in state.key_events)
    values = onset, offset, midi_velocity(speed, task.scene.keyboard)
    return {name: v.astype(np.float32) for name, v in zip(KEY_EVENTS, values, strict=True)}


class _Recorder:
    """A recorder of the arrays of an episode row by row, see `cadenza.episode`."""

    def __init__(
        self, task: PianoTask, env: int, observation: NDArray[np.float32], planning: float
    ) -> None:
        self._task, self._env = task, env
        self.planning_seconds, self.playing_seconds = planning, 0.0
        self._unstable = False
        self._rows: dict[str, NDArray[Any]] = {}
        self._done, self._num_steps = 0, int(task.goals.num_steps[env])
        self._start = {"hand_qpos0": task.state.hand_qpos[env]}
        self._start |= {f"{n}0": part for n, part in self._goals(observation).items()}
        self._start |= {f"randomization_{name}": v[env].copy() for name, v in task.drawn.items()}

    def _goals(self, observation: NDArray[np.float32]) -> dict[str, Any]:
        layout = self._task.spec.observation_layout
        names = [name for name in ("goal", "fingering") if name in layout]
        return {f"{name}_obs": observation[layout[name]].astype(np.uint8) for name in names}

    def add(
        self, action: NDArray[np.float64], transition: Transition, observation: NDArray[np.float32]
    ) -> None:
        task, state, env = self._task, self._task.state, self._env
        row = {
            "action": action,
            "hand_qpos": state.hand_qpos[env],
            "hand_qvel": state.hand_qvel[env],
            "key_qpos": state.key_qpos[env],
            "key_activation": task.sounding[env],
            "sustain_activation": task.pedal_down[env],
            "fingertip_xpos": state.fingertip_xpos[env],
            "reward_total": transition.reward[env],
        }
        row |= _key_events(state, task, env)
        if task.scene.config.touch:
            row["touch"] = state.touch[env]
        row |= {f"reward_{name}": values[env] for name, values in transition.terms.items()}
        if isinstance(task.simulation, HandsApart):
            parts = {side: task.simulation.part(side) for side in task.scene.sides}
            for side, part in parts.items():
                alone = {"key_qpos": part.key_qpos[env], **_key_events(part, task, env)}
                row |= {f"{side}_{name}": values for name, values in alone.items()}
        self._unstable = bool(transition.unstable[env])
        for name, value in {**row, **self._goals(observation)}.items():
            if name not in self._rows:
                values = np.asarray(value)
                self._rows[name] = np.zeros((self._num_steps, *values.shape), values.dtype)
            self._rows[name][self._done] = value
        self._done += 1

    def result(self, plan: SongPlan | None) -> EpisodeResult:
        task, env = self._task, self._env
        scores = task.episode_metrics(env)
        metrics: dict[str, Any] = {  # JSON has no NaN
            name: None if math.isnan(value) else value for name, value in scores.items()
        }
        written = task.score(env).until(self._done * task.config.control_timestep)
        metrics = expressive_metrics(task.played(env), written) | metrics | self._sums()
        metrics |= {
            "rewarded_fingers": task.goals.tracks[env].rewarded_fingers,
            "steps": self._done,
            "planning_seconds": self.planning_seconds,
            "playing_seconds": self.playing_seconds,
            "unstable": self._unstable,
        }
        if isinstance(task.simulation, HandsApart):
            metrics["combined"] = True
        return EpisodeResult(self._episode(metrics), metrics, plan)

    def _sums(self) -> dict[str, float]:
        rewards = {n: rows for n, rows in self._rows.items() if n.startswith("reward_")}
        terms = {name: float(np.sum(rows[: self._done])) for name, rows in rewards.items()}
        total = terms.pop("reward_total")
        return {"return": total} | {n.replace("_", "/", 1): value for n, value in terms.items()}

    def _episode(self, metrics: dict[str, Any]) -> Episode:
        task, scene = self._task, self._task.scene
        rows = {name: values[: self._done] for name, values in self._rows.items()}
        goal, fingers = task.goals.between(self._env, 0, self._done)
        xpos, xquat = body_poses(scene, rows["hand_qpos"])
        constants = {
            "action_min": task.spec.action_low,
            "action_max": task.spec.action_high,
            "actuator_names": np.array(scene.actuator_names),
            "hand_joint_names": np.array(scene.hand_joint_names, dtype=np.str_),
            "reduced_action_space": np.array(scene.config.reduced_action_space),
            "physics": np.array(scene.config.physics),
            "sleeping_keys": np.array(scene.config.sleeping_keys),
            "trim_silence": np.array(task.config.trim_silence),
            "lowest_pitch": np.array(scene.keyboard.lowest_pitch),
            "goal_keys": goal[:, :-1],
            "goal_fingers": fingers,
            "goal_sustain": goal[:, -1],
            "body_xpos": xpos,
            "body_xquat": xquat,
            "metrics": np.array(json.dumps(metrics)),
        }
        title = task.goals.scores[self._env].title
        return Episode(
            title, task.config.control_timestep, self._start | rows | constants, drawing(scene)
        )
