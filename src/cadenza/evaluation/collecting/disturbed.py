"""An agent whose hands are pushed: what it plays is not quite what it chose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Agent, Array
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State
from cadenza.tasks.view import View

_LASTS = 0.15  # [s] after which noise has fallen to 1 / e


class Disturbed(Agent):
    """Plays in one environment what another agent would, with noise, and keeps what that was.

    The agent sees where the noise has led, and corrects it.

    Attributes:
        chosen: (A + 1,) of each step, without noise, as float32.
        start: the state before the first step.
    """

    def __init__(self, agent: Agent, scene: Scene, noise: float) -> None:
        """`noise` is its standard deviation, of what the planner's search has for each servo."""
        self._agent = agent
        use = [scene.hand.servo(name).noise for name in servos_of(scene).names]
        self._sigma = noise * np.array([*use, 0.0])
        self.chosen: list[NDArray[np.float32]] = []
        self.start: State | None = None

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        (rng,) = rngs
        agent_rng, self._rng = rng.spawn(2)
        self._agent.progress = self.progress
        self._agent.reset(env_ids, [agent_rng])
        self._noise = np.zeros_like(self._sigma)
        self.chosen.clear()
        self.start = None

    def act(self, view: View) -> Array:
        task = view.task
        if self.start is None:
            self.start = view.state.copy()
        chosen = self._agent.act(view)[0]
        # A first-order autoregressive process, whose standard deviation is sigma.
        kept = np.exp(-task.config.control_timestep / _LASTS)
        fresh = np.sqrt(1 - kept**2) * self._sigma
        self._noise = kept * self._noise + fresh * self._rng.standard_normal(len(fresh))
        played = np.clip(chosen + self._noise, task.action_low, task.action_high)
        self.chosen.append(chosen.astype(np.float32))
        # What is recorded is exactly what is played, so that it can be played again.
        return played.astype(np.float32).astype(np.float64)[None]
