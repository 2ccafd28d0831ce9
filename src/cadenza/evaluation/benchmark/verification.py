"""Plays an entry again: every recorded action in the frozen task, every metric anew.

Nothing is taken from an entry but its actions and what they are compared with: the songs, the
scene and the task are those of the benchmark's definition.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError
from cadenza.evaluation.benchmark.definition import METRICS, check_frozen, set_up_song
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

_HEADER = 4096  # bytes that a file of actions may take beside them


@dataclass(frozen=True)
class PlayedAgain:
    """An entry that was played again."""

    entry: BenchmarkEntry
    metrics: dict[tuple[str, int], Metrics]  # the metrics of every run (song, seed), computed here
    seconds: float  # length of all music that was played [s]
    # Where a metric that the entry claims is not computed here to the bit, in a line each
    differences: list[str]


def verify(folder: Path, progress: Progress = silent) -> PlayedAgain:
    """Play every run of an entry again, and compare; `progress` is told how many of how many.

    Raises CadenzaError if it is no whole entry, or cannot be played; the error says why in a line.
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
                where = f"{run.song}, seed {run.seed}"
                if run.song_digest != digest:
                    raise CadenzaError(
                        f"{where}: was recorded with other notes than the song has here ({digest})"
                    )
                actions = _actions(actions_path(folder, run.song, run.seed), setup)
                computed = _played(actions, run.seed, setup, where)
                metrics[run.song, run.seed] = computed
                seconds += len(actions) * setup.task.config.control_timestep
                differences += [
                    f"{where}: {name} is {computed[name]} here, not {run.metrics[name]}"
                    for name in METRICS
                    if computed[name] != run.metrics[name]
                ]
                progress(len(metrics), len(entry.runs))
    return PlayedAgain(entry, metrics, seconds, differences)


def _actions(path: Path, setup: Setup) -> NDArray[np.float64]:
    """Read the actions (T, A) of a run, which are as many and as large as the task takes."""
    low, high = setup.task.spec.action_low, setup.task.spec.action_high
    steps = setup.task.tracks[0].goals.num_steps
    form = ArrayOf(FLOATS, (steps, len(low)), needed=True, finite=True)
    most = steps * len(low) * np.dtype(np.float64).itemsize + _HEADER
    actions: NDArray[Any] = read_tensors(path, {"action": form}, most)[0]["action"]
    if outside := np.argwhere((actions < low) | (actions > high)).tolist():
        step, servo = outside[0]
        raise CadenzaError(f"{path}: action {servo} of step {step} is out of the servo's range")
    return actions.astype(np.float64)


def _played(actions: NDArray[np.float64], seed: int, setup: Setup, where: str) -> Metrics:
    """Return the metrics of actions (T, A), played from the beginning to the end of a song."""
    metrics = play_episode(setup.task, Playback(actions), seed).metrics
    if metrics["steps"] != len(actions):
        raise CadenzaError(
            f"{where}: the simulation becomes unstable after {metrics['steps']} of "
            f"{len(actions)} steps"
        )
    return {name: metrics[name] for name in METRICS}
