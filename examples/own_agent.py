"""An agent of one's own: the planner with trembling hands. docs/how-to/agent.md explains agents.

python examples/own_agent.py [SONG]

In the folder of this file:

cadenza play OdeToJoy --agent own_agent:Trembling --trembling.noise 0.05
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cadenza
import numpy as np


@dataclass(frozen=True)
class TremblingConfig:
    """The planner with trembling hands."""

    noise: float = 0.02
    """Standard deviation of the noise on every actuator [m or rad]."""


class Trembling(cadenza.Agent):
    """Does what the planner does, with noise on every actuator."""

    def __init__(self, config: TremblingConfig) -> None:
        if config.noise < 0:
            raise cadenza.CadenzaError(f"noise {config.noise}: choose 0 or more")
        self.config = config
        self._planner = cadenza.make_agent("planner")
        self._rngs: dict[int, np.random.Generator] = {}

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        self._planner.num_threads, self._planner.progress = self.num_threads, self.progress
        self._planner.reset(env_ids, rngs)
        self._rngs |= dict(zip(env_ids, rngs, strict=True))

    def act(self, view: cadenza.View) -> np.ndarray:
        size, rngs = view.task.action_size, self._rngs
        noise = [rngs[env].normal(0, self.config.noise, size) for env in view.env_ids.tolist()]
        action = self._planner.act(view) + noise
        return np.clip(action, view.task.action_low, view.task.action_high)

    def song_plan(self, env_id: int) -> Any:
        return self._planner.song_plan(env_id)  # its report shows fingers and missed notes

    def close(self) -> None:
        self._planner.close()


if __name__ == "__main__":
    song = sys.argv[1] if len(sys.argv) > 1 else "CMajorScaleOneHand"
    for agent in ("planner", Trembling(TremblingConfig())):
        performance = cadenza.play(song, agent)
        name = performance.settings["agent"]
        print(f"{name}: F1 {performance.metrics['f1']:.3f}")
        performance.save(f"played/{name}")  # report.html, played.mid, episode.npz, ...
