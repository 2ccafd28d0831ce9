"""Verification of an entry: its actions are played again, and all metrics computed anew.

Songs, scene and task are those of the benchmark's definition; only the actions come from the entry.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError
from cadenza.evaluation.benchmark.definition import DEPLOYMENT, METRICS, check_frozen, set_up_song
from cadenza.evaluation.benchmark.deployment import played_on_robot
from cadenza.evaluation.benchmark.entry import (
    BenchmarkEntry,
    Metrics,
    actions_path,
    check_files,
    read_entry,
    runs_by_song,
)
from cadenza.files import FLOATS, ArrayOf, read_tensors
from cadenza.music.libraries.imported import Progress, silent
from cadenza.performing.setup import Setup

_HEADER = 4096  # maximum bytes of a file of actions beside the actions


@dataclass(frozen=True)
class PlayedAgain:
    """An entry that was played again."""

    entry: BenchmarkEntry
    metrics: dict[tuple[str, int], Metrics]  # the metrics of every run (song, seed), computed here
    seconds: float  # length of all music that was played [s]
    differences: list[str]  # claimed metrics that differ from those computed here, a line each


def verify(folder: Path, progress: Progress = silent) -> PlayedAgain:
    """Play every run of an entry again, and compare the metrics.

    `progress` receives the number of runs done, and of all. Raises CadenzaError if the entry is
    incomplete or cannot be played.
    """
    entry = read_entry(folder)
    by_song = runs_by_song(entry)
    check_files(folder, entry)
    differences = list[str]()
    metrics, seconds = dict[tuple[str, int], Metrics](), 0.0
    for song, runs in by_song:
        with set_up_song(song) as setup:
            digest = check_frozen(song, setup)
            for run in runs:
                run_name = f"{run.song}, seed {run.seed}"
                if run.song_digest != digest:
                    raise CadenzaError(
                        f"{run_name}: was recorded with other notes than the song has here "
                        f"({digest})"
                    )
                actions = _actions(actions_path(folder, run.song, run.seed), setup)
                if entry.track == DEPLOYMENT:
                    computed = played_on_robot(actions, run.seed, setup)
                else:
                    computed = _played(actions, run.seed, setup, run_name)
                metrics[run.song, run.seed] = computed
                seconds += len(actions) * setup.task.config.control_timestep
                differences += [
                    f"{run_name}: {name} is {computed[name]} here, not {run.metrics[name]}"
                    for name in METRICS
                    if computed[name] != run.metrics[name]
                ]
                progress(len(metrics), len(entry.runs))
    return PlayedAgain(entry, metrics, seconds, differences)


def _actions(path: Path, setup: Setup) -> NDArray[np.float64]:
    """Read the actions (T, A) of a run; raises CadenzaError if they do not fit the task."""
    low, high = setup.task.spec.action_low, setup.task.spec.action_high
    steps = setup.task.tracks[0].goals.num_steps
    form = ArrayOf(FLOATS, (steps, len(low)), needed=True, finite=True)
    max_bytes = steps * len(low) * np.dtype(np.float64).itemsize + _HEADER
    actions: NDArray[Any] = read_tensors(path, {"action": form}, max_bytes)[0]["action"]
    if outside := np.argwhere((actions < low) | (actions > high)).tolist():
        step, servo = outside[0]
        raise CadenzaError(f"{path}: action {servo} of step {step} is out of the servo's range")
    return actions.astype(np.float64)


def _played(actions: NDArray[np.float64], seed: int, setup: Setup, run_name: str) -> Metrics:
    """The metrics of actions (T, A) of a whole song."""
    metrics = play_episode(setup.task, Playback(actions), seed).metrics
    if metrics["steps"] != len(actions):
        raise CadenzaError(
            f"{run_name}: the simulation becomes unstable after {metrics['steps']} of "
            f"{len(actions)} steps"
        )
    return {name: metrics[name] for name in METRICS}
