"""A learnt policy, and the agent that plays it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cadenza.agents.agent import Agent, Array
from cadenza.errors import CadenzaError
from cadenza.learning.actions import ActionMapping, Reference
from cadenza.learning.observation import GoalTable, Inputs, ObservationSpec, Observer
from cadenza.learning.policy import Policy
from cadenza.learning.ranges import Ranges
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.view import TaskSpec, View

_HANDS = "keyboard", "hand", "hands", "reduced_action_space", "forearm_dofs"
_REFERENCE_OPTIONS = (
    *("control_timestep", "trim_silence", "stretch", "transpose", "initial_buffer_time"),
    *("random_hand_position", "random_stretch", "random_pitch_shift", "random_octave_shift"),
    *(*_HANDS, "hand_spacing", "attachment_yaw"),
)
_OBSERVATION_OPTIONS = (
    *("n_steps_lookahead", "n_seconds_lookahead", "control_timestep", "fingering", "onset_goals"),
    *(*_HANDS, "touch"),
)


@dataclass(frozen=True)
class LearntPolicy:
    """A policy and everything needed to play with it."""

    policy: Policy
    observation: ObservationSpec
    inputs: Inputs
    """The entries of the observation that it is given."""
    reference: Reference | None
    """The trajectory that a residual policy corrects."""
    ranges: Ranges | None
    """The scale of its joints and actions, if not the task's."""
    task: TaskConfig
    scene: SceneConfig
    score: Score | None
    """The song it was trained on, None for a policy of many."""
    learner: str | None = None
    """The name of the learner that reads the policy, None for a `Perceptron`."""

    @property
    def agent(self) -> PolicyAgent:
        """The agent that plays it."""
        return PolicyAgent(self)

    @property
    def residual(self) -> bool:
        """True if it corrects a reference, which is that of one song."""
        return self.reference is not None

    def check(self, name: str, task: TaskSpec) -> None:
        """Check that the policy can play a task.

        Raises CadenzaError, in which the policy is called `name`, if its reference or its
        observation does not fit the task.
        """
        options: tuple[str, ...] = _REFERENCE_OPTIONS if self.residual else ()
        sees_the_same = self.observation == ObservationSpec.of(task, self.residual)
        if not sees_the_same:
            options += _OBSERVATION_OPTIONS
        own = vars(self.task) | vars(self.scene)
        others = vars(task.config) | vars(task.scene.config)
        for option in options:
            if option not in own or others[option] != own[option]:
                raise CadenzaError(
                    f"{name}: was trained with {option} {own.get(option)}, but here it is "
                    f"{others[option]}; leave out that option, or train a new policy"
                )
        if not sees_the_same:
            raise CadenzaError(
                f"{name}: was trained to observe other things than this task shows; use the hands "
                "and the keyboard that it was trained with"
            )


class PolicyAgent(Agent):
    """Play the mode of a policy, in all environments at once."""

    def __init__(self, learnt: LearntPolicy) -> None:
        """Prepare nothing before the first step."""
        self._learnt = learnt
        self._task: TaskSpec | None = None
        self._begun: set[int] = set()
        self._first_row = np.zeros(0, np.intp)
        self._action = np.zeros((0, 0), np.float32)

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        self._begun.update(env_ids)

    def act(self, view: View) -> Array:
        """The policy's actions (N, A) in actuator units.

        Raises CadenzaError as `LearntPolicy.check`, or if the song is of another length than the
        reference.
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
        self._action = np.asarray(self._learnt.policy.mode(observation), np.float32)
        return self._mapping.ctrl(self._action, step, view.state, view.goal[:, 0, -1])

    def _prepare(self, view: View) -> None:
        """Get ready for another task."""
        learnt, task = self._learnt, view.task
        learnt.check("the policy", task)
        for steps in view.num_steps.tolist():
            if learnt.reference is not None and len(learnt.reference.ctrl) != steps:
                raise CadenzaError(
                    f"the policy corrects a plan of {len(learnt.reference.ctrl)} steps, but this "
                    f"task has {steps}: it can only play the song that it was trained on"
                )
        self._task = task
        self._mapping = ActionMapping(task, learnt.reference, learnt.ranges)
        self._goals = GoalTable(task)
        self._observer = Observer(
            task, self._goals, learnt.inputs, self._mapping.reference, learnt.ranges
        )
        num_envs = len(view.env_ids)
        self._action = np.zeros((num_envs, task.action_size), np.float32)
        self._first_row = np.zeros(num_envs, np.intp)
        self._begun = set(range(num_envs))
