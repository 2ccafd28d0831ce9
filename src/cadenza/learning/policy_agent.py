"""A learnt policy as an agent that plays."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array
from cadenza.errors import CadenzaError
from cadenza.learning.control import control_of
from cadenza.learning.observation import Inputs, Observer, Scores
from cadenza.learning.policy import Policy
from cadenza.learning.ranges import Ranges
from cadenza.learning.residual import Plan
from cadenza.tasks.piano_task import PianoTask


class PolicyAgent:
    """Does what the policy finds best."""

    def __init__(
        self, policy: Policy, inputs: Inputs, plan: Plan | None, ranges: Ranges | None
    ) -> None:
        """Args:
        policy: what was learnt.
        inputs: what it observes.
        plan: what it corrects, if it does.
        ranges: on whose scale it sees and acts, if not on the task's.
        """
        self._policy, self._inputs = policy, inputs
        self._plan, self._ranges = plan, ranges

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        """Raises:
        CadenzaError: the task shows other things than the policy has learnt to observe, or the
            policy corrects a plan for another one.
        """
        self._task = task
        self._check_fits(task)
        self._control = control_of(task, self._plan, self._ranges)
        sheets, scores = task.sheets, Scores(task)
        scores.add(*sheets.part(0, 0, int(sheets.num_steps[0])))
        self._observer = Observer(task, scores, self._inputs, self._control.plan, self._ranges)
        self._action = np.zeros((1, task.action_size), np.float32)

    def _check_fits(self, task: PianoTask) -> None:
        steps, actions = int(task.sheets.num_steps[0]), task.action_size
        shown = task.observation_layout.get("joints", slice(0, 0))  # none without hands
        joints = shown.stop - shown.start
        plan, ranges = self._plan, self._ranges
        known = len(ranges.joints[0]) if ranges else joints
        if (self._policy.num_actions, known) != (actions, joints):
            raise CadenzaError(
                f"the policy moves {known} joints with {self._policy.num_actions} actions, but "
                f"this task has {joints} joints and {actions} actions: use the task and scene "
                "options that it was trained with"
            )
        planned = (steps, actions - 1, steps + 1)
        if plan is not None and (*plan.ctrl.shape, len(plan.expected)) != planned:
            raise CadenzaError(
                f"the policy corrects a plan of {len(plan.ctrl)} steps and {plan.ctrl.shape[1]} "
                f"servos, but this task has {steps} and {actions - 1}: it can only play the song "
                "that it was trained on"
            )

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
        return self._control.ctrl(self._action)[0]
