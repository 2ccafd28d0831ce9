"""Small songs, tasks and learners."""

from collections.abc import Sequence
from contextlib import closing
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import numpy as np

import melodies
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.config import TrainingConfig
from cadenza.learning.problem import problem_of
from cadenza.learning.replay_buffer import Batch
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import Training
from cadenza.music.score import Score
from cadenza.tasks.piano_task import PianoTask
from rounds import so_often

TINY = DroQConfig(hidden_sizes=(16,), batch_size=8, dropout=0.1)


melody = partial(melodies.melody, length=0.2)


def train(
    config: TrainingConfig, run: RunFolder, songs: Sequence[Score], stops: Sequence[int] = ()
) -> None:
    """Train to the end, closed and opened again after these numbers of rounds."""
    for rounds in (*stops, 10**9):
        with closing(Training(problem_of(config, songs), run)) as one:
            one.run(so_often(rounds))


def reset(task: PianoTask, seed: int = 0) -> None:
    """Begin an episode in every environment."""
    task.reset(np.random.default_rng(seed).spawn(task.num_envs), range(task.num_envs))


def random_batches(
    rng: np.random.Generator, shape: tuple[int, ...], inputs: int, actions: int
) -> Batch:
    """Transitions (*shape, ...) of which one in four terminates."""

    def normal(*more: int) -> Any:
        return rng.standard_normal((*shape, *more)).astype(np.float32)

    return Batch(
        observation=normal(inputs),
        action=np.tanh(normal(actions)),
        reward=normal(),
        discount=(rng.random(shape) < 0.75).astype(np.float32),
        next_observation=normal(inputs),
    )


def random_params(
    network: nn.Module, rng: np.random.Generator, *inputs: Any, size: float = 0.4
) -> Any:
    """Weights, biases and scales of a network, none of them as they begin."""
    keys = {"params": jax.random.key(0), "dropout": jax.random.key(0)}
    shapes = jax.eval_shape(network.init, keys, *inputs)["params"]
    return jax.tree.map(lambda x: rng.normal(0, size, x.shape).astype(np.float32), shapes)
