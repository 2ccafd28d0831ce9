"""Trains a policy by rollouts of its own, which are not kept."""

from __future__ import annotations

from typing import Any

import numpy as np

from cadenza.errors import CadenzaError, extra_packages
from cadenza.learning.actions import ActionMapping
from cadenza.learning.algorithms.on_jax import start_jax
from cadenza.learning.collector import Collector
from cadenza.learning.observation import Inputs, Observer
from cadenza.learning.run_folder import Checkpoint
from cadenza.learning.training import Training
from cadenza.learning.worlds import HostWorlds, Worlds
from cadenza.sim.threads import available_cores
from cadenza.tasks.piano_task import PianoTask

_MOST_SEED = 2**31


class OnPolicyTraining(Training):
    """A run of training by rollouts, on CPU cores or all on one device."""

    def _new_task(self) -> PianoTask:
        """Returns the task of the environments that learn; those on a device have their own."""
        if self.config.scene.engine == "warp":
            return self._task_of(self._scores)
        return self._task_of(self._scores, self.config.num_envs, available_cores())

    def _kept(self, inputs: Inputs) -> Inputs:
        """Leaves out the previous action and its reward: the state has what follows from them."""
        layout = self._observation.layout
        left_out = range(layout["previous_action"].start, layout["previous_reward"].stop)
        return Inputs(tuple(i for i in inputs.kept if i not in left_out), inputs.total)

    def _make_worlds(
        self, observer: Observer, mapping: ActionMapping, rng: np.random.Generator
    ) -> Worlds:
        start_jax()  # before the device's task does, with as many threads as there are
        if self.config.scene.engine == "c":
            return HostWorlds(Collector(self._task, self._goals, observer, None, mapping, rng))
        with extra_packages("gpu", "the engine warp"):
            from cadenza.learning.device_worlds import DeviceWorlds
            from cadenza.tasks.functional import FunctionalPianoTask
        task = FunctionalPianoTask(
            self._scores, self.config.task, self._task.scene, self.config.num_envs
        )
        seed = int(rng.integers(_MOST_SEED))
        return DeviceWorlds(task, self._inputs, self._ranges, seed)

    @property
    def _most_experience(self) -> None:
        return None

    def _round(self) -> None:
        config = self.config
        seed = int(self._sample_rng.integers(_MOST_SEED))
        rollout, finished, metrics = self._worlds.rollout(
            self._learner, self._state, config.train_freq, seed
        )
        self._state, updates = self._learner.update(self._state, rollout, self._rows())
        each = {name: np.asarray(values) for name, values in updates.items()}
        each |= {name: np.full(config.gradient_steps, value) for name, value in metrics.items()}
        self._metrics.append(each)
        self._finished += finished
        self._updates += config.gradient_steps
        self.step += config.train_freq * config.num_envs
        self._update_policy()

    def _rows(self) -> Any:
        """Returns rows (U, B) of a rollout, each as often as the others but for once."""
        config = self.config
        steps = config.train_freq * config.num_envs
        wanted = config.gradient_steps * config.learner.batch_size
        passes = -(-wanted // steps)
        orders = np.concatenate([self._sample_rng.permutation(steps) for _ in range(passes)])
        return orders[:wanted].reshape(config.gradient_steps, -1).astype(np.int32)

    def _save_experience(self) -> None:
        """A rollout has been learnt from before a checkpoint is written."""

    def _restore_experience(self, checkpoint: Checkpoint) -> None:
        if checkpoint.facts.replay:
            raise CadenzaError(f"{self._folder.path}: holds experience of another kind of learner")
