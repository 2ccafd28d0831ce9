"""Measures how fast learning is, as ratios side by side in one run.

    python -m benchmarks.learning [SONG] [--published VENV]

"plain" is the published learner written plainly (`plain_droq`); "ours" is `cadenza.learning` with
the paper's settings. Those of one table work in turns, in each of several rounds for as many
updates, so that a noisy machine disturbs all alike; of each the median speed counts.

With the published environment (tools/published_setup.sh) it is stepped in the same rounds, and
from its time follows what the plain learner would make with it.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import numpy as np

from benchmarks.arguments import one_or_more, parser_for
from benchmarks.plain_droq import DROPOUT, Function, PlainBuffer, PlainLearner
from benchmarks.speed import Contestant, medians, published
from cadenza.errors import errors_in_a_line
from cadenza.learning.actions import ActionMapping
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.droq.networks import Dropout
from cadenza.learning.collector import Collector
from cadenza.learning.config import TrainingConfig
from cadenza.learning.observation import (
    Floats,
    GoalTable,
    Inputs,
    ObservationSpec,
    Observer,
    pruned,
)
from cadenza.learning.problem import problem_of
from cadenza.learning.replay_buffer import Batch, ReplayBuffer
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import Training
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Score
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.setups import setup_named

PAPERS = TaskConfig(**setup_named("paper").of(TaskConfig))
SONG = "TwinkleTwinkleLittleStar"
BATCH = 256  # transitions an update
UPDATES_PER_CALL = 16  # where there are several
PLAYED = 1_000  # control steps of random play
TRANSITIONS = 100_000  # that are sampled from: more than fit in a cache
LEARNING_STARTS = 500  # control steps before training learns
NEVER = 10**12  # control steps

Sample = Callable[[], Batch]
our_dropout = partial(Dropout, DROPOUT)


def no_dropout() -> Function:
    """Drops nothing."""
    return lambda x: x


# What is learnt from


class Experience(NamedTuple):
    """One random play, kept in several replay buffers."""

    plain: PlainBuffer
    complete: ReplayBuffer
    """Our replay buffer with all inputs."""
    short: ReplayBuffer
    """Our replay buffer without the inputs that are always zero."""
    inputs: Inputs
    short_inputs: Inputs
    action_size: int
    bytes_per_frame: int
    """Bytes of a frame in our replay buffer."""
    frames_per_transition: float
    """Frames for each transition in our replay buffer: an episode has one frame more."""


def gather(score: Score) -> Experience:
    """Plays `PLAYED` control steps, and keeps them over and over."""
    task, rng = PianoTask([score], PAPERS), np.random.default_rng(0)
    scores = GoalTable(task.spec, task.tracks)
    spec = ObservationSpec.of(task.spec)
    inputs, short_inputs = spec.inputs, pruned(spec, *scores.goals_used())
    observer = Observer(task.spec, scores, inputs)
    actions = task.spec.action_size
    played = ReplayBuffer(observer, 1, 2 * PLAYED, actions)
    mapping = ActionMapping(task.spec)
    collector = Collector(task, scores, observer, played, mapping, rng)
    collector.begin()
    collector.collect(None, PLAYED)

    frames = played.since(0)
    start, to = frames.pop("from"), frames.pop("to")
    copies = TRANSITIONS // PLAYED
    many = {n: np.tile(a, (copies, *(1,) * (a.ndim - 1))) for n, a in frames.items()}
    many |= {"from": start, "to": to * copies}

    def filled(observer: Observer) -> ReplayBuffer:
        replay = ReplayBuffer(observer, 1, int(to[0]) * copies, actions)
        replay.restore(many)
        return replay

    complete = filled(observer)
    plain = PlainBuffer(inputs.total, actions, TRANSITIONS)
    for _ in range(copies):
        for transition in zip(*complete.sample(rng, (PLAYED,)), strict=True):
            plain.insert(Batch(*transition))
    return Experience(
        plain=plain,
        complete=complete,
        short=filled(Observer(task.spec, scores, short_inputs)),
        inputs=inputs,
        short_inputs=short_inputs,
        action_size=actions,
        bytes_per_frame=sum(a.nbytes for a in frames.values()) // int(to[0]),
        frames_per_transition=int(to[0]) / PLAYED,
    )


# Contestants; they return transitions, or control steps, per second


def updates(update: Any, state: Any, sample: Sample, number: int) -> Contestant:
    """Draws batches and learns from them; `update` maps state and batch to state and figures."""

    def run_for(transitions: int) -> float:
        nonlocal state
        learnt, start = 0, time.perf_counter()
        while learnt < transitions:
            batch = sample()
            state, _ = update(state, batch)
            jax.block_until_ready(state)  # as whoever acts next has to wait
            learnt += batch.reward.size
        return learnt / (time.perf_counter() - start)

    run_for(1)  # compiles
    return partial(run_for, number * BATCH)


def plain_updates(learner: PlainLearner, sample: Sample, number: int) -> Contestant:
    """Updates of the plain learner."""
    return updates(learner.update, learner.init(0), sample, number)


def our_updates(
    inputs: Inputs, action_size: int, sample: Sample, number: int, config: DroQConfig
) -> Contestant:
    """Updates of our learner, for which batches are (updates a call, B, ...)."""
    learner = config.make(inputs, action_size)
    return updates(learner.update, learner.init(0), sample, number)


def samples(sample: Sample, number: int) -> Contestant:
    """Draws batches."""

    def run() -> float:
        start = time.perf_counter()
        drawn = sum(sample().reward.size for _ in range(number))
        return drawn / (time.perf_counter() - start)

    return run


def training(config: TrainingConfig, score: Score, folder: Path, rounds: int) -> Contestant:
    """Trains, without evaluations and checkpoints."""
    config = replace(
        config,
        learning_starts=LEARNING_STARTS,
        num_steps=NEVER,
        eval_interval=NEVER,
        log_interval=NEVER,
        checkpoint_interval=math.inf,
    )
    folder.mkdir()
    run = Training(problem_of(config, [score]), RunFolder(folder))

    def run_for(rounds: int) -> float:
        seen: list[tuple[float, int]] = []  # asked between rounds; the save at the end is outside

        def goes_on() -> bool:
            seen.append((time.perf_counter(), run.step))
            return len(seen) <= rounds

        run.run(goes_on)
        (start, first), (end, last) = seen[0], seen[-1]
        return (last - first) / (end - start)

    run_for(LEARNING_STARTS + 1)  # compiles
    return partial(run_for, rounds)


class PlainLoop:
    """Training around our environment as a plain program does it: one thing after the other."""

    def __init__(self, score: Score) -> None:
        self._task, self._rng = PianoTask([score], PAPERS), np.random.default_rng(0)
        actions = self._task.spec.action_size
        size = self._task.spec.observation_size + actions + 1
        self._learner = PlainLearner(size, actions)
        self._state = self._learner.init(0)
        self._buffer = PlainBuffer(size, actions, TRANSITIONS)
        self._begin()

    def _begin(self) -> None:
        self._task.reset([self._rng], [0])
        self._observation = self._observe(np.zeros(self._task.spec.action_size), np.zeros(1))

    def _observe(self, ctrl: Any, reward: Any) -> Floats:
        parts = (self._task.observation()[0], ctrl, reward)
        return np.concatenate(parts, dtype=np.float32, casting="same_kind")

    def _step(self, action: Floats) -> None:
        ctrl = self._task.spec.scale_action(action[None])
        result = self._task.step(ctrl)
        reward, goes_on = result.reward.astype(np.float32), ~result.terminated
        before, self._observation = self._observation, self._observe(ctrl[0], reward)
        discount = goes_on.astype(np.float32)
        self._buffer.insert(Batch(before, action, reward[0], discount[0], self._observation))
        if result.terminated[0] or result.truncated[0]:
            self._begin()

    def play(self, steps: int) -> float:
        """Random actions, kept; returns control steps per second."""
        start = time.perf_counter()
        for _ in range(steps):
            self._step(self._rng.uniform(-1, 1, self._task.spec.action_size).astype(np.float32))
        return steps / (time.perf_counter() - start)

    def learn(self, steps: int) -> float:
        """The policy's actions, and an update after each; returns control steps per second."""
        start = time.perf_counter()
        for _ in range(steps):
            self._state, action = self._learner.act(self._state, self._observation)
            self._step(action)
            batch = self._buffer.sample(self._rng, BATCH)
            self._state, _ = self._learner.update(self._state, batch)
        jax.block_until_ready(self._state)
        return steps / (time.perf_counter() - start)


# Tables


def whole_updates(had: Experience, number: int) -> dict[str, Contestant]:
    """The contestants of a table: they draw batches and update."""
    rng = np.random.default_rng(0)
    relu, gelu = DroQConfig(), DroQConfig(activation="gelu")

    def plain(activation: Function) -> Contestant:
        learner = PlainLearner(had.inputs.total, had.action_size, activation)
        return plain_updates(learner, lambda: had.plain.sample(rng, BATCH), number)

    def ours(short: bool, config: DroQConfig, per_call: int, batch: int = BATCH) -> Contestant:
        replay, inputs = (had.short, had.short_inputs) if short else (had.complete, had.inputs)
        return our_updates(
            inputs, had.action_size, lambda: replay.sample(rng, (per_call, batch)), number, config
        )

    several, doubled = UPDATES_PER_CALL, 2 * BATCH
    return {
        "plain": plain(nn.relu),
        "plain, GELU": plain(nn.gelu),
        "ours, all inputs": ours(False, relu, 1),
        "ours, all inputs, GELU": ours(False, gelu, 1),
        "ours, zeros left out": ours(True, relu, 1),
        "ours, zeros left out, GELU": ours(True, gelu, 1),
        f"ours, all inputs, {several} a call": ours(False, relu, several),
        f"ours, zeros left out, {several} a call": ours(True, relu, several),
        f"ours, all inputs, {several} a call, of {doubled}": ours(False, relu, several, doubled),
        f"ours, zeros left out, {several} a call, of {doubled}": ours(True, relu, several, doubled),
    }


def ingredients(had: Experience, number: int) -> dict[str, Contestant]:
    """The contestants of a table: the plain update of one batch, changed bit by bit into ours."""
    rng = np.random.default_rng(0)
    batch, short = had.complete.sample(rng, (1, BATCH)), had.short.sample(rng, (1, BATCH))

    def plain(inputs: Inputs, many: Batch, **choices: Any) -> Contestant:
        learner = PlainLearner(len(inputs.kept), had.action_size, **choices)
        one = Batch(*(part[0] for part in many))
        return plain_updates(learner, lambda: one, number)

    def ours(inputs: Inputs, many: Batch) -> Contestant:
        return our_updates(inputs, had.action_size, lambda: many, number, DroQConfig())

    complete, fewer = partial(plain, had.inputs, batch), partial(plain, had.short_inputs, short)
    return {
        "plain": complete(),
        "critics not stacked": complete(stacked=False),
        "our dropout": complete(dropout=our_dropout),
        "our dropout, critics not stacked": complete(dropout=our_dropout, stacked=False),
        "no dropout": complete(dropout=no_dropout),
        "no dropout, critics not stacked": complete(dropout=no_dropout, stacked=False),
        "zeros left out": fewer(),
        "all three": fewer(dropout=our_dropout, stacked=False),
        "ours, all inputs": ours(had.inputs, batch),
        "ours, zeros left out": ours(had.short_inputs, short),
    }


def sampling(had: Experience, number: int) -> dict[str, Contestant]:
    """The contestants of a table: they sample batches."""
    rng = np.random.default_rng(0)
    return {
        "plain": samples(lambda: had.plain.sample(rng, BATCH), number),
        "ours, all inputs": samples(lambda: had.complete.sample(rng, (BATCH,)), number),
        "ours, zeros left out": samples(lambda: had.short.sample(rng, (BATCH,)), number),
    }


def whole_training(
    score: Score, song: str, folder: Path, venv: Path | None, number: int
) -> dict[str, Contestant]:
    """The contestants of a table: they train in one environment, an update a control step."""
    loop = PlainLoop(score)
    loop.play(LEARNING_STARTS)
    loop.learn(1)  # compiles
    paper = TrainingConfig(task=PAPERS, buffer_size=TRANSITIONS, prune_inputs=False)
    fewer = replace(paper, prune_inputs=True)
    entered: dict[str, Contestant] = {
        "plain": lambda: loop.learn(number),
        "ours, all inputs": training(paper, score, folder / "complete", number),
        "ours, zeros left out": training(fewer, score, folder / "short", number),
        "our environment alone": lambda: loop.play(number),
    }
    if venv:
        entered["the published environment alone"] = published(venv, ["--song", song])
    return entered


def print_updates(title: str, speeds: dict[str, float]) -> None:
    """Times and speeds against the plain learner's."""
    print(f"\n{title}\n\n| | ms per {BATCH} transitions | of plain |\n| --- | --- | --- |")
    for name, speed in speeds.items():
        print(f"| {name} | {1e3 * BATCH / speed:.2f} | {speed / speeds['plain']:.2f} |")


def print_replay(had: Experience, speeds: dict[str, float]) -> None:
    """Room and time that it takes to keep transitions."""
    ours = had.bytes_per_frame * had.frames_per_transition
    sizes = dict.fromkeys(speeds, ours) | {"plain": had.plain.nbytes / TRANSITIONS}
    print(f"\nkeeping transitions\n\n| | bytes | of plain | µs to draw {BATCH} | speed, of plain |")
    print("| --- | --- | --- | --- | --- |")
    for name, speed in speeds.items():
        size = f"{sizes[name]:.0f} | {sizes[name] / sizes['plain']:.3f}"
        print(f"| {name} | {size} | {1e6 * BATCH / speed:.0f} | {speed / speeds['plain']:.2f} |")


def print_training(speeds: dict[str, float]) -> None:
    """Steps per second, and with the published environment what it would make of the plain loop."""
    theirs, environment = "the published environment alone", "our environment alone"
    if theirs in speeds:
        seconds = 1 / speeds["plain"] - 1 / speeds[environment] + 1 / speeds[theirs]
        speeds = speeds | {"plain with the published environment (calculated)": 1 / seconds}
    print("\ntraining\n\n| | steps/s | of plain |\n| --- | --- | --- |")
    for name, speed in speeds.items():
        print(f"| {name} | {speed:.1f} | {speed / speeds['plain']:.2f} |")
    if theirs not in speeds:
        print("\nThe published environment was not measured: --published VENV.")


@errors_in_a_line()
def main() -> None:
    """Measures and prints tables in Markdown."""
    parser = parser_for(__doc__)
    parser.add_argument(
        "song",
        nargs="?",
        default=SONG,
        help="what is learnt; with --published one of the published system",
    )
    parser.add_argument("--published", type=Path, help="venv made by tools/published_setup.sh")
    parser.add_argument("--rounds", type=one_or_more, default=15)
    parser.add_argument("--updates", type=one_or_more, default=32, help="of each in a round")
    options = parser.parse_args()
    rounds, number = options.rounds, options.updates
    score = load_score(options.song)

    had = gather(score)
    kept, total = len(had.short_inputs.kept), had.inputs.total
    print(f"{options.song}: {kept} of {total} inputs are not always zero")
    print_updates("an update, its batch drawn", medians(whole_updates(had, number), rounds))
    print_updates("what brings it: an update", medians(ingredients(had, number), rounds))
    print_replay(had, medians(sampling(had, number), rounds))
    with tempfile.TemporaryDirectory() as folder:
        entered = whole_training(score, options.song, Path(folder), options.published, number)
        print_training(medians(entered, rounds))


if __name__ == "__main__":
    main()
