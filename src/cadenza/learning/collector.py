"""Collection of experience in N environments, for the replay buffer."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.learning.actions import ActionMapping
from cadenza.learning.observation import Floats, GoalTable, Observer
from cadenza.learning.policy import Policy
from cadenza.learning.replay_buffer import ReplayBuffer, Rows
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.reward import Transition

Array = NDArray[np.float64]


class Finished(NamedTuple):
    """An episode that ended while gathering experience."""

    f1: float
    note_onset_f1: float  # NaN where no notes are counted: on a device
    total_reward: float


class Step(NamedTuple):
    """The result of a control step of N environments."""

    transition: Transition
    # (N, D) after the step, before the next episode began where one has ended
    final_observation: Floats
    finished: list[Finished]  # the episodes that ended


class Collector:
    """Gather experience in N environments.

    Attributes:
        observation: The policy's present observations (N, D).
    """

    observation: Floats

    def __init__(
        self,
        task: PianoTask,
        goals: GoalTable,
        observer: Observer,
        replay: ReplayBuffer | None,
        mapping: ActionMapping,
        rng: np.random.Generator,
    ) -> None:
        """Collect nothing before `begin` or `restore`.

        Scores of episodes are added to `goals`, and experience to `replay`, if it is kept.
        `mapping` leads from the policy's actions to controls; actions and environments draw from
        `rng`.
        """
        self._task, self._goals, self._observer = task, goals, observer
        self._replay, self._mapping = replay, mapping
        self._rng, *self._env_rngs = rng.spawn(1 + task.num_envs)
        self._env_ids = np.arange(task.num_envs)
        self._action = np.zeros((task.num_envs, task.spec.action_size), np.float32)
        self._reward = np.zeros(task.num_envs, np.float32)
        self._return = np.zeros(task.num_envs)
        self._first_row = np.zeros(task.num_envs, np.int64)
        self._actions_so_far: list[list[Floats]] = [[] for _ in self._env_ids]
        self._rng_states: list[dict[str, Any]] = [{} for _ in self._env_ids]

    def begin(self) -> None:
        """Begin an episode in every environment."""
        self._reset(self._env_ids)
        self._observe(self._env_ids)

    def collect(self, policy: Policy | None, steps: int) -> list[Finished]:
        """Take steps in every environment, uniformly at random without a policy.

        Returns the episodes that ended.
        """
        finished = []
        for _ in range(steps):
            if policy is None:
                action = self._rng.uniform(-1, 1, self._action.shape).astype(np.float32)
            else:
                action = np.asarray(policy.sample(self.observation, self._rng), np.float32)
            finished += self.step(action).finished
        return finished

    def step(self, action: Floats) -> Step:
        """Take a control step with actions (N, A) in [-1, 1] in every environment.

        Where an episode has ended, the next one begins.
        """
        result = self._step_task(action)
        if self._replay is not None:
            self._replay.act(action, self._reward, result.terminated)
        ended = np.flatnonzero(result.terminated | result.truncated)
        finished = []
        for env in ended.tolist():
            metrics = self._task.episode_metrics(env)
            scores = metrics["f1"], metrics["note_onset_f1"]
            finished.append(Finished(*scores, float(self._return[env])))
        final = None
        if finished:
            self._observe(ended)  # the last of an episode, then the first of the next
            final = self.observation
            self._reset(ended)
        self._observe(self._env_ids)
        return Step(result, self.observation if final is None else final, finished)

    def _step_task(self, action: Floats, env_ids: list[int] | None = None) -> Transition:
        task = self._task
        pedal = task.goals.upcoming.goal[:, 0, -1]
        ctrl = self._mapping.ctrl(action, task.goals.row, task.sensed, pedal)
        result = task.step(ctrl, env_ids)
        moving = self._env_ids if env_ids is None else env_ids
        self._action[moving] = action[moving]
        self._reward[moving] = result.reward[moving]
        self._return[moving] += result.reward[moving]
        for env in moving:
            self._actions_so_far[env].append(action[env])
        return result

    def _reset(self, env_ids: Rows) -> None:
        for env in env_ids:
            self._rng_states[env] = self._env_rngs[env].bit_generator.state
            self._actions_so_far[env] = []
        self._task.reset([self._env_rngs[env] for env in env_ids], env_ids.tolist())
        goals = self._task.goals
        for env in env_ids.tolist():
            self._first_row[env] = self._goals.add(goals.tracks[env])
        self._return[env_ids] = 0.0

    def _observe(self, env_ids: Rows) -> None:
        goals = self._task.goals
        row, first = self._first_row + goals.row, goals.steps_done == 0
        proprioception = self._observer.proprioception(self._task.observation())
        if self._replay is not None:
            self._replay.observe(env_ids, proprioception[env_ids], row[env_ids], first[env_ids])
        self.observation = self._observer.observation(
            row, proprioception, self._action, self._reward, first
        )

    # To go on later

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """The state as JSON and arrays, for `restore`."""
        plain = {"action_rng": self._rng.bit_generator.state, "began": self._rng_states}
        taken = [np.array(actions, np.float32) for actions in self._actions_so_far]
        return plain, {f"taken_{env}": actions for env, actions in enumerate(taken)}

    def restore(self, plain: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        """Play the unfinished episodes again, with the same actions.

        The simulation repeats itself to the last bit, and its state need not be kept. The replay
        is to be restored before.
        """
        for rng, began in zip(self._env_rngs, plain["began"], strict=True):
            rng.bit_generator.state = began
        self._reset(self._env_ids)
        taken = [arrays[f"taken_{env}"] for env in self._env_ids]
        for step in range(max(map(len, taken))):
            moving = [env for env, actions in enumerate(taken) if step < len(actions)]
            action = np.zeros_like(self._action)
            action[moving] = [taken[env][step] for env in moving]
            self._step_task(action, moving)
        self._rng.bit_generator.state = plain["action_rng"]
        self._observe(self._env_ids)
