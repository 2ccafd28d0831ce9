"""Has the planner play a song, then an agent of our own, and compares how well they do.

python examples/play_a_song.py [SONG]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

import cadenza


class Clumsy(cadenza.Agent):
    """The planner with trembling hands."""

    def __init__(self) -> None:
        self._planner = cadenza.make_agent("planner")

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        self._planner.reset(env_ids, rngs)
        self._rng = rngs[0]

    def act(self, view: cadenza.View) -> np.ndarray:
        action = self._planner.act(view)
        action = action + self._rng.normal(0, 0.02, action.shape)
        return np.clip(action, view.task.action_low, view.task.action_high)


song = sys.argv[1] if len(sys.argv) > 1 else "CMajorScaleOneHand"
for agent in ("planner", Clumsy()):
    performance = cadenza.play(song, agent)
    name = performance.settings["agent"]
    print(f"{name}: F1 {performance.metrics['f1']:.3f}")
    performance.save(f"played/{name}")  # report.html, played.mid, episode.npz, ...
