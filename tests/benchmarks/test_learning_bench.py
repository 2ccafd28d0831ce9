"""The benchmark of learning: that the plain learner and ours do the same."""

from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks import plain_droq
from benchmarks.plain_droq import PlainBuffer, PlainLearner, PlainState
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.droq.learner import DroQ, DroQState
from cadenza.learning.observation import Inputs
from cadenza.learning.replay_buffer import Batch

OBSERVATION, ACTION, BATCH, UPDATES = 30, 4, 64, 3
NETWORKS = ("actor", "critics", "target_critics")


def transitions(number: int) -> Batch:
    rng = np.random.default_rng(0)
    return Batch(
        observation=rng.normal(size=(number, OBSERVATION)).astype(np.float32),
        action=rng.uniform(-1, 1, (number, ACTION)).astype(np.float32),
        reward=rng.normal(size=number).astype(np.float32),
        discount=(rng.random(number) < 0.8).astype(np.float32),
        next_observation=rng.normal(size=(number, OBSERVATION)).astype(np.float32),
    )


def shapes(learner: DroQ | PlainLearner) -> Any:
    return jax.eval_shape(partial(learner.init, 0))


def drawn(learner: DroQ) -> DroQState:
    """A state that begins anywhere; drawing it here saves compiling how it is drawn."""
    rng, state = np.random.default_rng(2), shapes(learner)
    weights = {
        name: jax.tree.map(
            lambda x: jnp.asarray(0.2 * rng.standard_normal(x.shape), x.dtype), getattr(state, name)
        )
        for name in NETWORKS
    }
    rest = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), state)
    return rest._replace(**weights)


def named_plainly(state: DroQState, stacked: bool) -> dict[str, Any]:
    """Our weights as the plain learner has them."""

    def critics(ours: tuple[Any, ...]) -> Any:
        each = [c["HiddenLayers_0"] | {"value": c["value"]} for c in ours]
        if stacked:
            return {"all": jax.tree.map(lambda *arrays: jnp.stack(arrays), *each)}
        return {f"critic_{i}": critic for i, critic in enumerate(each)}

    actor = state.actor["HiddenLayers_0"] | {n: state.actor[n] for n in ("mean", "log_std")}
    weights = {
        "actor": actor,
        "critics": critics(state.critics),
        "target_critics": critics(state.target_critics),
    }
    return jax.tree.map(jnp.copy, weights)  # our update uses its state up


def as_plain(learner: PlainLearner, weights: dict[str, Any]) -> PlainState:
    """A state of the plain learner with these weights."""
    state = shapes(learner)._replace(key=np.zeros(2, np.float32))
    rest = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), state)
    return rest._replace(key=jax.random.key(0), **weights)


def moved(before: Any, after: Any) -> np.ndarray:
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True)
    return np.concatenate([np.ravel(np.asarray(b) - np.asarray(a)) for a, b in pairs])


def test_the_plain_learner_has_the_sizes_of_ours():
    ours = shapes(DroQ(DroQConfig(), Inputs(tuple(range(1164)), 1164), 39))
    plain = shapes(PlainLearner(1164, 39))
    for name in NETWORKS:
        number, number_plain = (
            sum(int(np.prod(x.shape)) for x in jax.tree.leaves(getattr(state, name)))
            for state in (ours, plain)
        )
        assert number == number_plain, name


@pytest.mark.slow
@pytest.mark.parametrize(("stacked", "activation"), [(True, "relu"), (False, "gelu")])
def test_the_plain_learner_does_what_ours_does(monkeypatch, stacked, activation):
    noise = np.random.default_rng(1).standard_normal((BATCH, ACTION)).astype(np.float32)
    # They split their keys differently.
    monkeypatch.setattr(jax.random, "normal", lambda *_: jnp.asarray(noise))
    monkeypatch.setattr(plain_droq, "HIDDEN_LAYERS", 2)  # as that compiles sooner
    monkeypatch.setattr(plain_droq, "WIDTH", 64)
    config = DroQConfig(hidden_sizes=(64, 64), dropout=0.0, activation=activation)
    learner = DroQ(config, Inputs(tuple(range(OBSERVATION)), OBSERVATION), ACTION)
    no_dropout = partial(nn.Dropout, 0.0, deterministic=False)
    plain = PlainLearner(OBSERVATION, ACTION, getattr(nn, activation), no_dropout, stacked)
    ours = drawn(learner)
    start = named_plainly(ours, stacked)
    theirs = as_plain(plain, start)
    batch = transitions(BATCH)
    for _ in range(UPDATES):
        ours, figures = learner.update(ours, Batch(*(part[None] for part in batch)))
        theirs, plain_figures = plain.update(theirs, batch)
        assert figures.keys() == plain_figures.keys()
        for name, value in plain_figures.items():
            assert_allclose(figures[name][0], value, rtol=1e-4, err_msg=name)
    moments, plain_moments = map(jax.tree.leaves, (ours.alpha_opt_state, theirs.alpha_opt_state))
    assert_allclose(moments, plain_moments, rtol=1e-4)
    after = named_plainly(ours, stacked)
    for name in NETWORKS:
        by_ours = moved(start[name], after[name])
        by_theirs = moved(start[name], getattr(theirs, name))
        assert np.abs(by_ours).mean() > 0
        assert np.abs(by_ours - by_theirs).mean() < 0.01 * np.abs(by_ours).mean(), name


def test_the_plain_buffer_keeps_the_newest():
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
