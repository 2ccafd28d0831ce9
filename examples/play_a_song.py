"""Has the planner play a song, then an agent of our own, and compares how well they do.

python examples/play_a_song.py [SONG]
"""

from __future__ import annotations

import sys

import numpy as np

import cadenza


class Clumsy:
    """The planner with trembling hands: any class with these two methods is an agent."""

    def __init__(self) -> None:
        self._planner = cadenza.make_agent("planner")

    def reset(self, task, rng: np.random.Generator) -> None:
        self._planner.reset(task, rng)
        self._task, self._rng = task, rng

    def act(self) -> np.ndarray:
        action = self._planner.act() + self._rng.normal(0, 0.02, self._task.action_size)
        return np.clip(action, self._task.action_low, self._task.action_high)


song = sys.argv[1] if len(sys.argv) > 1 else "CMajorScaleOneHand"
for agent in ("planner", Clumsy()):
    performance = cadenza.play(song, agent)
    name = performance.settings["agent"]
    print(f"{name}: F1 {performance.metrics['f1']:.3f}")
    performance.save(f"played/{name}")  # report.html, played.mid, episode.npz, ...
