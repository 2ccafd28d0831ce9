"""Small songs, tasks and learners."""

from typing import Any

import flax.linen as nn
import jax
import numpy as np

from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.replay_buffer import Batch
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.tasks.piano_task import PianoTask

TINY = DroQConfig(hidden_sizes=(16,), batch_size=8, dropout=0.1)


def melody(*pitches: int, length: float = 0.2, pedal: bool = False) -> Score:
    """One note after the other, with the pedal down in the middle if asked for."""
    events = (PedalEvent(length, 127), PedalEvent(2 * length, 0)) if pedal else ()
    notes = (Note(i * length, (i + 1) * length, p) for i, p in enumerate(pitches))
    return Score(tuple(notes), events)


def reset(task: PianoTask, seed: int = 0) -> None:
    """Begins an episode in every environment."""
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
