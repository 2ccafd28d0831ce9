"""A learnt policy as an agent that plays."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from cadenza.agents.agent import Array
from cadenza.errors import CadenzaError
from cadenza.learning.control import control_of
from cadenza.learning.observation import Inputs, ObservationSpec, Observer, Scores
from cadenza.learning.policy import Policy
from cadenza.learning.ranges import Ranges
from cadenza.learning.residual import Reference
from cadenza.tasks.piano_task import PianoTask


class PolicyAgent:
    """Does what the policy finds best."""

    def __init__(
        self,
        policy: Policy,
        observation: ObservationSpec,
        inputs: Inputs,
        reference: Reference | None,
        ranges: Ranges | None,
    ) -> None:
        """Args:
        policy: what was learnt.
        observation: what it has learnt to observe.
        inputs: which of that it is given.
        reference: what it corrects, if it does.
        ranges: on whose scale it sees and acts, if not on the task's.
        """
        self._policy, self._observation, self._inputs = policy, observation, inputs
        self._reference, self._ranges = reference, ranges

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        """Raises:
        CadenzaError: the task shows other things than the policy has learnt to observe, or the
            policy corrects what is for another one.
        """
        self._task = task
        self._check_fits(task)
        self._control = control_of(task, self._reference, self._ranges)
        sheets, scores = task.sheets, Scores(task)
        scores.add(*sheets.part(0, 0, int(sheets.num_steps[0])))
        self._observer = Observer(task, scores, self._inputs, self._control.reference, self._ranges)
        self._action = np.zeros((1, task.action_size), np.float32)

    def _check_fits(self, task: PianoTask) -> None:
        reference = self._reference
        here = ObservationSpec.of(task, residual=reference is not None)
        for name, size in asdict(self._observation).items():
            if size != getattr(here, name):
                raise CadenzaError(
                    f"the policy has learnt with a {name.replace('_', ' ')} of {size} numbers, but "
                    f"that of this task has {getattr(here, name)}: use the task and scene options "
                    "that it was trained with"
                )
        steps = int(task.sheets.num_steps[0])
        if reference is not None and len(reference.ctrl) != steps:
            raise CadenzaError(
                f"the policy corrects a plan of {len(reference.ctrl)} steps, but this task has "
                f"{steps}: it can only play the song that it was trained on"
            )

    def act(self) -> Array:
        """(A,) as an `Agent`."""
        task = self._task
        observation = self._observer.observation(
            task.sheets.row,
            self._observer.proprioception(task),
            self._action,
            task.reward.astype(np.float32),
            task.sheets.steps_done == 0,
        )
        self._action = self._policy.mode(observation)
        return self._control.ctrl(self._action)[0]
