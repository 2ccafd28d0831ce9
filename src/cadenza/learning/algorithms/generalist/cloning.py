"""Behaviour cloning: the generalist's networks learn how the planner's search corrects its plans.

There is a network for the wrist and the forearm, one for the thumb, and one that the other fingers
share: it sees inputs of its own finger, of its neighbours, of the wrist and of the forearm. Each is
an ensemble of perceptrons, which leave out different songs and stop early by them.

RUN/examples/       examples of each episode, made once: 1 MB and 3 s of a core for 10 s of music
RUN/weights.npz     the networks, once all are fitted
"""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from cadenza.agents.agent import Progress, silent
from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.search.networks.inputs import InputLayout
from cadenza.agents.planner.search.networks.weights import CONSTANTS, NETWORKS, Network, Weights
from cadenza.demonstrations.dataset import Dataset, dataset_folder, kept
from cadenza.demonstrations.recorded_episode import RecordedEpisode, played_actions
from cadenza.errors import CadenzaError
from cadenza.files import FLOATS, ArrayOf, Expected, read_arrays, write_atomically
from cadenza.learning.algorithms.generalist.config import GeneralistCloningConfig
from cadenza.learning.algorithms.generalist.hand_networks import (
    OUTPUT_SCALE,
    Array,
    Layers,
    forward,
    initial_layers,
    joined,
    normalisation,
    normalised,
    with_constants,
)
from cadenza.learning.algorithms.on_jax import start_jax
from cadenza.learning.checkpointed_run import CheckpointedRun
from cadenza.resumable import Arrays
from cadenza.scene.scene import Scene, hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State
from cadenza.tasks.goal_track import GoalTrack

_FOLDS = 5  # into which songs are divided
_ENSEMBLE = 3  # perceptrons of a network, each without the songs of one fold
_EXAMPLES: Expected = {
    "inputs": ArrayOf(FLOATS, ("examples", "inputs"), needed=True, finite=True),
    "corrections": ArrayOf(FLOATS, ("examples", "servos"), needed=True, finite=True),
}


class HandExamples(NamedTuple):
    """Steps of recorded episodes, for either hand."""

    inputs: Array  # (N, D) what networks see of a hand
    corrections: Array  # (N, A) of the plan, by the planner


class GeneralistCloning(CheckpointedRun):
    """A run that fits networks; an update fits one perceptron of an ensemble."""

    command: ClassVar[str] = "cadenza generalist clone"

    def __init__(
        self,
        config: GeneralistCloningConfig,
        demonstrations: Sequence[Path],
        folder: Path,
        progress: Progress = silent,
    ) -> None:
        """Resume the run in `folder`, or begin it; `progress` counts the episodes that are read.

        Raises CadenzaError if an option makes no sense, the demonstrations do not go together or
        are too few, or the folder holds a run with other options.
        """
        config.check()
        updates, rng = len(NETWORKS) * _ENSEMBLE, np.random.default_rng(config.seed)
        super().__init__(self.folder_at(folder), updates, config.checkpoint_interval, rng)
        start_jax()
        self.config = config
        demonstrations = [dataset_folder(place) for place in demonstrations]
        episodes = [episode for place in demonstrations for episode in kept(place)]
        scene = Dataset(episodes).scene  # or says which do not go together
        places = [str(place.resolve()) for place in demonstrations]
        names = [episode.folder.name for episode in episodes]
        self._songs = self._examples_by_song(episodes, progress)
        manifest = {"config": asdict(config), "demonstrations": places, "episodes": names}
        self.folder.begin_or_continue(manifest)
        alone = hand_alone(scene, scene.sides[0]).scene
        self._inputs, servos = InputLayout.of(alone), servos_of(alone).finger
        self._sizes, self._parts = (len(self._inputs.finger), len(servos)), hand_parts(alone)
        fold = np.random.default_rng(config.seed).permutation(len(self._songs)) % _FOLDS
        self._fold = fold.tolist()
        self._layers: list[Layers] = []
        self.resume()

    def _examples_by_song(
        self, episodes: Sequence[RecordedEpisode], progress: Progress
    ) -> list[HandExamples]:
        songs: dict[str, list[HandExamples]] = {}
        for i, episode in enumerate(episodes):
            progress("examples", i, len(episodes))
            examples = _cached_examples(episode, self.folder.path / "examples")
            songs.setdefault(Path(episode.facts.song).name, []).append(examples)
        progress("examples", len(episodes), len(episodes))
        if len(songs) < _ENSEMBLE:
            raise CadenzaError(
                f"{len(songs)} songs with episodes that were kept; {_ENSEMBLE} are needed, so that "
                "each perceptron of a network can leave some out"
            )
        return [_concatenated(examples) for examples in songs.values()]

    def _learn(self) -> dict[str, Any]:
        network, left_out = divmod(self.step, _ENSEMBLE)
        inputs, servos = self._parts[network]
        mean_and_std = normalisation(_of_parts(self._songs, inputs, servos).inputs)

        def examples_of(out: bool) -> HandExamples:
            songs = zip(self._songs, self._fold, strict=True)
            own = [song for song, fold in songs if out == (fold == left_out)]
            seen, corrections = _of_parts(own, inputs, servos)
            return HandExamples(normalised(seen, *mean_and_std), corrections)

        train, validation = examples_of(out=False), examples_of(out=True)
        previous = np.append(self._inputs.previous, [False] * len(CONSTANTS))[inputs[0]]
        layers, explained = fit(train, validation, previous, self.config, left_out)
        self._layers.append(layers)
        self.step += 1
        return {"train/explained_variance": explained}

    def _arrays(self) -> Arrays:
        return {
            f"{i}:{kind}{j}": array
            for i, layers in enumerate(self._layers)
            for j, layer in enumerate(layers)
            for kind, array in zip(("kernel", "bias"), layer, strict=True)
        }

    def _restore(self, facts: dict[str, Any], arrays: Arrays) -> None:
        depth = len(self.config.hidden_sizes) + 1
        self._layers = [
            [(arrays[f"{i}:kernel{j}"], arrays[f"{i}:bias{j}"]) for j in range(depth)]
            for i in range(len(arrays) // (2 * depth))
        ]

    def _save_result(self) -> None:
        if not self.finished:
            return
        networks = []
        for i, (inputs, servos) in enumerate(self._parts):
            layers = joined(self._layers[_ENSEMBLE * i : _ENSEMBLE * (i + 1)])
            kernels, biases = zip(*layers, strict=True)
            mean, std = normalisation(_of_parts(self._songs, inputs, servos).inputs)
            networks.append(Network(inputs, servos, mean, std, kernels, biases))
        Weights(self._sizes, tuple(networks)).save(self.folder.path / "weights.npz")


def fit(
    train: HandExamples,
    validation: HandExamples,
    previous: Array,
    config: GeneralistCloningConfig,
    seed: int,
) -> tuple[Layers, float]:
    """Fit a perceptron; returns its layers and the share of the squared corrections it explains.

    AdamW (Loshchilov & Hutter, Decoupled Weight Decay Regularization, 2019) with dropout and early
    stopping. Inputs that are the `previous` correction (I,) are often hidden: networks that learn
    to repeat the planner's would repeat their own when they play (de Haan, Jayaraman & Levine,
    Causal Confusion in Imitation Learning, 2019). Raises CadenzaError with fewer examples than in a
    batch.
    """
    scale, rng = train.corrections.std(), np.random.default_rng(seed)
    x, y, batch = train.inputs, train.corrections / scale, config.batch_size
    if not (updates := len(x) // batch):
        raise CadenzaError(
            f"a network learns from {batch} examples at once, not {len(x)}: collect more, or "
            "choose a smaller --batch-size"
        )
    rate = optax.cosine_decay_schedule(config.learning_rate, config.num_epochs * updates)
    layers = best = initial_layers(
        (x.shape[1], *config.hidden_sizes, y.shape[1]), rng, OUTPUT_SCALE
    )
    init, update = _adamw(config)
    opt_state, key = init(layers), jax.random.key(seed)
    best_explained, best_epoch = -np.inf, 0
    for epoch in range(config.num_epochs):
        rows = rng.permutation(len(x))[: updates * batch].reshape(updates, batch)
        rates = np.asarray(rate(np.arange(updates) + epoch * updates), np.float32)
        for own, now in zip(rows, rates, strict=True):
            args = x[own], y[own], previous, now
            layers, opt_state, key = update(layers, opt_state, key, *args)
        residual = validation.corrections - scale * _predicted(layers, validation.inputs)
        squares = np.square(validation.corrections).sum()
        explained = 1 - float(np.square(residual).sum() / squares)
        if explained > best_explained:
            best, best_explained, best_epoch = layers, explained, epoch
        elif epoch - best_epoch == config.patience:
            break
    *hidden, (kernel, bias) = [(np.asarray(kernel), np.asarray(bias)) for kernel, bias in best]
    return [*hidden, (kernel * scale, bias * scale)], best_explained


@lru_cache
def _adamw(config: GeneralistCloningConfig) -> tuple[Any, Any]:
    """The initial state of AdamW as a function of layers, and an update; compiled once."""
    adam = optax.scale_by_adam(), optax.add_decayed_weights(config.weight_decay)
    optimizer = optax.chain(*adam)  # its learning rate is an argument of each update

    def update(
        layers: Layers, opt_state: Any, key: Any, x: Any, y: Any, previous: Any, rate: Any
    ) -> tuple[Layers, Any, Any]:
        key, hide_key, dropout_key = jax.random.split(key, 3)
        hidden = jax.random.bernoulli(hide_key, config.previous_dropout, (len(x), 1))
        seen = jnp.where(hidden & previous, 0.0, x)[None]

        def loss(layers: Layers) -> Any:
            predicted = forward(layers, seen, config.dropout, dropout_key)
            return jnp.square(predicted[0] - y).mean()

        updates, opt_state = optimizer.update(jax.grad(loss)(layers), opt_state, layers)
        updates = jax.tree.map(lambda update: -rate * update, updates)
        return optax.apply_updates(layers, updates), opt_state, key

    return jax.jit(optimizer.init), jax.jit(update)


def _predicted(layers: Layers, x: Array) -> Array:
    """Outputs (B, O) of a perceptron for x (B, I), without JAX."""
    for kernel, bias in layers[:-1]:
        x = np.maximum(x @ np.asarray(kernel[0]) + np.asarray(bias[0]), 0.0)
    kernel, bias = layers[-1]
    return x @ np.asarray(kernel[0]) + np.asarray(bias[0])


def examples_of(recorded: RecordedEpisode) -> HandExamples:
    """The examples of an episode. Raises CadenzaError if its plan was made by another version."""
    scene, rows = recorded.build_scene(), recorded.steps
    track = GoalTrack(recorded.score, (), recorded.facts.task, scene)
    plan = plan_song(track, np.array(recorded.facts.start))
    if not np.allclose(plan.nominal.tracking.expected, recorded.plan["reference"], atol=1e-3):
        raise CadenzaError(
            f"{recorded.folder}: the planner of another version had another plan; "
            "collect again, or train with that version"
        )
    zeros, inputs, corrections = State.at_rest(scene, 1), [], []
    hands = CorrectedHands(plan)
    played = played_actions(rows, scene)
    for step in range(recorded.facts.num_steps):
        seen, planned = hands.observe(step, _state_of(rows[step : step + 1], zeros, scene))
        inputs.append(seen)
        corrections.append(hands.output_for(rows["action"][step, hands.servos], planned))
        hands.record(played[step, hands.servos], planned)
    return HandExamples(
        *(np.concatenate(each).astype(np.float32) for each in (inputs, corrections))
    )


def _state_of(rows: Array, zeros: State, scene: Scene) -> State:
    """The recorded part of a state."""
    names = ("hand_qpos", "hand_qvel", "fingertip_xpos")
    known: Any = {name: rows[name].astype(np.float64) for name in names}
    return zeros._replace(**known, key_qpos=rows["key_state"] * scene.keyboard.travel)


def _cached_examples(recorded: RecordedEpisode, folder: Path) -> HandExamples:
    """The examples of an episode, which are made once and kept in a folder."""
    files = hashlib.sha256("".join(recorded.facts.files.values()).encode()).hexdigest()
    path = folder / f"{recorded.folder.name}-{files[:12]}.npz"
    if path.exists():
        return HandExamples(**read_arrays(path, _EXAMPLES))
    examples = examples_of(recorded)
    with write_atomically(path) as file:
        np.savez(file, allow_pickle=False, **examples._asdict())
    return examples


def _concatenated(examples: Sequence[HandExamples]) -> HandExamples:
    return HandExamples(*(np.concatenate(parts) for parts in zip(*examples, strict=True)))


def _of_parts(songs: Sequence[HandExamples], inputs: Array, servos: Array) -> HandExamples:
    """Examples of parts of a hand, with their `inputs` (M, I) and `servos` (M, O)."""
    examples = _concatenated(songs)
    seen, parts = with_constants(examples.inputs), zip(inputs, servos, strict=True)
    return _concatenated(
        [HandExamples(seen[:, i], examples.corrections[:, own]) for i, own in parts]
    )


def hand_parts(alone: Scene) -> list[tuple[Array, Array]]:
    """Inputs (M, I) and servos (M, O) of each `Network` of a hand alone in a scene."""
    layout, servos = InputLayout.of(alone), servos_of(alone).finger
    size, fingers = len(layout.finger), np.unique(servos[servos >= 0])
    zero, one = size, size + 1  # `CONSTANTS`

    def seen_by(finger: int) -> Array:
        own = np.flatnonzero((layout.finger == finger) | (layout.finger == -1))
        neighbours = [
            np.flatnonzero((layout.finger == other) & ~layout.private)
            for other in (finger - 1, finger + 1)
        ]
        size_beside = max(map(len, neighbours))
        beside = [each if len(each) else np.full(size_beside, zero) for each in neighbours]
        return np.concatenate([own, *beside, np.where(fingers[1:] == finger, one, zero)])

    def servos_of_each(parts: Array) -> Array:
        return np.stack([np.flatnonzero(servos == part) for part in parts])

    thumb, others = fingers[:1], fingers[1:]
    return [
        (np.arange(size)[None], servos_of_each(np.array([-1]))),
        (np.stack([seen_by(finger) for finger in thumb]), servos_of_each(thumb)),
        (np.stack([seen_by(finger) for finger in others]), servos_of_each(others)),
    ]
