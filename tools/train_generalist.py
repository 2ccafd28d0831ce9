"""Fits the networks of the agent `generalist` to demonstrations of the planner.

    cadenza dataset collect --songs LIBRARY:train --excerpt 12 --least-f1 0.6 -o demonstrations
    python tools/train_generalist.py demonstrations -o trained

The answers are by how much the planner's search corrected the plan of a song in the states that
were recorded. There is a network for the wrist and the forearm, one for the thumb, and one that the
other fingers share: it is told of its own finger, of those beside it, and of the wrist and the
forearm. Each is three networks that learn from other songs; what is left out says when to stop.
docs/generalist.md has the rounds in which it plays itself; `reinforce_generalist.py` goes on.

In the folder `trained`, `weights.npz` is what has been learnt, and `lessons` what was made of the
episodes, each once: 1 MB for 10 s. Making one takes 3 s of a core.
"""

from __future__ import annotations

import argparse
import hashlib
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.search.networks.inputs import InputLayout
from cadenza.agents.planner.search.networks.weights import (
    CONSTANTS,
    INPUT_LIMIT,
    NETWORKS,
    Network,
    Weights,
)
from cadenza.demonstrations.dataset import Dataset, kept
from cadenza.demonstrations.recorded_episode import RecordedEpisode, played_actions
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.files import write_atomically
from cadenza.scene.scene import Scene, hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State
from cadenza.tasks.goal_track import GoalTrack

Array = NDArray[Any]
Layers = list[tuple[Any, Any]]
"""Kernels (I, O) and biases (O,)."""

FOLDS = 5  # into which songs are divided
NETWORKS_EACH = 3  # each learns from the songs of all folds but one
HIDDEN = (128, 64)
RATE, DECAY, DROPOUT = 1e-3, 0.01, 0.15
FORGOTTEN = 0.7  # how often a network is not told the correction of the step before, as it learns
BATCH, EPOCHS, PATIENCE = 512, 15, 4
LEAST_SPREAD = 1e-3  # of an input that is not scaled up


class Lesson(NamedTuple):
    """What was recorded, for either hand."""

    inputs: Array
    """(N, D)"""
    answers: Array
    """(N, A) how the planner corrected the plan."""


def lesson_of(recorded: RecordedEpisode) -> Lesson:
    """That of an episode.

    Raises:
        CadenzaError: its plan was made by another version.
    """
    scene, rows = recorded.build_scene(), recorded.steps
    track = GoalTrack(recorded.score, (), recorded.facts.task, scene)
    plan = plan_song(track, np.array(recorded.facts.start))
    if not np.allclose(plan.nominal.tracking.expected, recorded.plan["reference"], atol=1e-3):
        raise CadenzaError(
            f"{recorded.folder}: the planner of another version had another plan; "
            "collect again, or train with that version"
        )
    nothing, inputs, answers = State.zeros(scene, 1), [], []
    hands = CorrectedHands(plan)
    played = played_actions(rows, scene)
    for step in range(recorded.facts.num_steps):
        seen, planned = hands.observe(step, state_of(rows[step : step + 1], nothing, scene))
        inputs.append(seen)
        answers.append(hands.recommended(rows["action"][step, hands.servos], planned))
        hands.played(played[step, hands.servos], planned)
    return Lesson(*(np.concatenate(each).astype(np.float32) for each in (inputs, answers)))


def state_of(rows: Array, nothing: State, scene: Scene) -> State:
    """What was recorded of a state."""
    names = ("hand_qpos", "hand_qvel", "fingertip_xpos")
    known = {name: rows[name].astype(np.float64) for name in names}
    return nothing._replace(**known, key_qpos=rows["key_state"] * scene.keyboard.travel)


def kept_lesson(recorded: RecordedEpisode, folder: Path) -> Lesson:
    """That of an episode, made once; for another version of its inputs, take another folder."""
    files = hashlib.sha256("".join(recorded.facts.files.values()).encode()).hexdigest()
    path = folder / f"{recorded.folder.name}-{files[:12]}.npz"
    if not path.exists():
        lesson = lesson_of(recorded)
        folder.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as file:
            np.savez(file, **lesson._asdict())
    with np.load(path) as arrays:
        return Lesson(arrays["inputs"], arrays["answers"])


def joined(lessons: list[Lesson]) -> Lesson:
    return Lesson(*(np.concatenate(parts) for parts in zip(*lessons, strict=True)))


def parts_of(about: InputLayout, servos: Array) -> list[tuple[Array, Array]]:
    """What each network is told, and for which servos it answers, see `Network`."""
    size, fingers = len(about.finger), np.unique(servos[servos >= 0])
    zero, one = size, size + 1

    def told(finger: int) -> Array:
        own = np.flatnonzero((about.finger == finger) | (about.finger == -1))
        neighbours = [
            np.flatnonzero((about.finger == other) & ~about.private)
            for other in (finger - 1, finger + 1)
        ]
        most = max(map(len, neighbours))
        beside = [some if len(some) else np.full(most, zero) for some in neighbours]
        return np.concatenate([own, *beside, np.where(fingers[1:] == finger, one, zero)])

    def answered(some: Array) -> Array:
        return np.stack([np.flatnonzero(servos == finger) for finger in some])

    thumb, others = fingers[:1], fingers[1:]
    return [
        (np.arange(size)[None], answered(np.array([-1]))),
        (np.stack([told(finger) for finger in thumb]), answered(thumb)),
        (np.stack([told(finger) for finger in others]), answered(others)),
    ]


def initial(sizes: tuple[int, ...], rng: np.random.Generator) -> Layers:
    """Of rectified units (He et al., Delving Deep into Rectifiers, 2015), the last one small."""
    scales = [np.sqrt(2 / size) for size in sizes[:-2]] + [0.1 * np.sqrt(2 / sizes[-2])]
    return [
        ((scale * rng.standard_normal(shape)).astype(np.float32), np.zeros(shape[1], np.float32))
        for scale, shape in zip(scales, pairwise(sizes), strict=True)
    ]


def answers(layers: Layers, x: Any, key: Any = None) -> Any:
    """(N, O) to x (N, I), without some of the units where there is a `key`."""
    for i, (kernel, bias) in enumerate(layers):
        if i:
            x = jax.nn.relu(x)
        if i and key is not None:
            key, now = jax.random.split(key)
            x *= jax.random.bernoulli(now, 1 - DROPOUT, x.shape) / (1 - DROPOUT)
        x = x @ kernel + bias
    return x


def learnt(
    from_these: Lesson, left_out: Lesson, previous: Array, seed: int
) -> tuple[Layers, float]:
    """Layers of a network, and the share of the squared answers that it explains in `left_out`.

    AdamW (Loshchilov & Hutter, Decoupled Weight Decay Regularization, 2019) with dropout, up to
    where more of it does `left_out` no good. Often it has to do without the `previous` correction,
    (I,) where that is told: what the planner did tells what it does next, but not why, and when the
    network plays, it is its own (de Haan, Jayaraman & Levine, Causal Confusion in Imitation
    Learning, 2019).
    """
    scale, rng = from_these.answers.std(), np.random.default_rng(seed)
    x, y = jnp.asarray(from_these.inputs), jnp.asarray(from_these.answers / scale)
    updates = len(x) // BATCH
    if not updates:
        raise CadenzaError(
            f"a network learns from {BATCH} examples at once, not {len(x)}: collect more"
        )
    rate = optax.cosine_decay_schedule(RATE, EPOCHS * updates)
    optimiser = optax.adamw(rate, weight_decay=DECAY)

    def error(layers: Layers, which: Any, key: Any) -> Any:
        key, now = jax.random.split(key)
        forgotten = jax.random.bernoulli(now, FORGOTTEN, (len(which), 1)) & previous
        told = jnp.where(forgotten, 0.0, x[which])
        return jnp.square(answers(layers, told, key) - y[which]).mean()

    def update(state: Any, now: Any) -> Any:
        layers, moments = state
        change, moments = optimiser.update(jax.grad(error)(layers, *now), moments, layers)
        return (optax.apply_updates(layers, change), moments), None

    epoch = jax.jit(lambda state, batches: jax.lax.scan(update, state, batches)[0])
    layers = best = initial((x.shape[1], *HIDDEN, y.shape[1]), rng)
    state, explains, since = (layers, optimiser.init(layers)), -np.inf, 0
    for number in range(EPOCHS):
        which = rng.permutation(len(x))[: updates * BATCH].reshape(updates, BATCH)
        keys = jax.random.split(jax.random.key(seed * EPOCHS + number), updates)
        state = epoch(state, (which, keys))
        off = left_out.answers - scale * np.asarray(answers(state[0], left_out.inputs))
        share = 1 - float(np.square(off).sum() / np.square(left_out.answers).sum())
        if share > explains:
            best, explains, since = state[0], share, number
        elif number - since == PATIENCE:
            break
    *before, (kernel, bias) = [(np.asarray(kernel), np.asarray(bias)) for kernel, bias in best]
    return [*before, (kernel * scale, bias * scale)], explains


def of_parts(lessons: list[Lesson], inputs: Array, servos: Array) -> Lesson:
    """What parts of a hand are told, `inputs` (M, I), and answer for their `servos` (M, O)."""
    lesson = joined(lessons)
    constants = np.broadcast_to(CONSTANTS, (len(lesson.inputs), len(CONSTANTS)))
    told = np.concatenate([lesson.inputs, constants], axis=1)
    parts = zip(inputs, servos, strict=True)
    return joined([Lesson(told[:, mine], lesson.answers[:, own]) for mine, own in parts])


def network_of(
    songs: list[Lesson], about: InputLayout, inputs: Array, servos: Array
) -> tuple[Network, list[float]]:
    """One that is told `inputs` (M, I) and answers for `servos` (M, O).

    And which share of the answers it explains in songs left out.
    """
    previous = np.append(about.previous, [False] * len(CONSTANTS))[inputs[0]]  # same for all parts
    told = of_parts(songs, inputs, servos).inputs
    middle, spread = told.mean(axis=0), told.std(axis=0)
    spread = np.where(spread < LEAST_SPREAD, 1.0, spread)

    def scaled(some: list[Lesson]) -> Lesson:
        told, wanted = of_parts(some, inputs, servos)
        return Lesson(np.clip((told - middle) / spread, -INPUT_LIMIT, INPUT_LIMIT), wanted)

    fold = np.random.default_rng(0).permutation(len(songs)) % FOLDS
    trained = []
    for out in range(NETWORKS_EACH):
        these = [song for song, of in zip(songs, fold, strict=True) if of != out]
        others = [song for song, of in zip(songs, fold, strict=True) if of == out]
        trained.append(learnt(scaled(these), scaled(others), previous, out))
    layers = list(zip(*(some for some, _ in trained), strict=True))
    kernels = tuple(np.stack([kernel for kernel, _ in layer]) for layer in layers)
    biases = tuple(np.stack([bias for _, bias in layer])[:, None] for layer in layers)
    network = Network(inputs, servos, middle, spread, kernels, biases)
    return network, [explains for _, explains in trained]


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("datasets", nargs="+", type=Path, help="folders of demonstrations")
    parser.add_argument("-o", "--output", type=Path, required=True, help="a folder")
    given = parser.parse_args()
    episodes = [episode for folder in given.datasets for episode in kept(folder)]
    scene = Dataset(episodes).scene  # or says which do not go together
    of_songs: dict[str, list[Lesson]] = {}
    for i, episode in enumerate(episodes, start=1):
        lesson = kept_lesson(episode, given.output / "lessons")
        of_songs.setdefault(Path(episode.facts.song).name, []).append(lesson)
        print(f"\r{i} of {len(episodes)} episodes read", end="", flush=True)
    print()
    if len(of_songs) < NETWORKS_EACH:
        raise CadenzaError(
            f"{len(of_songs)} songs with episodes that were kept; {NETWORKS_EACH} are needed, "
            "so that each network can leave some out"
        )
    lessons = [joined(of_song) for of_song in of_songs.values()]
    print(f"{sum(len(x.inputs) for x in lessons)} states of a hand, of {len(lessons)} songs")
    alone = hand_alone(scene, scene.sides[0]).scene
    about, servos = InputLayout.of(alone), servos_of(alone).finger
    networks = []
    for name, part in zip(NETWORKS, parts_of(about, servos), strict=True):
        network, explains = network_of(lessons, about, *part)
        shares = ", ".join(f"{share:.3f}" for share in explains)
        print(f"{name}: explains {shares} on songs left out", flush=True)
        networks.append(network)
    weights = Weights((len(about.finger), len(servos)), tuple(networks))
    weights.save(given.output / "weights.npz")


if __name__ == "__main__":
    main()
