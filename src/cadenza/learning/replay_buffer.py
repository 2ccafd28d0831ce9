"""A replay buffer that stores each result of the simulation once.

An observation is the next one of the step before, and what follows from the score is not stored but
rebuilt (`observation`).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import INTEGERS, ArrayOf, check_arrays
from cadenza.learning.observation import Floats, Observer

Rows = NDArray[np.int64]

_MIN_COMPLETE = 1 / 8  # share of the frames; with less, rejection sampling takes too many attempts


class Batch(NamedTuple):
    """Transitions; arrays (..., D), (..., A), (...), (...), (..., D)."""

    observation: Floats
    action: Floats
    reward: Floats
    discount: Floats
    """0 where the episode terminated, else 1; a song's end does not terminate it."""
    next_observation: Floats


class ReplayBuffer:
    """A ring of frames for each of N environments, in the order in which they came.

    A frame is an observation, the action taken then, its reward, and whether it terminated the
    episode. The last frame of an episode has no action, and neither has the newest.
    """

    def __init__(self, observer: Observer, num_envs: int, capacity: int, action_size: int) -> None:
        """Make room for `capacity` frames of all environments, or raise CadenzaError."""
        self._observer = observer
        # At least four: a frame with an action outlives the end of its episode and the next start.
        length = max(-(-capacity // num_envs), 4)
        self._shape = shape = (num_envs, length)
        try:
            self._frames: dict[str, NDArray[Any]] = {
                "proprioception": np.zeros((*shape, observer.proprioception_size), np.float32),
                "action": np.zeros((*shape, action_size), np.float32),
                "reward": np.zeros(shape, np.float32),
                "row": np.zeros(shape, np.int32),
                "first": np.zeros(shape, bool),
                "terminated": np.zeros(shape, bool),
                "complete": np.zeros(shape, bool),
            }
        except MemoryError as error:
            raise CadenzaError(f"buffer_size {capacity}: not enough memory; choose less") from error
        self._count = np.zeros(num_envs, np.int64)  # frames ever added
        self._size = 0  # transitions

    def __len__(self) -> int:
        """The number of transitions."""
        return self._size

    @property
    def num_bytes(self) -> int:
        """The most bytes that `since` returns."""
        counts = 2 * self._count.nbytes
        return counts + sum(values.nbytes for values in self._frames.values())

    def observe(
        self, env_ids: Rows, proprioception: Floats, row: Rows, first: NDArray[np.bool_]
    ) -> None:
        """Add a frame (E, ...) to each of these environments."""
        frames, (_, length) = self._frames, self._shape
        at = (env_ids, self._count[env_ids] % length)
        self._size -= int(frames["complete"][at].sum())
        frames["proprioception"][at] = proprioception
        frames["row"][at], frames["first"][at] = row, first
        frames["complete"][at] = False
        self._count[env_ids] += 1
        # The frame that is overwritten next loses the one before it.
        after = (env_ids, self._count[env_ids] % length)
        lost = frames["complete"][after] & ~frames["first"][after]
        self._size -= int(lost.sum())
        frames["complete"][after] &= ~lost

    def act(self, action: Floats, reward: Floats, terminated: NDArray[np.bool_]) -> None:
        """Complete the newest frame of every environment, (N, A), (N,), (N,)."""
        frames, (num_envs, length) = self._frames, self._shape
        at = (np.arange(num_envs), (self._count - 1) % length)
        frames["action"][at], frames["reward"][at] = action, reward
        frames["terminated"][at], frames["complete"][at] = terminated, True
        self._size += num_envs

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Batch:
        """Draw transitions (*shape, ...) with replacement; raises ValueError without any."""
        if not self._size:
            raise ValueError("the replay buffer has no transitions yet")
        env, column = self._draw(rng, int(np.prod(shape)))
        return Batch(*(part.reshape(*shape, *part.shape[1:]) for part in self._batch(env, column)))

    def _draw(self, rng: np.random.Generator, number: int) -> tuple[Rows, Rows]:
        num_envs, length = self._shape
        written = int(min(self._count.max(), length))
        if self._size < _MIN_COMPLETE * num_envs * written:  # much was lost
            complete = np.flatnonzero(self._frames["complete"][:, :written])
            drawn = rng.choice(complete, number)
            return drawn // written, drawn % written
        drawn = np.zeros(0, np.int64)
        while len(drawn) < number:
            flat = rng.integers(num_envs * written, size=number - len(drawn))
            complete = self._frames["complete"][flat // written, flat % written]
            drawn = np.append(drawn, flat[complete])
        return drawn // written, drawn % written

    def _batch(self, env: Rows, column: Rows) -> Batch:
        frames, length = self._frames, self._shape[1]
        before, after = (env, (column - 1) % length), (env, (column + 1) % length)
        frame = (env, column)
        observe = self._observer.observation
        action, reward = frames["action"], frames["reward"]
        return Batch(
            observation=observe(
                frames["row"][frame],
                frames["proprioception"][frame],
                action[before],
                reward[before],
                frames["first"][frame],
            ),
            action=action[frame],
            reward=reward[frame],
            discount=np.where(frames["terminated"][frame], np.float32(0), np.float32(1)),
            next_observation=observe(
                frames["row"][after],
                frames["proprioception"][after],
                action[frame],
                reward[frame],
                np.zeros(len(env), bool),
            ),
        )

    # To go on later

    def complete_counts(self) -> Rows:
        """Count the frames (N,) ever added that will not change any more."""
        return self._count - 1

    def holds(self, counts: Rows) -> bool:
        """Whether a frame is left that was added before there were `counts` (N,)."""
        return bool((counts > self.complete_counts() - self._shape[1]).any())

    def since(self, counts: Rows | int) -> dict[str, NDArray[Any]]:
        """The frames left that were completed since the environments had `counts` (N,).

        They are in order of environments; `from` and `to` (N,) number them.
        """
        length, to = self._shape[1], self.complete_counts()
        start = np.maximum(counts, to - length)
        at = self._places(start, to)
        return {name: values[at] for name, values in self._frames.items()} | {
            "from": start,
            "to": to,
        }

    def restore(self, chunk: dict[str, NDArray[Any]]) -> None:
        """Add the frames of `since`, in its order; the newest frame must be observed again.

        Raises CadenzaError if the frames are of other environments.
        """
        check_arrays(chunk, self._expected(), "experience")
        start, to, there = chunk["from"], chunk["to"], len(chunk["row"])
        if ((start < self._count) | (to < start) | (to > start + self._shape[1])).any():
            raise CadenzaError("experience: does not continue what came before; start a new run")
        if there != (expected := (to - start).sum()):
            raise CadenzaError(f"experience: has {there} frames instead of {expected}")
        # Without frames of an environment, its gap stays: the next frame is the first after it.
        any_frames = to > start
        start, to = np.where(any_frames, start, self._count), np.where(any_frames, to, self._count)
        gap = np.flatnonzero(self._count < start)
        self.skip(start)
        at = self._places(start, to)
        for name, values in self._frames.items():
            values[at] = chunk[name]
        after = (gap, start[gap] % self._shape[1])
        self._frames["complete"][after] &= self._frames["first"][after]
        self._count, self._size = to.copy(), int(self._frames["complete"].sum())

    def skip(self, counts: Rows) -> None:
        """Continue after `counts` (N,) frames; frames that were not restored are lost."""
        length, complete = self._shape[1], self._frames["complete"]
        # The last before a gap lacks the one after it.
        last = np.where(self._count < counts, self._count - 1, counts)
        complete[self._places(np.maximum(last, counts - length), counts)] = False
        self._count, self._size = counts.copy(), int(complete.sum())

    def _places(self, start: Rows, to: Rows) -> tuple[Rows, Rows]:
        """Environments and columns of the frames from `start` (N,) up to `to` (N,)."""
        env = np.repeat(np.arange(len(to)), to - start)
        number = np.concatenate([np.arange(a, b) for a, b in zip(start, to, strict=True)])
        return env, number % self._shape[1]

    def _expected(self) -> dict[str, ArrayOf]:
        counts = ArrayOf(INTEGERS, (self._shape[0],), needed=True)
        frames = {
            name: ArrayOf(values.dtype.kind, ("frames", *values.shape[2:]), needed=True)
            for name, values in self._frames.items()
        }
        return frames | {"from": counts, "to": counts}
