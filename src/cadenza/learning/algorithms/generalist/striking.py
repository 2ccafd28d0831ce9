"""Learning of the touch of the generalist's fingers: how they move in the steps of strikes.

A touch is how far a finger is lowered, and how much less its servos are corrected. Each round plays
excerpts with touches that are drawn around the best so far. A critic learns from all rounds how
each strike turned out, given the inputs of the finger's network and its touch. Then the networks
for touches descend the gradient of the cost that the critic predicts: a deterministic policy
gradient (Silver et al., Deterministic Policy Gradient Algorithms, 2014) of a single decision.

RUN/weights.npz     the networks of the generalist, with those for touches
"""

from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from cadenza.agents.generalist.corrected_hands import MAX_LOWER
from cadenza.agents.planner.search.networks.weights import Network, Weights
from cadenza.agents.planner.search.strikes import UNIT, WEIGHT, log_speed
from cadenza.errors import CadenzaError
from cadenza.learning.algorithms.generalist.config import GeneralistStrikingConfig
from cadenza.learning.algorithms.generalist.excerpt_run import ExcerptRun
from cadenza.learning.algorithms.generalist.excerpts import ExcerptEnvs, ExcerptEpisode
from cadenza.learning.algorithms.generalist.hand_networks import (
    Array,
    Layers,
    forward,
    initial_layers,
    joined,
    normalisation,
    normalised,
    with_constants,
    with_layers,
)
from cadenza.resumable import Arrays
from cadenza.scene.scene import Scene, hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State

_ENSEMBLE = 3  # networks whose touches are averaged, and critics
_CRITIC_HIDDEN = (128, 64)
_CRITIC_OUTPUTS = 2 + 3  # the outcome, and whether the key sounds in three steps
_CRITIC_RATE, _CRITIC_DECAY = 2e-3, 0.03  # AdamW
_HIDDEN_INPUTS = 0.1  # share of a critic's inputs that are hidden in training
_MAX_GRADIENT_NORM = 5.0

# Touches: how far a finger is lowered [cm], and the share by which corrections are reduced.
_TOUCHES = [-MAX_LOWER, 0.0], [MAX_LOWER, 1.0]
_SPREAD = 0.8  # [cm] standard deviation of the exploration
_SPREADS = np.array([0.0, 0.4, 1.0])  # factors of it
_REDUCTION_SPREAD, _REDUCTION_DRAWN = 0.6, 0.5  # largest exploration, and how often

# Outcomes: a time and log2 of a speed, normalised; a missed strike has the latest time.
_MIDDLE, _SCALE = np.array([0.02, 1.0], np.float32), np.array([0.012, 0.8], np.float32)
_EARLIEST, _LATEST = -0.03, 0.08  # [s] from the beginning of the step

# Costs.
_LATE = 3.0  # units of time beyond which a strike does not cost more
_MISSED = 8.0  # cost of a key that does not sound by its step
_LOWER_COST, _REDUCTION_COST = 0.2, 0.4  # of touches, squared
_FIRST_REDUCTION = 0.3  # the initial reduction: at 0 it would have no gradient


class Strikes(NamedTuple):
    """N strikes that have been played."""

    inputs: Array  # (N, D) what the networks saw of the hand before the step
    finger: Array  # (N,) which of the hand's fingers
    touch: Array  # (N, 2) its touch
    # (N, 2) the time in the step [s] and log2 of the speed [rad/s]; NaN without an onset
    outcome: Array
    target: Array  # (N, 2) the same, as planned
    # (N, 3) whether the key sounded after the step before, this one, and the next one; NaN where
    # the plan does not hold it then
    sounding: Array


class _Step(NamedTuple):
    episodes: list[ExcerptEpisode]
    steps: list[int]
    inputs: Array
    touch: Array
    state: State


def play(envs: ExcerptEnvs, weights: Weights, steps: int, rng: np.random.Generator) -> Strikes:
    """Play steps with touches around the networks'; returns their strikes, or CadenzaError."""
    played, strikes = deque[_Step](maxlen=3), []
    for _ in range(steps):
        inputs, episodes = envs.inputs(), list(envs.episodes)
        touch = _drawn(weights, inputs, episodes[0].hands.striking(inputs), rng)
        numbers = [episode.step for episode in episodes]
        state, *_ = envs.step(weights(inputs), touch)
        played.append(_Step(episodes, numbers, inputs, touch, state))
        if len(played) == played.maxlen:
            strikes += _strikes(*played)
    if not strikes:
        raise CadenzaError(
            f"nothing was struck in {steps} steps: choose more --rollout-steps, or other songs"
        )
    return Strikes(*map(np.array, zip(*strikes, strict=True)))


def _drawn(weights: Weights, inputs: Array, striking: Array, rng: np.random.Generator) -> Array:
    """Draw touches (N, F, 2) of hands with inputs (N, D), 0 for fingers that do not strike."""
    touch = np.zeros((*striking.shape, 2))
    if weights.striking:
        touch += weights.touch(inputs)
        touch = np.clip(touch, *_TOUCHES)
    spread = _SPREAD * rng.choice(_SPREADS, size=striking.shape)
    touch[..., 0] += spread * rng.standard_normal(striking.shape)
    drawn = rng.random(striking.shape) < _REDUCTION_DRAWN
    reduction = rng.uniform(-_REDUCTION_SPREAD, _REDUCTION_SPREAD, striking.shape)
    touch[..., 1] += drawn * reduction
    return np.clip(touch, *_TOUCHES) * striking[..., None]


def _strikes(before: _Step, now: _Step, after: _Step) -> list[Any]:
    """The strikes of a step, as the rows of `Strikes`."""
    rows, hands, near = [], len(now.touch) // len(now.episodes), (before, now, after)
    for i, episode in enumerate(now.episodes):
        if any(each.episodes[i] is not episode for each in near):
            continue  # the excerpt has begun or ended
        keyboard, plan = episode.excerpt.costs.keyboard, episode.excerpt.costs
        for key, finger, target in plan.strikes.at(now.steps[i]):
            hand, own = divmod(finger, now.touch.shape[1])
            row = hands * i + hand
            events = [
                (each.state.key_onset[i, key] + shift, log_speed(each.state.key_speed[i, key]))
                for each, shift in zip(near, (-plan.dt, 0.0, plan.dt), strict=True)
            ]
            onsets = np.array(events)
            nearest = np.nan_to_num(np.abs(onsets[:, 0] - target[0]), nan=np.inf).argmin()
            sounding = [each.state.key_qpos[i, key] >= keyboard.sounds_from[key] for each in near]
            held = plan.holds(now.steps[i] + 1, key)
            sounding = np.array(sounding) + np.array([0.0, 0.0, 0.0 if held else np.nan])
            touch = now.touch[row, own]
            rows.append((now.inputs[row], own, touch, onsets[nearest], target, sounding))
    return rows


class _StrikeData(NamedTuple):
    """R strikes of fingers that share a network, to learn from."""

    seen: Array  # (R, I) normalised inputs
    touch: Array
    outcome: Array
    target: Array
    sounding: Array


class TouchFit:
    """Fit a critic of strikes, and by its gradient a network for touches."""

    def __init__(self, config: GeneralistStrikingConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng

    def fit(self, of: Network, fingers: Array, strikes: Strikes) -> tuple[Network, float]:
        """The network for touches, and the mean cost that the critics predict with it.

        It sees the same as the network `of` the same fingers (M,).
        """
        part, mean, std = _part(of, fingers, strikes)
        sizes = (part.seen.shape[1], *self._config.hidden_sizes, 2)
        policy = _ensemble(sizes, self._rng, 0.01)
        policy[-1][1][..., 1] = _FIRST_REDUCTION
        critics = _ensemble((sizes[0] + 2, *_CRITIC_HIDDEN, _CRITIC_OUTPUTS), self._rng, 0.1)
        critics = self._descend(critics, _critic_loss, part, _CRITIC_RATE, _CRITIC_DECAY, hide=True)
        loss = partial(_touch_loss, critics)
        policy = self._descend(policy, loss, part, self._config.learning_rate, 0.0)
        numbers = 2 * fingers[:, None] + np.arange(2)
        network = of._replace(servos=numbers, mean=mean, std=std)
        return with_layers(network, policy), float(loss(policy, part))

    def _descend(
        self,
        layers: Layers,
        loss: Any,
        part: _StrikeData,
        rate: float,
        decay: float,
        hide: bool = False,
    ) -> Layers:
        """Layers after some epochs of AdamW, in which `hide` sets some inputs to 0."""
        config, rng = self._config, self._rng
        batches = max(len(part.seen) // config.batch_size, 1)
        schedule = optax.cosine_decay_schedule(rate, config.num_epochs * batches)
        optimizer = optax.chain(
            optax.clip_by_global_norm(_MAX_GRADIENT_NORM), optax.adamw(schedule, weight_decay=decay)
        )

        @jax.jit
        def step(layers: Layers, opt_state: Any, batch: _StrikeData) -> tuple[Layers, Any]:
            gradient = jax.grad(loss)(layers, batch)
            updates, opt_state = optimizer.update(gradient, opt_state, layers)
            return optax.apply_updates(layers, updates), opt_state

        opt_state = optimizer.init(layers)
        for _ in range(config.num_epochs):
            for rows in np.array_split(rng.permutation(len(part.seen)), batches):
                batch = _StrikeData._make(values[rows] for values in part)
                if hide:
                    shown = rng.random(batch.seen.shape, np.float32) >= _HIDDEN_INPUTS
                    batch = batch._replace(seen=batch.seen * shown)
                layers, opt_state = step(layers, opt_state, batch)
        return layers


def _part(of: Network, fingers: Array, strikes: Strikes) -> tuple[_StrikeData, Array, Array]:
    """The strikes of some fingers, and mean and standard deviation (I,) of their inputs."""
    is_own = np.isin(strikes.finger, fingers)
    own = Strikes._make(values[is_own] for values in strikes)
    rows = of.inputs[np.searchsorted(fingers, own.finger)]
    seen = np.take_along_axis(with_constants(own.inputs), rows, axis=1)
    mean, std = normalisation(seen)
    seen = normalised(seen, mean, std)
    time = np.nan_to_num(own.outcome[:, 0], nan=_LATEST)
    outcome = np.stack([np.clip(time, _EARLIEST, _LATEST), own.outcome[:, 1]], axis=1)
    arrays = seen, own.touch, outcome, own.target, own.sounding
    part = _StrikeData._make(values.astype(np.float32) for values in arrays)
    return part, mean.astype(np.float32), std.astype(np.float32)


def _ensemble(sizes: Sequence[int], rng: np.random.Generator, scale: float) -> Layers:
    return joined([initial_layers(sizes, rng, scale) for _ in range(_ENSEMBLE)])


def _predicted(critics: Layers, seen: Any, touch: Any) -> Any:
    """(C, R, 5) outcomes, normalised, and logits of whether keys sound, by C critics."""
    return forward(critics, jnp.concatenate([seen, touch], axis=1)[None])


def _critic_loss(critics: Layers, part: _StrikeData) -> Any:
    predicted = _predicted(critics, part.seen, part.touch)
    error = predicted[..., :2] - (part.outcome - _MIDDLE) / _SCALE
    known, logit, sounds = jnp.isfinite(error), predicted[..., 2:], part.sounding
    size = jnp.abs(jnp.where(known, error, 0.0))
    huber = jnp.where(size < 1, size * size / 2, size - 0.5)
    entropy = jax.nn.softplus(logit) - jnp.nan_to_num(sounds) * logit
    return huber.mean() + jnp.where(jnp.isnan(sounds), 0.0, entropy).mean()


def _touch_loss(critics: Layers, policy: Layers, part: _StrikeData) -> Any:
    raw = forward(policy, part.seen[None]).mean(axis=0)
    touch = jnp.clip(raw, *map(jnp.array, _TOUCHES))
    predicted = _predicted(critics, part.seen, touch)
    outcome = predicted[..., :2] * _SCALE + _MIDDLE
    error = jnp.abs(outcome - part.target) / UNIT
    error = error.at[..., 0].min(_LATE)
    strikes = (jnp.sqrt(1 + error * error) - 1) @ WEIGHT
    sounds = jax.nn.sigmoid(predicted[..., 2:])
    held = jnp.isfinite(part.sounding[:, 2])
    missed = sounds[..., 0] + (1 - sounds[..., 1]) + held * (1 - sounds[..., 2])
    beyond = jnp.square(raw - touch)[:, 1]
    reduction = _REDUCTION_COST * jnp.square(touch[:, 1])
    effort = _LOWER_COST * jnp.square(raw[:, 0]) + reduction + beyond
    return (strikes + _MISSED * missed).mean() + effort.mean()


class GeneralistStriking(ExcerptRun):
    """A run that learns touches; an update is a round of playing and fitting."""

    command: ClassVar[str] = "cadenza generalist strike"
    config: GeneralistStrikingConfig

    def _prepare(self, initial: Weights, scene: Scene) -> None:
        self._weights = initial._replace(striking=())  # touches are learnt anew
        fingers = servos_of(hand_alone(scene, scene.sides[0]).scene).finger
        self._fingers = [fingers[network.servos[:, 0]] for network in initial.networks[1:]]
        self._played: list[Strikes] = []

    def _learn(self) -> dict[str, Any]:
        played = play(self._envs, self._weights, self.config.rollout_steps, self._rng)
        self._played.append(played)
        strikes = Strikes(*map(np.concatenate, zip(*self._played, strict=True)))
        fit = TouchFit(self.config, self._rng)
        parts = zip(self._weights.networks[1:], self._fingers, strict=True)
        networks, costs = zip(*(fit.fit(*part, strikes) for part in parts), strict=True)
        self._weights = self._weights._replace(striking=networks)
        self.step += 1
        return {"train/cost": float(np.mean(costs))}

    def _arrays(self) -> Arrays:
        arrays = {
            f"{i}:{name}": values
            for i, strikes in enumerate(self._played)
            for name, values in strikes._asdict().items()
        }
        return arrays | self._weights.arrays

    def _restore(self, facts: dict[str, Any], arrays: Arrays) -> None:
        self._played = [
            Strikes(*(arrays[f"{i}:{name}"] for name in Strikes._fields))
            for i in range(sum(name.endswith(":finger") for name in arrays))
        ]
        self._weights = Weights.of(arrays)

    def _save_result(self) -> None:
        self._weights.save(self.folder.path / "weights.npz")
