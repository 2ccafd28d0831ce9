"""Plays an entry again: every recorded action in the frozen task, every metric anew.

Nothing is taken from an entry but its actions and what they are compared with: the songs, the
scene and the task are those of the benchmark's definition.
"""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError
from cadenza.evaluation.benchmark.card import (
    Card,
    RecordedRun,
    actions_digest,
    actions_path,
    check_files,
    expected_runs,
    read_card,
)
from cadenza.evaluation.benchmark.definition import METRICS, check_frozen, set_up_song
from cadenza.files import FLOATS, ArrayOf, read_tensors
from cadenza.music.libraries.imported import Progress, silent
from cadenza.performing.setup import Setup
from cadenza.resumable import installed_versions

Metrics = dict[str, float | None]

BOUND = 0.01
"""The mean F1 of an entry may differ by this much on another engine than it was recorded on."""
_HEADER = 4096  # bytes that a file of actions may take beside them
_SHARES = ("f1", "note_onset_f1")
_ROUNDING = 1e-9  # of sums of many numbers; a key in another state in one step is far more


@dataclass(frozen=True)
class Verified:
    """An entry that was played again."""

    card: Card
    metrics: dict[tuple[str, int], Metrics]
    """The metrics of every run (song, seed), computed here: those of the card count for nothing."""
    seconds: float
    """Length of all music that was played [s]."""
    problems: list[str]
    """Where it differs, in a line each; an entry with any is refused."""
    exact: bool
    """Whether all metrics are those of the card; on another engine they may differ a little."""

    @property
    def words(self) -> str:
        """What was found, in words."""
        if self.problems:
            return self.problems[0]
        recorded = engine_of(self.card)
        return "to the bit" if self.exact else f"within {BOUND:g}, recorded with {recorded}"


def verify(entry: Path, progress: Progress = silent) -> Verified:
    """Plays every run of an entry again, and compares.

    Args:
        entry: the folder.
        progress: is told how many runs have been played again, and their number.

    Raises:
        CadenzaError: it is no whole entry, or cannot be compared; the error says why in a line.
    """
    card = read_card(entry)
    by_song = expected_runs(card)
    check_files(entry, [(run.song, run.seed) for run in card.runs])
    problems = list[str]()
    metrics, seconds = dict[tuple[str, int], Metrics](), 0.0
    for song, runs in by_song:
        with set_up_song(song) as setup:
            digest = check_frozen(song, setup)
            for run in runs:
                if run.song_digest != digest:
                    raise CadenzaError(
                        f"{song.name}: the entry was recorded with other notes "
                        f"({run.song_digest:.16}) than it has here ({digest})"
                    )
                found = _played_again(entry, run, setup)
                metrics[run.song, run.seed] = found
                seconds += run.steps * setup.task.config.control_timestep
                problems += _differences(run, found)
                progress(len(metrics), len(card.runs))
    exact = not problems
    if engine_of(card) != ", ".join(engine().values()):
        problems = _mean_differences(card, metrics)
    return Verified(card, metrics, seconds, problems, exact)


def engine() -> dict[str, str]:
    """What the bits of a simulation depend on: MuJoCo, the processor, and the C library."""
    c_library = " ".join(platform.libc_ver())
    machine = {"machine": platform.machine(), "c_library": c_library}
    return installed_versions(("mujoco",)) | machine


def engine_of(card: Card) -> str:
    """The engine that a card names, in words."""
    return ", ".join(card.versions.get(name, "unknown") for name in engine())


def _played_again(entry: Path, run: RecordedRun, setup: Setup) -> Metrics:
    """Returns the metrics of a run, played from its beginning to its end."""
    actions = _actions(entry, run, setup)
    result = play_episode(setup.task, Playback(actions), run.seed)
    if result.metrics["steps"] != len(actions):
        raise CadenzaError(
            f"{_named(run)}: the simulation becomes unstable after {result.metrics['steps']} of "
            f"{len(actions)} steps"
        )
    return {name: result.metrics[name] for name in METRICS}


def _actions(entry: Path, run: RecordedRun, setup: Setup) -> NDArray[np.float64]:
    """Reads the actions (T, A) of a run, which are as many and as large as the task takes."""
    task = setup.task
    low, high = task.spec.action_low, task.spec.action_high
    steps = task.tracks[0].goals.num_steps
    path = actions_path(entry, run.song, run.seed)
    if run.steps != steps:
        raise CadenzaError(f"{_named(run)}: has {run.steps} steps, but the song has {steps}")
    form = ArrayOf(FLOATS, (steps, len(low)), needed=True, finite=True)
    most = steps * len(low) * np.dtype(np.float64).itemsize + _HEADER
    actions: NDArray[Any] = read_tensors(path, {"action": form}, most)[0]["action"]
    if actions.dtype != np.float64:
        raise CadenzaError(f"{path}: holds {actions.dtype}; actions are float64")
    if outside := np.argwhere((actions < low) | (actions > high)).tolist():
        step, servo = outside[0]
        raise CadenzaError(f"{path}: action {servo} of step {step} is out of the servo's range")
    if actions_digest(actions) != run.actions:
        raise CadenzaError(f"{path}: holds other actions than the card says")
    return actions


def _differences(run: RecordedRun, found: Metrics) -> list[str]:
    return [
        f"{_named(run)}: {name} is {found[name]}, not {run.metrics[name]}"
        for name in METRICS
        if not _are_equal(run.metrics[name], found[name])
    ]


def _are_equal(said: float | None, found: float | None) -> bool:
    if said is None or found is None:
        return said is found
    return abs(said - found) <= _ROUNDING


def _mean_differences(card: Card, found: dict[tuple[str, int], Metrics]) -> list[str]:
    problems = []
    for name in _SHARES:
        said = float(np.mean([run.metrics[name] or 0.0 for run in card.runs]))
        here = float(np.mean([metrics[name] or 0.0 for metrics in found.values()]))
        if abs(said - here) > BOUND:
            problems.append(f"the mean of {name} is {here:.3f} here, not {said:.3f}")
    return problems


def _named(run: RecordedRun) -> str:
    return f"{run.song}, seed {run.seed}"
