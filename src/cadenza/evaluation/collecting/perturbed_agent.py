"""An agent with noise on its actions, so that demonstrations show how to recover."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Agent, Array
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State
from cadenza.tasks.view import View, observed_key_onsets

_NOISE_TIME = 0.15  # [s] after which noise has fallen to 1 / e
_TURN = 1.0  # [s] mean duration of a turn of the agent or the student
_STUDENT_SHARE = 0.5  # share of the turns in which the student plays


class Shown(NamedTuple):
    """Observations of one environment that do not follow from the recorded states."""

    pedal: float  # position of the pedal, 0 to 1; actions may arrive late
    # (K,) onsets of keys in the last step, see `observed_key_onsets`
    key_onset: NDArray[np.float32]
    key_velocity: NDArray[np.float32]  # (K,) velocities of these onsets


def shown_by(view: View) -> Shown:
    """These observations of the only environment of a view, without noise."""
    task = view.task
    pedal = float(view.observation[0, task.observation_layout["pedal"]][0])
    dt, keyboard = task.config.control_timestep, task.scene.keyboard
    onset, velocity = observed_key_onsets(view.simulation.state, keyboard, dt)
    return Shown(pedal, onset[0], velocity[0])


class PerturbedAgent(Agent):
    """An agent that adds noise to another agent's actions in one environment, and keeps both.

    The other agent sees the states to which noise has led, and corrects them. A student plays half
    of the time, if there is one, and the agent sees its states, too (DAgger: Ross, Gordon &
    Bagnell, A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
    Learning, 2011).

    Attributes:
        chosen: (A + 1,) of each step, without noise, in actuator units, as float32.
        played: (A + 1,) of each step, with noise, from -1 to 1, as float32.
        shown: observations before each step.
        start: the state before the first step.
    """

    def __init__(
        self, agent: Agent, scene: Scene, noise: float, student: Agent | None = None
    ) -> None:
        """Take the standard deviation of the noise in units of that of the planner's search."""
        self._agent, self._student = agent, student
        self._sigma = noise * np.append(servos_of(scene).noise, 0.0)
        self.chosen: list[NDArray[np.float32]] = []
        self.played: list[NDArray[np.float32]] = []
        self.shown: list[Shown] = []
        self.start: State | None = None
        self._students_turn = False

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        (rng,) = rngs
        agent_rng, self._rng = rng.spawn(2)
        self._agent.progress = self.progress
        self._agent.reset(env_ids, [agent_rng])
        if self._student is not None:
            self._student.reset(env_ids, self._rng.spawn(1))
            self._students_turn = self._rng.random() < _STUDENT_SHARE
        self._noise = np.zeros_like(self._sigma)
        self.chosen.clear()
        self.played.clear()
        self.shown.clear()
        self.start = None

    def act(self, view: View) -> Array:
        task = view.task
        if self.start is None:
            self.start = view.simulation.state.copy()
        self.shown.append(shown_by(view))
        chosen = self._agent.act(view)[0]
        # A first-order autoregressive process, whose standard deviation is sigma.
        decay = np.exp(-task.config.control_timestep / _NOISE_TIME)
        sigma = np.sqrt(1 - decay**2) * self._sigma
        self._noise = decay * self._noise + sigma * self._rng.standard_normal(len(sigma))
        played = np.clip(
            self._agent_or_student(chosen, view) + self._noise, task.action_low, task.action_high
        )
        within = np.clip(chosen, task.action_low, task.action_high)
        self.chosen.append(within.astype(np.float32))
        # Recorded in the units of environments, so that they can play exactly the same.
        self.played.append(task.unscale_action(played).astype(np.float32))
        return task.scale_action(self.played[-1])[None]

    def song_plan(self, env_id: int) -> Any:
        return self._agent.song_plan(env_id)

    def close(self) -> None:
        """Close the student; the agent belongs to the caller."""
        if self._student is not None:
            self._student.close()

    def _agent_or_student(self, chosen: Array, view: View) -> Array:
        """The action (A + 1,) of the agent, or of the student where it is its turn."""
        if self._student is None:
            return chosen
        if self._rng.random() < view.task.config.control_timestep / _TURN:
            self._students_turn = self._rng.random() < _STUDENT_SHARE
        student = self._student.act(view)[0]
        return student if self._students_turn else chosen
