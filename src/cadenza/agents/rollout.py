"""Has an agent play one episode and keeps everything that happened."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Agent, Progress, ReportingAgent, silent
from cadenza.configs import MOST_SEED, whole_number
from cadenza.episode import Episode
from cadenza.errors import CadenzaError, by_others
from cadenza.music.score import NUM_KEYS
from cadenza.scene.drawing import body_poses, drawing
from cadenza.tasks.piano_task import PianoTask


@dataclass(frozen=True)
class Performance:
    """An episode and how it went."""

    episode: Episode
    metrics: dict[str, Any]
    """The scores of `music.metrics`, None for one that is not defined; `return`, `reward/<term>`
    summed over the episode; `steps`, `planning_seconds` spent by the agent, from its reset on,
    `playing_seconds` by the simulation, and whether the simulation became `unstable`."""


def play(
    task: PianoTask,
    agent: Agent,
    seed: int = 0,
    progress: Progress = silent,
    stop: Callable[[], bool] = lambda: False,
) -> Performance:
    """Plays one episode of `task`, which has one environment, from the beginning.

    Args:
        task: what to play.
        agent: who plays.
        seed: of everything random, in the task and in the agent.
        progress: is told of "playing" after every step, with the steps done and in all, and before
            and between of what else a `ReportingAgent` does.
        stop: is asked after every step whether that was the last; the episode is what was played.

    Raises:
        CadenzaError: the agent cannot play this task, or the seed is negative.
    """
    seed = whole_number(seed, "seed", 0, MOST_SEED)
    name = type(agent).__name__
    task_rng, agent_rng = np.random.default_rng(seed).spawn(2)
    task.reset([task_rng], [0])
    if isinstance(agent, ReportingAgent):
        agent.progress = progress
    started = time.perf_counter()
    with by_others(f"agent {name}: reset()"):
        agent.reset(task, agent_rng)
    planning, playing = time.perf_counter() - started, 0.0
    record = _Record(task)
    ended = unstable = False
    while not ended:
        started = time.perf_counter()
        with by_others(f"agent {name}: act()"):
            action = np.asarray(agent.act(), np.float64)
        decided = time.perf_counter()
        _check_action(action, task, name)
        transition = task.step(action[None])
        playing += time.perf_counter() - decided
        planning += decided - started
        record.add(action, transition.reward[0], {k: v[0] for k, v in transition.terms.items()})
        ended = bool(transition.terminated[0] or transition.truncated[0]) or stop()
        unstable = bool(transition.unstable[0])
        progress("playing", int(task.sheets.steps_done[0]), int(task.sheets.num_steps[0]))
    scores = task.episode_metrics(0)  # JSON has no NaN
    metrics: dict[str, Any] = {n: None if math.isnan(v) else v for n, v in scores.items()}
    metrics |= record.sums()
    metrics |= {
        "steps": int(task.sheets.steps_done[0]),
        "planning_seconds": planning,
        "playing_seconds": playing,
        "unstable": unstable,
    }
    return Performance(record.episode(metrics), metrics)


def _check_action(action: NDArray[np.float64], task: PianoTask, agent: str) -> None:
    if action.shape != (task.action_size,):
        raise CadenzaError(
            f"agent {agent}: act() returned an action of shape {action.shape}, "
            f"but the task needs ({task.action_size},)"
        )
    if not np.isfinite(action).all():
        raise CadenzaError(f"agent {agent}: act() returned an action that is not finite")


class _Record:
    """Collects the rows of an episode's arrays (see `cadenza.episode`)."""

    def __init__(self, task: PianoTask) -> None:
        self._task = task
        self._rows: dict[str, NDArray[Any]] = {}
        self._done, self._most = 0, int(task.sheets.num_steps[0])
        self._start = {"hand_qpos0": task.state.hand_qpos[0]} | {
            f"{name}0": part for name, part in self._score_observations().items()
        }

    def _score_observations(self) -> dict[str, Any]:
        observation, layout = self._task.observation()[0], self._task.observation_layout
        names = [name for name in ("goal", "fingering") if name in layout]
        return {f"{name}_obs": observation[layout[name]].astype(np.uint8) for name in names}

    def add(self, action: Any, total: float, terms: dict[str, float]) -> None:
        task, state = self._task, self._task.state
        row = {
            "action": np.asarray(action, np.float64),
            "hand_qpos": state.hand_qpos[0],
            "hand_qvel": state.hand_qvel[0],
            "key_qpos": state.key_qpos[0],
            "key_activation": task.sounding[0],
            "sustain_activation": task.pedal_down[0],
            "fingertip_xpos": state.fingertip_xpos[0],
            "reward_total": total,
        }
        row |= {f"reward_{name}": value for name, value in terms.items()}
        for name, value in {**row, **self._score_observations()}.items():
            if name not in self._rows:
                values = np.asarray(value)
                self._rows[name] = np.zeros((self._most, *values.shape), values.dtype)
            self._rows[name][self._done] = value
        self._done += 1

    def sums(self) -> dict[str, float]:
        rewards = {n: rows for n, rows in self._rows.items() if n.startswith("reward_")}
        terms = {name: float(np.sum(rows[: self._done])) for name, rows in rewards.items()}
        total = terms.pop("reward_total")
        return {"return": total} | {n.replace("_", "/", 1): value for n, value in terms.items()}

    def episode(self, metrics: dict[str, Any]) -> Episode:
        task, scene = self._task, self._task.scene
        rows = {name: values[: self._done] for name, values in self._rows.items()}
        goal, fingers = task.sheets.part(0, 0, self._done)
        xpos, xquat = body_poses(scene, rows["hand_qpos"])
        about = {
            "action_min": task.action_low,
            "action_max": task.action_high,
            "actuator_names": np.array(scene.actuator_names),
            "hand_joint_names": np.array(scene.hand_joint_names, dtype=np.str_),
            "reduced_action_space": np.array(scene.config.reduced_action_space),
            "physics": np.array(scene.config.physics),
            "sleeping_keys": np.array(scene.config.sleeping_keys),
            "trim_silence": np.array(task.config.trim_silence),
            "goal_keys": goal[:, :NUM_KEYS],
            "goal_fingers": fingers,
            "goal_sustain": goal[:, NUM_KEYS],
            "body_xpos": xpos,
            "body_xquat": xquat,
            "metrics": np.array(json.dumps(metrics)),
        }
        title = task.sheets.songs[0].title
        return Episode(
            title, task.config.control_timestep, self._start | rows | about, drawing(scene)
        )
