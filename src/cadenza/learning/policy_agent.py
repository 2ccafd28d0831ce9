"""A learnt policy as an agent that plays."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from cadenza.agents.agent import Agent, Array
from cadenza.errors import CadenzaError
from cadenza.learning.actions import ActionMapping, Reference
from cadenza.learning.observation import GoalTable, Inputs, ObservationSpec, Observer
from cadenza.learning.policy import Policy
from cadenza.learning.ranges import Ranges
from cadenza.tasks.view import TaskSpec, View


class PolicyAgent(Agent):
    """Play the mode of a policy, in all environments at once."""

    def __init__(
        self,
        policy: Policy,
        observation: ObservationSpec,
        inputs: Inputs,
        reference: Reference | None,
        ranges: Ranges | None,
    ) -> None:
        """Prepare nothing before the first step.

        The policy is given the `inputs` of the observation with which it was trained, scaled by
        `ranges`, if not the task's, and corrects a `reference` if it is residual.
        """
        self._policy, self._observation, self._inputs = policy, observation, inputs
        self._reference, self._ranges = reference, ranges

        self._task: TaskSpec | None = None
        self._begun: set[int] = set()
        self._first_row = np.zeros(0, np.intp)
        self._action = np.zeros((0, 0), np.float32)

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        self._begun.update(env_ids)

    def act(self, view: View) -> Array:
        """The policy's actions (N, A) in actuator units.

        Raises CadenzaError if the task shows other things than the policy was trained to observe,
        or is of another length than its reference.
        """
        if view.task is not self._task:
            self._prepare(view)
        for env in self._begun:
            self._first_row[env] = self._goals.add(view.tracks[env])
        self._begun.clear()
        step = np.minimum(view.steps, view.num_steps - 1)
        observation = self._observer.observation(
            self._first_row + step,
            self._observer.proprioception(view.observation),
            self._action,
            view.reward.astype(np.float32),
            view.steps == 0,
        )
        self._action = np.asarray(self._policy.mode(observation), np.float32)
        return self._mapping.ctrl(self._action, step, view.state, view.goal[:, 0, -1])

    def _prepare(self, view: View) -> None:
        """Get ready for another task."""
        self._check_fits(view)
        self._task = task = view.task
        self._mapping = ActionMapping(task, self._reference, self._ranges)
        self._goals = GoalTable(task)
        self._observer = Observer(
            task, self._goals, self._inputs, self._mapping.reference, self._ranges
        )
        self._action = np.zeros((len(view.env_ids), task.action_size), np.float32)
        self._first_row = np.zeros(len(view.env_ids), np.intp)
        self._begun = set(range(len(view.env_ids)))

    def _check_fits(self, view: View) -> None:
        reference = self._reference
        here = ObservationSpec.of(view.task, residual=reference is not None)
        for name, size in asdict(self._observation).items():
            if size != getattr(here, name):
                raise CadenzaError(
                    f"the policy has learnt with a {name.replace('_', ' ')} of {size} numbers, but "
                    f"that of this task has {getattr(here, name)}: use the task and scene options "
                    "that it was trained with"
                )
        for steps in view.num_steps.tolist():
            if reference is not None and len(reference.ctrl) != steps:
                raise CadenzaError(
                    f"the policy corrects a plan of {len(reference.ctrl)} steps, but this task has "
                    f"{steps}: it can only play the song that it was trained on"
                )
