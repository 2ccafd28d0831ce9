"""Measures how well and how quickly the planner plays the bundled pieces, or any.

    python -m benchmarks.repertoire [SONG ...] [--seeds 5]

Prints a table in Markdown, a row as soon as a piece is done. Time is that of planning, playing and
simulating together, over that of the music.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import get_args

import numpy as np

from benchmarks.arguments import one_or_more
from cadenza.agents.planner.config import PlannerConfig, Refinement
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import play_episode
from cadenza.errors import errors_in_a_line
from cadenza.music.libraries.library import load_score, songs
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

_METRICS = ("f1", "precision", "recall", "note_onset_f1")


def measure(
    song: str, seeds: int, config: PlannerConfig, silence: float
) -> tuple[dict[str, float], float, float]:
    """Means over seeds of the metrics, the least F1, and time over that of the music."""
    task = PianoTask([load_score(song)], TaskConfig(initial_buffer_time=silence))
    played = []
    started = time.perf_counter()
    for seed in range(seeds):
        played.append(play_episode(task, Planner(config), seed).metrics)
    took = time.perf_counter() - started
    task.close()
    music = sum(metrics["steps"] for metrics in played) * task.config.control_timestep
    means = {name: float(np.mean([metrics[name] for metrics in played])) for name in _METRICS}
    return means, min(metrics["f1"] for metrics in played), took / music


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("songs", nargs="*", help="bundled pieces or MIDI files; all bundled ones")
    parser.add_argument("--seeds", type=one_or_more, default=5, help="0 to N - 1")
    parser.add_argument(
        "--method",
        choices=get_args(Refinement),
        default=PlannerConfig().method,
    )
    parser.add_argument("--initial-buffer-time", type=float, default=0.5, help="[s]")
    options = parser.parse_args()
    config = PlannerConfig(method=options.method)
    print("| piece | F1 | least | precision | recall | note onsets | time / music |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for song in options.songs or [piece.name for piece in songs()]:
        means, least, ratio = measure(song, options.seeds, config, options.initial_buffer_time)
        f1, precision, recall, onsets = (means[name] for name in _METRICS)
        print(
            f"| {Path(song).stem} | {f1:.3f} | {least:.3f} | {precision:.3f} | {recall:.3f} "
            f"| {onsets:.3f} | {ratio:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
