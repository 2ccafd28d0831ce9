"""A learnt policy as an agent that plays."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.rl.observation import Inputs, Observer, Scores
from cadenza.agents.rl.policy import Policy
from cadenza.agents.rl.residual import PlanFollower
from cadenza.tasks.piano_task import PianoTask


class PolicyAgent:
    """Does what the policy finds best."""

    def __init__(self, policy: Policy, inputs: Inputs, residual: bool) -> None:
        """Args:
        policy: what was learnt.
        inputs: what it observes.
        residual: whether it corrects the plan of the song.
        """
        self._policy, self._inputs, self._residual = policy, inputs, residual

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        """Raises:
        CadenzaError: the task shows other things than the policy has learnt to observe.
        """
        self._task = task
        self._follower = PlanFollower(task, task.sheets.songs[0]) if self._residual else None
        sheets, scores = task.sheets, Scores(task)
        scores.add(*sheets.part(0, 0, int(sheets.num_steps[0])))
        plan = self._follower.actions if self._follower else None
        self._observer = Observer(task, scores, self._inputs, plan)
        self._action = np.zeros((1, task.action_size), np.float32)

    def act(self) -> Array:
        """(A,) as an `Agent`."""
        task = self._task
        observation = self._observer.observation(
            task.sheets.row,
            self._observer.rest(task),
            self._action,
            task.reward.astype(np.float32),
            task.sheets.steps_done == 0,
        )
        self._action = self._policy.best(observation)
        if self._follower:
            return self._follower.ctrl(task, self._action)[0]
        return task.scale_action(self._action)[0]
