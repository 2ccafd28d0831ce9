"""The benchmark of learning: that the plain learner and ours do the same."""

from __future__ import annotations

from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from cadenza.agents.rl.config import LearnerConfig
from cadenza.agents.rl.droq import Learner, LearnerState
from cadenza.agents.rl.observation import Inputs
from cadenza.agents.rl.replay import Batch
from cadenza.bench.plain_droq import PlainBuffer, PlainLearner, PlainState

OBSERVATION, ACTION, BATCH, UPDATES = 30, 4, 64, 3


def transitions(number: int) -> Batch:
    rng = np.random.default_rng(0)
    return Batch(
        observation=rng.normal(size=(number, OBSERVATION)).astype(np.float32),
        action=rng.uniform(-1, 1, (number, ACTION)).astype(np.float32),
        reward=rng.normal(size=number).astype(np.float32),
        discount=(rng.random(number) < 0.8).astype(np.float32),
        next_observation=rng.normal(size=(number, OBSERVATION)).astype(np.float32),
    )


def named_plainly(ours: tuple[Any, ...], stacked: bool) -> Any:
    critics = [c["HiddenLayers_0"] | {"value": c["value"]} for c in ours]
    if stacked:
        return {"all": jax.tree.map(lambda *arrays: jnp.stack(arrays), *critics)}
    return {f"critic_{i}": critic for i, critic in enumerate(critics)}


def like(state: LearnerState, plain: PlainState, stacked: bool) -> PlainState:
    """The plain learner's state with our weights."""
    actor = state.actor["HiddenLayers_0"] | {n: state.actor[n] for n in ("mean", "log_std")}
    critics = named_plainly(state.critics, stacked)
    return plain._replace(actor=actor, critics=critics, targets=critics)


def moved(before: Any, after: Any) -> np.ndarray:
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True)
    return np.concatenate([np.ravel(np.asarray(b) - np.asarray(a)) for a, b in pairs])


@pytest.mark.parametrize("stacked", [True, False])
@pytest.mark.parametrize("activation", ["relu", "gelu"])
def test_the_plain_learner_does_what_ours_does(
    monkeypatch: pytest.MonkeyPatch, stacked: bool, activation: Any
) -> None:
    noise = np.random.default_rng(1).standard_normal((BATCH, ACTION)).astype(np.float32)
    # They split their keys differently.
    monkeypatch.setattr(jax.random, "normal", lambda key, shape: jnp.asarray(noise))
    inputs = Inputs(tuple(range(OBSERVATION)), OBSERVATION)
    learner = Learner(LearnerConfig(dropout=0.0, activation=activation), inputs, ACTION)
    plain = PlainLearner(
        OBSERVATION,
        ACTION,
        getattr(nn, activation),
        partial(nn.Dropout, 0.0, deterministic=False),
        stacked,
    )
    state = learner.initial_state(0)
    start = like(state, plain.initial_state(0), stacked)
    start = jax.tree.map(jnp.copy, start)  # our update uses its state up
    batch = transitions(BATCH)
    theirs = start
    for _ in range(UPDATES):
        state, figures = learner.update(state, Batch(*(part[None] for part in batch)))
        theirs, plain_figures = plain.update(theirs, batch)
        assert figures.keys() == plain_figures.keys()
        for name, value in plain_figures.items():
            assert_allclose(figures[name][0], value, rtol=1e-4, err_msg=name)
    ours = like(state, theirs, stacked)._replace(targets=named_plainly(state.targets, stacked))
    for name in ("actor", "critics", "targets"):
        by_ours = moved(getattr(start, name), getattr(ours, name))
        by_theirs = moved(getattr(start, name), getattr(theirs, name))
        assert np.abs(by_ours).mean() > 0
        assert np.abs(by_ours - by_theirs).mean() < 0.01 * np.abs(by_ours).mean(), name


def test_the_plain_buffer_keeps_the_newest() -> None:
    batch = transitions(5)
    buffer = PlainBuffer(OBSERVATION, ACTION, 3)
    for transition in zip(*batch, strict=True):
        buffer.insert(Batch(*transition))
    drawn = buffer.sample(np.random.default_rng(0), 100)
    assert buffer.nbytes == 3 * 4 * (2 * OBSERVATION + ACTION + 2)
    assert set(drawn.reward.tolist()) == set(batch.reward[2:].tolist())
    for column, values in zip(drawn, batch, strict=True):
        at = [batch.reward.tolist().index(reward) for reward in drawn.reward.tolist()]
        assert_allclose(column, values[at])
