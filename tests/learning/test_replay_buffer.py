"""The replay against a twin that keeps whole transitions in plain Python."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from rl_examples import melody

from cadenza.errors import CadenzaError
from cadenza.learning.observation import GoalTable, Observer
from cadenza.learning.replay_buffer import Batch, ReplayBuffer
from cadenza.tasks.piano_task import PianoTask

REST, ACTIONS = 2, 3
Floats = np.ndarray


class PlainObserver:
    """An observer of all its arguments: row, rest, previous action and reward (0 at first)."""

    proprioception_size = REST

    def observation(
        self, rows: Any, rest: Floats, action: Floats, reward: Floats, first: Any
    ) -> Floats:
        before = np.concatenate([action, reward[..., None]], axis=-1)
        before = np.where(first[..., None], np.float32(0), before)
        return np.concatenate([rows[..., None].astype(np.float32), rest, before], axis=-1)


@dataclass
class Frame:
    """The twin's memory of one moment, and of the transition from it once it was acted on."""

    observation: tuple[float, ...]
    first: bool
    transition: tuple[Any, ...] | None = None


@dataclass
class Twin:
    """The last frames of one environment, whole."""

    frames: deque[Frame]
    last: tuple[float, ...] = (0.0,) * (ACTIONS + 1)

    def observe(self, row: int, rest: Floats, first: bool) -> None:
        before = (0.0,) * (ACTIONS + 1) if first else self.last
        shown = (float(row), *rest.tolist(), *before)
        if self.frames and not first and self.frames[-1].transition is not None:
            self.frames[-1].transition = (*self.frames[-1].transition[:4], shown)
        self.frames.append(Frame(shown, first))

    def act(self, action: Floats, reward: np.float32, terminated: bool) -> None:
        self.last = (*action.tolist(), float(reward))
        discount = 0.0 if terminated else 1.0
        frame = self.frames[-1]
        frame.transition = (frame.observation, self.last[:-1], self.last[-1], discount, None)

    def held(self) -> set[tuple[Any, ...]]:
        """Transitions of which the frames are there, and where it counts the one before."""
        frames = list(self.frames)
        return {
            frame.transition
            for i, frame in enumerate(frames)
            if frame.transition is not None and (i > 0 or frame.first)
        }


@dataclass
class Playing:
    """Feeds a replay and its twins with the same made-up episodes."""

    num_envs: int
    length: int
    seed: int
    ending: float = 0.2
    replay: ReplayBuffer = field(init=False)
    envs: list[Twin] = field(init=False)

    def __post_init__(self) -> None:
        self.replay = self.new_replay()
        self.rng = np.random.default_rng(self.seed)
        self.envs = [Twin(deque(maxlen=self.length)) for _ in range(self.num_envs)]
        self.row = np.zeros(self.num_envs, np.int64)
        self.newest: tuple[Any, ...] = ()
        self.observe(np.arange(self.num_envs))

    def new_replay(self) -> ReplayBuffer:
        capacity = self.length * self.num_envs
        return ReplayBuffer(PlainObserver(), self.num_envs, capacity, ACTIONS)  # type: ignore[arg-type]

    def observe(self, ids: np.ndarray) -> None:
        rest = self.rng.standard_normal((len(ids), REST)).astype(np.float32)
        self.newest = (ids, rest, self.row[ids], self.row[ids] == 0)
        self.replay.observe(*self.newest)
        for env, shown in zip(ids.tolist(), rest, strict=True):
            self.envs[env].observe(int(self.row[env]), shown, bool(self.row[env] == 0))

    def step(self) -> None:
        """Add frames as a collector does: at the end of an episode its last, then a first."""
        rng = self.rng
        action = rng.standard_normal((self.num_envs, ACTIONS)).astype(np.float32)
        reward = rng.standard_normal(self.num_envs).astype(np.float32)
        terminated = rng.random(self.num_envs) < self.ending / 2
        ended = terminated | (rng.random(self.num_envs) < self.ending / 2)
        self.replay.act(action, reward, terminated)
        for twin, *what in zip(self.envs, action, reward, terminated.tolist(), strict=True):
            twin.act(*what)
        self.row += 1
        if ended.any():
            self.observe(np.flatnonzero(ended))
            self.row[ended] = 0
        self.observe(np.arange(self.num_envs))

    def after(self, steps: int) -> Self:
        """This, after so many more steps."""
        for _ in range(steps):
            self.step()
        return self

    def held(self) -> set[tuple[Any, ...]]:
        return set().union(*(twin.held() for twin in self.envs))


def as_tuples(batch: Batch) -> list[tuple[Any, ...]]:
    """The transitions of a batch (B, ...)."""
    parts = zip(*(part.tolist() for part in batch), strict=True)
    return [(tuple(o), tuple(a), r, d, tuple(after)) for o, a, r, d, after in parts]


def assert_same(drawn: Batch, expected: Batch) -> None:
    for ours, theirs in zip(drawn, expected, strict=True):
        assert_array_equal(ours, theirs)


# What is drawn


@settings(max_examples=60, deadline=None)
@given(
    num_envs=st.integers(1, 4),
    length=st.integers(4, 12),
    steps=st.integers(1, 60),
    ending=st.sampled_from([0.0, 0.2, 0.6, 1.0]),
    seed=st.integers(0, 2**31),
)
def test_draws_exactly_the_transitions_that_are_held(num_envs, length, steps, ending, seed):
    """Episodes have any length, down to one step; the ring wraps up to fifteen times."""
    playing = Playing(num_envs, length, seed, ending)
    for step in range(steps):
        playing.step()
        if step % 7 == 0 or step == steps - 1:
            held = playing.held()
            assert len(playing.replay) == len(held) > 0
            drawn = playing.replay.sample(np.random.default_rng(seed), (60 * len(held),))
            assert set(as_tuples(drawn)) == held


def test_every_transition_is_as_likely():
    """Environments whose episodes end more often have more frames, not more weight a frame."""
    playing = Playing(num_envs=3, length=20, seed=0).after(50)
    number = len(playing.replay)
    drawn = as_tuples(playing.replay.sample(np.random.default_rng(0), (1000 * number,)))
    counts = np.array([drawn.count(transition) for transition in playing.held()])
    # Standard deviation about the square root of 1000.
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(1000)


def test_batches_have_the_shape_that_was_asked_for():
    playing = Playing(2, 10, 0).after(5)
    batch = playing.replay.sample(np.random.default_rng(0), (3, 4))
    observation = (3, 4, 1 + REST + ACTIONS + 1)
    shapes = [observation, (3, 4, ACTIONS), (3, 4), (3, 4), observation]
    assert [part.shape for part in batch] == shapes
    assert {part.dtype for part in batch} == {np.dtype(np.float32)}


def test_nothing_can_be_drawn_before_anything_was_done():
    with pytest.raises(ValueError, match="no transitions yet"):
        Playing(2, 10, 0).replay.sample(np.random.default_rng(0), (4,))


# To go on later


@settings(max_examples=40, deadline=None)
@given(
    num_envs=st.integers(1, 3),
    length=st.integers(4, 12),
    pauses=st.lists(st.integers(0, 30), min_size=1, max_size=5),
    ending=st.sampled_from([0.0, 0.2, 1.0]),
    seed=st.integers(0, 2**31),
)
def test_goes_on_from_chunks_as_if_nothing_had_happened(num_envs, length, pauses, ending, seed):
    """Chunks of any size, among them empty ones and some of more than the ring holds."""
    check_chunks(Playing(num_envs, length, seed, ending), pauses)


def test_goes_on_from_two_chunks_that_meet_anywhere_in_the_ring():
    for before in range(1, 10):
        for after in range(10):
            check_chunks(Playing(1, 6, 0, ending=0.0), [before, after])


def check_chunks(playing: Playing, pauses: list[int]) -> None:
    """A new replay gets what was gathered between pauses of so many steps."""
    chunks: list[dict[str, np.ndarray]] = []
    for steps in pauses:
        playing.after(steps)
        chunk = playing.replay.since(chunks[-1]["to"] if chunks else 0)
        chunks = [c for c in chunks if playing.replay.holds(c["to"])] + [chunk]
    again = playing.new_replay()
    for chunk in chunks:
        again.restore({name: array.copy() for name, array in chunk.items()})
    again.observe(*playing.newest)
    assert len(again) == len(playing.replay)
    if len(again):
        drawn = again.sample(np.random.default_rng(1), (50,))
        assert_same(drawn, playing.replay.sample(np.random.default_rng(1), (50,)))
    playing.replay = again
    for _ in range(8):
        playing.step()
        held = playing.held()
        assert len(again) == len(held)
        assert set(as_tuples(again.sample(np.random.default_rng(2), (40 * len(held),)))) == held


@settings(max_examples=80, deadline=None)
@given(
    num_envs=st.integers(1, 3),
    length=st.integers(4, 30),
    pauses=st.lists(st.integers(0, 30), min_size=1, max_size=6),
    lost=st.sets(st.integers(0, 5), min_size=1),
    seed=st.integers(0, 2**31),
)
@example(num_envs=1, length=4, pauses=[1, 0, 1], lost={0}, seed=0)  # an empty one in the gap
def test_goes_on_without_chunks_that_are_lost(num_envs, length, pauses, lost, seed):
    """It has the transitions that were held and no others: none reaches over a gap."""
    playing, chunks = Playing(num_envs, length, seed), []
    for steps in pauses:
        playing.after(steps)
        chunks.append(playing.replay.since(chunks[-1]["to"] if chunks else 0))
    again = playing.new_replay()
    for number, chunk in enumerate(chunks):
        if number not in lost:
            again.restore(chunk)
    again.skip(chunks[-1]["to"])
    again.observe(*playing.newest)
    rows = len(again)
    if lost.isdisjoint(range(len(chunks))):
        assert rows == len(playing.replay)
    if rows:
        drawn = as_tuples(again.sample(np.random.default_rng(1), (30 * rows,)))
        assert set(drawn) <= playing.held()
        assert len(set(drawn)) > 0.9 * rows


def test_what_is_left_of_much_is_found():
    """Ten transitions among a hundred thousand places."""
    playing = Playing(num_envs=1, length=100_000, seed=0, ending=0.0).after(10)
    left = playing.new_replay()
    left.restore(playing.replay.since(0))
    left.skip(np.array([99_990]))
    drawn = left.sample(np.random.default_rng(0), (1000,))
    assert set(as_tuples(drawn)) < playing.held()
    assert len(set(as_tuples(drawn))) == 9  # without the one that led to the gap


@pytest.mark.parametrize(
    "change",
    [
        {"row": np.zeros((6, 2), np.int32)},
        {"row": np.zeros(5, np.int32)},
        {"proprioception": np.zeros((6, REST + 1), np.float32)},
        {"reward": np.array(["x"] * 6)},
        {"complete": np.ones(6, np.float32)},
        {"from": np.array([-1])},
        {"to": np.array([5])},
        {"to": np.array([10**12])},
        {"to": np.array([5, 6])},
        {"to": np.array([6.0])},
    ],
)
def test_a_chunk_of_something_else_is_refused(change):
    playing = Playing(num_envs=1, length=10, seed=0, ending=0.0).after(6)
    chunk = playing.replay.since(0)
    with pytest.raises(CadenzaError, match="experience"):
        playing.new_replay().restore(chunk | change)
    with pytest.raises(CadenzaError, match="no array named proprioception"):
        playing.new_replay().restore({n: a for n, a in chunk.items() if n != "proprioception"})


def test_chunks_that_the_ring_has_overwritten_are_not_needed():
    playing = Playing(num_envs=1, length=10, seed=0, ending=0.0).after(5)
    to = playing.replay.since(0)["to"]
    assert playing.replay.holds(to)
    playing.after(20)
    assert not playing.replay.holds(to)


# Room


def test_a_transition_of_the_full_observation_takes_less_than_1500_bytes():
    """Two observations of 1,100 numbers, as others keep them, take 9,300."""
    task = PianoTask([melody(60)], num_envs=2)
    observer = Observer(task.spec, GoalTable(task.spec))
    replay = ReplayBuffer(observer, 2, 1000, task.spec.action_size)
    assert 4 * (2 * len(observer.inputs.kept) + task.spec.action_size) > 9000
    assert replay.num_bytes / 1000 < 1500
