"""Improves the networks of the agent `generalist` by reinforcement learning over many songs.

    python tools/reinforce_generalist.py LIBRARY:train -o reinforced

The generalist plays excerpts of songs, several at once, and adds noise to what its networks answer.
Each finger has its own reward: what its keys lack, wrong keys that it is nearest to, and how far
astray it is. So a network that answers for a finger learns from what that finger does (proximal
policy optimisation with an advantage for each part of a hand; Schulman et al., Proximal Policy
Optimization Algorithms, 2017), and the one for the wrist and the forearm from all fingers of the
hand.

In the folder `reinforced`, `weights.npz` is the running mean of the networks of all rounds. If it
is stopped, the same command goes on from `checkpoint.npz`, with other noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from copy import copy
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray
from tqdm import tqdm

from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.generalist.generalist import HASTE, shipped_for
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.agents.planner.search.fingertip_correction import MAX_ERROR
from cadenza.agents.planner.search.horizon_cost import HARMLESS_DEPTH
from cadenza.agents.planner.search.networks.weights import CONSTANTS, INPUT_LIMIT, Network, Weights
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.evaluation.collecting.variation import excerpt
from cadenza.files import plain, read_json, write_atomically, write_json
from cadenza.fingers import SIDES
from cadenza.music.libraries.library import load_score, open_library
from cadenza.scene.scene import Scene, build_scene, hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

Array = NDArray[Any]
Layers = list[tuple[Any, Any]]
"""Kernels (N, I, O) and biases (N, 1, O) of N networks whose answers are averaged."""

SECONDS = 12.0  # of each song
AT_ONCE, STEPS = 32, 64  # songs, and control steps of each in a round
NOISE = 0.2  # of answers, of which 1 is what a servo's `correction` is
DISCOUNT, TRACE = 0.9, 0.9  # for each step
RATE, VALUE_RATE, BATCH, SWEEPS, CLIP = 1e-4, 5e-4, 512, 2, 0.2  # the first falls to 0
FIRST = 8  # rounds in which only values are learnt
OF_MEAN = 0.04  # of the running mean, what a round's networks are
HIDDEN = (128, 64)  # units of what says values
KEPT_EVERY = 20  # rounds
_LASTING = "songs", "weights", "most", "seed"  # options that stay when learning goes on

# What a step costs, as in the planner's search, but that a key counts the less the more are wanted.
WRONG, EARLY, ASTRAY = 3.0, 1.5, 0.3
COUNTS = np.array([0.55, 1.0, 1.0])  # distances along the key count less
MOST = 15.0  # that a finger loses in a step


class Demands:
    """What a song asks of the F fingers in each of its T steps."""

    def __init__(self, plan: SongPlan) -> None:
        scene, goals, nominal = plan.scene, plan.goals, plan.nominal
        parts = [HandGoals(plan, side) for side in scene.sides]
        self.num_steps, self.keyboard = goals.num_steps, scene.keyboard
        self._held = np.any([part.planned for part in parts], axis=0)
        self._due = self._held & np.any([part.due for part in parts], axis=0)
        self._early = np.any([part.unwelcome for part in parts], axis=0)
        self._fingers, self._wrong = goals.fingers, ~goals.keys
        self._share = 2.0 / (1 + goals.keys.sum(axis=1))
        self._tips = nominal.fingertips
        self._weight = ASTRAY * np.concatenate([part.weight for part in parts], axis=1)
        self._top = scene.keyboard.centre[:, 2] + scene.keyboard.half_size[:, 2]

    def lost(self, step: int, key_qpos: Array, tips: Array, before: Array) -> tuple[Array, Array]:
        """(F,) what each finger has lost after a step, and (K,) the keys that sound.

        Args:
            step: of the song.
            key_qpos: (K,) after it [rad].
            tips: (F, 3) fingertips [m].
            before: (K,) keys that sounded before it.
        """
        keyboard, held, share = self.keyboard, self._held[step], self._share[step]
        sounding, depth = key_qpos >= keyboard.sounds_from, key_qpos / keyboard.travel
        lacks = ~sounding + np.clip(1 - depth, 0, 1) ** 2
        missed = WRONG * share * held * lacks + WRONG * (self._due[step] & ~sounding)
        too_far = sounding + np.maximum(depth - HARMLESS_DEPTH, 0) ** 2
        wrong = WRONG * share * self._wrong[step] * too_far
        wrong += EARLY * (self._early[step] & sounding & ~before)
        off = (tips - self._tips[step + 1]) * COUNTS
        lost = self._weight[step + 1] * np.minimum((off * off).sum(axis=1), MAX_ERROR**2)
        keys = np.flatnonzero(missed)
        np.add.at(lost, self._fingers[step, keys], missed[keys])
        keys = np.flatnonzero(wrong)
        along = tips[:, 1] - keyboard.centre[keys, 1, None]
        above = np.maximum(tips[:, 2] - self._top[keys, None], 0)
        np.add.at(lost, (along**2 + above**2).argmin(axis=1), wrong[keys])
        return np.minimum(lost, MOST), sounding


class Song(NamedTuple):
    """A song, and how hands are to play it."""

    demands: Demands
    hands: CorrectedHands
    start: Array
    """(J,) where their joints begin [m, rad]."""

    @classmethod
    def of(cls, plan: SongPlan, start: Array) -> Song:
        """`start` (J,) is where the plan begins."""
        return cls(Demands(plan), CorrectedHands(plan), start)


def planned(library: str, most: int, rng: np.random.Generator) -> list[Song]:
    """Excerpts of songs of a library, `most` at most, drawn, from somewhere in each."""
    songs, some = open_library(library).songs, []
    for i in tqdm(rng.permutation(len(songs))[:most], desc="plans", leave=False):
        score, _ = excerpt(load_score(songs[i].name).without_fingers(), SECONDS, rng.random())
        task = PianoTask([score], TaskConfig())
        start = task.state.hand_qpos[0].copy()
        some.append(Song.of(plan_song(task.tracks[0], start, haste=HASTE), start))
        task.close()
    if not some:
        raise CadenzaError(f"{library}, at most {most}: no songs to play")
    return some


class Player:
    """Plays songs, one after the other, in one of many simulations."""

    def begin(self, song: Song) -> None:
        self.song, self._step, self._lost = song, 0, 0.0
        self._hands = copy(song.hands)
        self._sounding = np.zeros(len(song.demands.keyboard.travel), bool)
        self._hands.answer = np.zeros_like(self._hands.answer)

    @property
    def over(self) -> bool:
        return self._step == self.song.demands.num_steps

    @property
    def lost_a_step(self) -> float:
        """What all fingers together have lost in a step, so far."""
        return self._lost / self._step

    def see(self, state: State) -> Array:
        """(H, D) what is told of each hand, in a state of one simulation."""
        told, self._planned = self._hands.observe(self._step, state)
        return told

    def ctrl(self, answers: Array) -> Array:
        """(H A,) the controls of a step, by the answers (H, A) to it."""
        return self._hands.corrected(self._planned, answers)

    def lost(self, state: State) -> Array:
        """(H, F) what each finger of each hand has lost in the step that led to a state."""
        after = self._step, state.key_qpos[0], state.fingertip_xpos[0], self._sounding
        lost, self._sounding = self.song.demands.lost(*after)
        self._step += 1
        self._lost += float(lost.sum())
        return lost.reshape(len(self._hands.answer), -1)


class Round(NamedTuple):
    """What N hands have played in T steps."""

    told: Array
    """(T + 1, N, D)"""
    answers: Array
    """(T, N, A) with noise."""
    rewards: Array
    """(T, N, F) of each finger."""
    ends: Array
    """(T, N) whether the song ended with the step."""


class Stage:
    """Where songs are played, all at the same time: the more often, the more they lose."""

    def __init__(self, songs: Sequence[Song], scene: Scene, rng: np.random.Generator) -> None:
        self._songs, self._rng = songs, rng
        self._coming = rng.permutation(len(songs)).tolist()  # those that were never begun
        self._lost = np.ones(len(songs))  # in a step, when they were last played, if they were
        self._simulation = MujocoSimulation(scene, AT_ONCE)
        self._players = [Player() for _ in range(AT_ONCE)]
        self._playing = [0] * AT_ONCE  # which songs
        for i in range(AT_ONCE):
            self._begin(i)

    def play(self, networks: Networks, layers: list[Layers], steps: int) -> Round:
        """The next steps, by answers of networks with noise."""
        told, answers, rewards, ends = [self._see()], [], [], []
        for _ in range(steps):
            answer = np.asarray(networks.answers(layers, told[-1]))
            answer = answer + NOISE * self._rng.standard_normal(answer.shape).astype(np.float32)
            each = np.split(answer, AT_ONCE)
            ctrl = [player.ctrl(own) for player, own in zip(self._players, each, strict=True)]
            self._simulation.step(np.stack(ctrl))
            lost = [player.lost(self._state(i)) for i, player in enumerate(self._players)]
            over = np.array([player.over for player in self._players])
            over |= self._simulation.state.unstable
            for i in np.flatnonzero(over):
                self._lost[self._playing[i]] = self._players[i].lost_a_step
                self._begin(i)
            answers.append(answer)
            rewards.append(-np.concatenate(lost))
            ends.append(np.repeat(over, len(answer) // AT_ONCE))
            told.append(self._see())
        return Round(*map(np.array, (told, answers, rewards, ends)))

    def _begin(self, i: int) -> None:
        song = self._coming.pop() if self._coming else self._draw()
        self._playing[i] = song
        self._players[i].begin(self._songs[song])
        self._simulation.reset([i], self._players[i].song.start[None])

    def _draw(self) -> int:
        """A song, the likelier the more it loses."""
        return int(self._rng.choice(len(self._songs), p=self._lost / self._lost.sum()))

    def _see(self) -> Array:
        seen = [player.see(self._state(i)) for i, player in enumerate(self._players)]
        return np.concatenate(seen)

    def _state(self, i: int) -> State:
        return State._make(values[i : i + 1] for values in self._simulation.state)


class Networks:
    """Those of `Weights`, and what says values for them, as functions of their layers.

    Attributes:
        parts: (A, 1 + F) to which part of a hand each servo belongs: the whole hand or a finger.
    """

    def __init__(self, weights: Weights, scene: Scene) -> None:
        fingers = servos_of(hand_alone(scene, scene.sides[0]).scene).finger
        self._weights, self._networks = weights, weights.networks
        self._fingers = [fingers[network.servos[:, 0]] for network in self._networks]
        self.parts = np.eye(int(fingers.max()) + 2, dtype=np.float32)[fingers + 1]
        self.answers = jax.jit(self._answers)

    @property
    def layers(self) -> list[Layers]:
        """What was learnt before."""
        return [list(zip(each.kernels, each.biases, strict=True)) for each in self._networks]

    def initial_values(self, rng: np.random.Generator) -> list[Layers]:
        """Layers of what says values of fingers, told what networks are told that answer for it."""
        return [_initial((len(each.middle), *HIDDEN, 1), rng) for each in self._networks[1:]]

    def with_layers(self, layers: list[Layers]) -> Weights:
        """Weights as they are now."""
        networks = []
        for network, new in zip(self._networks, layers, strict=True):
            kernels, biases = (tuple(map(np.asarray, some)) for some in zip(*new, strict=True))
            networks.append(network._replace(kernels=kernels, biases=biases))
        return self._weights._replace(networks=tuple(networks))

    def values(self, layers: list[Layers], told: Any) -> Any:
        """(N, F) to what is told (N, D)."""
        values = jnp.zeros((len(told), self.parts.shape[1] - 1))
        each = zip(layers, self._networks[1:], self._fingers[1:], strict=True)
        for own, network, fingers in each:
            values = values.at[:, fingers].set(_said(own, network, told)[..., 0])
        return values

    def _answers(self, layers: list[Layers], told: Any) -> Any:
        """(N, A) to what is told (N, D)."""
        answers = jnp.zeros((len(told), len(self.parts)))
        for own, network in zip(layers, self._networks, strict=True):
            answers = answers.at[:, network.servos].set(_said(own, network, told))
        return answers


def _said(layers: Layers, network: Network, told: Any) -> Any:
    """(N, M, O) by layers that are told what a network is, as `Network` says it."""
    told = jnp.concatenate([told, jnp.tile(CONSTANTS, (len(told), 1))], axis=1)
    shown = (told[:, network.inputs] - network.middle) / network.spread
    x = jnp.clip(shown, -INPUT_LIMIT, INPUT_LIMIT).reshape(1, -1, len(network.middle))
    for kernel, bias in layers[:-1]:
        x = jax.nn.relu(x @ kernel + bias)
    kernel, bias = layers[-1]
    return (x @ kernel + bias).mean(axis=0).reshape(len(told), len(network.inputs), -1)


def _initial(sizes: tuple[int, ...], rng: np.random.Generator) -> Layers:
    """Of rectified units (He et al., Delving Deep into Rectifiers, 2015)."""
    return [
        (
            (np.sqrt(2 / i) * rng.standard_normal((1, i, o))).astype(np.float32),
            np.zeros((1, 1, o), np.float32),
        )
        for i, o in pairwise(sizes)
    ]


class Learner:
    """Improves networks by what was played with them.

    Attributes:
        layers: of the networks.
        mean: their running mean.
        rounds: from how many it has learnt.
    """

    def __init__(self, networks: Networks, rounds: int, rng: np.random.Generator) -> None:
        """`rounds` is from how many it is to learn."""
        self._networks, self._rng, self.rounds = networks, rng, 0
        self.layers = self.mean = networks.layers
        self._values = networks.initial_values(rng)
        updates = max(rounds - FIRST, 1) * SWEEPS * STEPS * AT_ONCE * len(SIDES) // BATCH
        rate = optax.linear_schedule(RATE, 0.0, updates)
        improving = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rate))
        valuing = optax.adam(VALUE_RATE)
        self._moments, self._value_moments = improving.init(self.layers), valuing.init(self._values)

        def step(optimiser: Any, loss: Any) -> Any:
            def update(layers: Any, moments: Any, *batch: Array) -> Any:
                change, moments = optimiser.update(jax.grad(loss)(layers, *batch), moments, layers)
                return optax.apply_updates(layers, change), moments

            return jax.jit(update)

        self._improve, self._value = step(improving, self._loss), step(valuing, self._error)
        self._valued = jax.jit(networks.values)

    def learn(self, played: Round) -> None:
        """From a round."""
        told = played.told.reshape(-1, played.told.shape[-1])
        values = np.asarray(self._valued(self._values, told)).reshape(-1, *played.rewards[0].shape)
        better = advantages(played, values)
        returns = (better + values[:-1]).reshape(-1, values.shape[-1])
        better = (better - better.mean(axis=(0, 1))).reshape(returns.shape)
        better = np.concatenate([better.sum(axis=1, keepdims=True), better], axis=1)
        better /= better.std(axis=0)
        told, answers = told[: len(returns)], played.answers.reshape(len(returns), -1)
        likely = np.asarray(self._likely(self.layers, told, answers))
        for _ in range(SWEEPS):
            for some in np.split(self._rng.permutation(len(told)), len(told) // BATCH):
                if self.rounds >= FIRST:
                    batch = told[some], answers[some], likely[some], better[some]
                    self.layers, self._moments = self._improve(self.layers, self._moments, *batch)
                batch = told[some], returns[some]
                self._values, self._value_moments = self._value(
                    self._values, self._value_moments, *batch
                )
        self.rounds += 1
        self.mean = jax.tree.map(
            lambda mean, now: mean + OF_MEAN * (now - mean), self.mean, self.layers
        )

    def save(self, path: Path) -> None:
        """All that it has come to."""
        leaves = map(np.asarray, jax.tree.leaves(self._state))
        with write_atomically(path) as file:
            np.savez(file, *leaves, allow_pickle=False, rounds=self.rounds)

    def load(self, path: Path) -> None:
        """Goes on from what was saved."""
        structure = jax.tree.structure(self._state)
        with np.load(path) as saved:
            leaves = [saved[f"arr_{i}"] for i in range(structure.num_leaves)]
            self.rounds = int(saved["rounds"])
        state = jax.tree.unflatten(structure, leaves)
        self.layers, self.mean, self._values, self._moments, self._value_moments = state

    @property
    def _state(self) -> tuple[Any, ...]:
        return self.layers, self.mean, self._values, self._moments, self._value_moments

    def _likely(self, layers: list[Layers], told: Any, answers: Any) -> Any:
        """(N, 1 + F) logarithms of how likely answers of each part are, up to a constant."""
        off = (answers - self._networks.answers(layers, told)) / NOISE
        return -0.5 * jnp.square(off) @ self._networks.parts

    def _loss(self, layers: list[Layers], told: Any, answers: Any, likely: Any, better: Any) -> Any:
        ratio = jnp.exp(self._likely(layers, told, answers) - likely)
        clipped = jnp.clip(ratio, 1 - CLIP, 1 + CLIP)
        return -jnp.minimum(ratio * better, clipped * better).sum(axis=1).mean()

    def _error(self, layers: list[Layers], told: Any, returns: Any) -> Any:
        return jnp.square(self._networks.values(layers, told) - returns).mean()


def advantages(played: Round, values: Array) -> Array:
    """(T, N, F) by how much what was played is better than `values` (T + 1, N, F) say.

    Schulman et al., High-Dimensional Continuous Control Using Generalized Advantage Estimation,
    2016.
    """
    better, after = np.zeros_like(played.rewards), np.zeros_like(values[0])
    for t in reversed(range(len(better))):
        goes_on = ~played.ends[t][:, None]
        surprise = played.rewards[t] + DISCOUNT * goes_on * values[t + 1] - values[t]
        better[t] = after = surprise + DISCOUNT * TRACE * goes_on * after
    return better


def check_same(options: dict[str, Any], path: Path) -> None:
    """Keeps the options in a file, but for how many rounds there are and where.

    Raises:
        CadenzaError: it holds others, with which something has been learnt.
    """
    options = {name: plain(value) for name, value in options.items() if name in _LASTING}
    if path.exists() and read_json(path, dict) != options:
        raise CadenzaError(f"{path.parent}: begun with other options, see {path.name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, options)


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("songs", help="a library, as LIBRARY or LIBRARY:SPLIT")
    parser.add_argument("-o", "--output", type=Path, required=True, help="a folder")
    parser.add_argument("--weights", type=Path, help="to improve; by default, those of Cadenza")
    parser.add_argument("--most", type=int, default=160, help="songs, drawn")
    parser.add_argument("--rounds", type=int, default=850, help="of 4,096 steps of a hand")
    parser.add_argument("--seed", type=int, default=0, help="of which songs, and noise")
    given = parser.parse_args()
    rng, scene = np.random.default_rng(given.seed), build_scene()
    weights = Weights.load(given.weights) if given.weights else shipped_for(scene)
    assert weights is not None
    networks = Networks(weights, scene)
    songs = planned(given.songs, given.most, rng)
    check_same(vars(given), given.output / "options.json")
    learner, checkpoint = Learner(networks, given.rounds, rng), given.output / "checkpoint.npz"
    if checkpoint.exists():
        learner.load(checkpoint)
        rng = np.random.default_rng((given.seed, learner.rounds))
    stage = Stage(songs, scene, rng)
    for number in tqdm(range(learner.rounds + 1, given.rounds + 1), desc="rounds"):
        played = stage.play(networks, learner.layers, STEPS)
        learner.learn(played)
        if number % KEPT_EVERY == 0 or number == given.rounds:
            learner.save(checkpoint)
            networks.with_layers(learner.mean).save(given.output / "weights.npz")
            lost = -played.rewards.sum(axis=2).mean()
            tqdm.write(f"round {number}: a hand loses {lost:.3f} a step")


if __name__ == "__main__":
    main()
