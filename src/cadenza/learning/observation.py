"""A policy's observation: the task's, its previous action and reward, a reference action.

Its shape follows from task and scene, and is the same for every song (`ObservationSpec`). For a
single song it can be pruned (`pruned`) and put on the scale of that song (`ranges`).

Most of it follows from the score and the step that comes next. `Observer` composes it from a table
of the scores and from the rest, for acting and for learning alike, so that a replay buffer has to
keep only the rest.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import FLOATS, INTEGERS, ArrayOf, check_arrays
from cadenza.keyboards.loudness import VELOCITIES
from cadenza.learning.ranges import Ranges
from cadenza.music.goals import NO_ONSETS, Onsets
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.view import TaskSpec, observed_onsets

Floats = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class ObservationSpec:
    """The parts of an observation in their order, each with its size, the same for all songs."""

    goal: int  # keys and pedal of the next step and of those ahead of it
    fingering: int
    goal_onset: int = 0  # when notes begin: in the last step, the next one, and those ahead of it
    goal_velocity: int = 0  # how loud these notes are
    key_state: int
    pedal: int
    joints: int
    touch: int = 0  # forces on the fingertips, where there are sensors
    key_onset: int = 0  # when keys began to sound in the last step
    key_velocity: int = 0  # how loud they did
    previous_action: int
    previous_reward: int
    reference: int  # the next action of what a residual policy corrects

    @classmethod
    def of(cls, task: TaskSpec, residual: bool = False) -> ObservationSpec:
        """The observation of a task."""
        sizes = {name: part.stop - part.start for name, part in task.observation_layout.items()}
        own = {"previous_action": task.action_size, "previous_reward": 1}
        own["reference"] = task.action_size * residual
        return cls(**{field.name: (sizes | own).get(field.name, 0) for field in fields(cls)})

    @property
    def size(self) -> int:
        """The number D of entries."""
        return sum(astuple(self))

    @property
    def goals_of_a_step(self) -> int:
        """The number K + 1 of goals of a step, one for each key and one for the pedal."""
        return self.key_state + self.pedal

    @property
    def layout(self) -> dict[str, slice]:
        """The slice of an observation that each part takes, by its name."""
        ends = accumulate(astuple(self))
        return {
            field.name: slice(end - getattr(self, field.name), end)
            for field, end in zip(fields(self), ends, strict=True)
        }

    @property
    def inputs(self) -> Inputs:
        """The inputs that keep all entries."""
        return Inputs(tuple(range(self.size)), self.size)


@dataclass(frozen=True)
class Inputs:
    """The entries of an observation that a network is given."""

    kept: tuple[int, ...]  # their indices, ascending
    total: int  # the number of entries of the observation

    def __post_init__(self) -> None:
        """Raise a CadenzaError if the indices are not ascending, or not below the total."""
        if any(a >= b for a, b in pairwise((-1, *self.kept, self.total))):
            raise CadenzaError("inputs must be ascending indices below their total")


class GoalTable:
    """Goals of scores by row: a row for each control step, and silent rows after each score.

    Scores that are equal share their rows.
    """

    def __init__(self, task: TaskSpec, tracks: Iterable[GoalTrack] = ()) -> None:
        """Begin with some tracks; `task` says how far ahead the score is observed."""
        spec = ObservationSpec.of(task)
        self._num_goals = spec.goals_of_a_step
        self._num_keys, self._control_timestep = spec.key_state, task.config.control_timestep
        self._num_bits = self._num_goals + task.scene.fingers.count
        self._ahead = np.arange(spec.goal // self._num_goals)
        self._onsets_seen = np.arange(-1, spec.goal_onset // spec.key_state - 1)
        # Between scores, so that lookahead ends in silence, as what was before the next score does.
        self._silent_rows = max(len(self._ahead) - 1, int(spec.goal_onset > 0))
        # Keys, pedal, fingers wanted, in bits.
        self._rows = np.zeros((0, -(-self._num_bits // 8)), np.uint8)
        self._onsets = NO_ONSETS  # by row
        self._first: dict[bytes, int] = {}
        for track in tracks:
            self.add(track)

    def add(self, track: GoalTrack) -> int:
        """Add the score of a track unless it is there; returns the row of its first step."""
        goals = track.goals
        onsets = goals.onsets if self._shows_onsets else NO_ONSETS
        silence = np.zeros((self._silent_rows, self._num_bits), bool)
        steps = np.column_stack([goals.keys, goals.sustain, goals.active_fingers])
        bits = np.packbits(np.concatenate([steps, silence]), axis=1)
        key = _bytes_of(bits, onsets)
        if key not in self._first:
            self._first[key] = first = len(self._rows)
            self._rows = np.concatenate([self._rows, bits])
            both = zip(self._onsets, onsets.delayed(first), strict=True)
            self._onsets = Onsets._make(np.concatenate(parts) for parts in both)
        return self._first[key]

    @property
    def _shows_onsets(self) -> bool:
        return len(self._onsets_seen) > 0

    def goals(self, rows: NDArray[np.integer], kept: NDArray[np.intp]) -> Floats:
        """The task's observation of goals (..., len(kept)) from these rows (...) on."""
        bits = self._unpacked(rows[..., None] + self._ahead)
        flat = bits[..., : self._num_goals].reshape(*rows.shape, -1)
        return flat[..., kept].astype(np.float32)

    def fingers(self, rows: NDArray[np.integer], kept: NDArray[np.intp]) -> Floats:
        """The fingers (..., len(kept)) that have a key to press in these rows (...)."""
        return self._unpacked(rows)[..., self._num_goals + kept].astype(np.float32)

    def onsets(self, rows: NDArray[np.integer], kept: NDArray[np.intp]) -> Floats:
        """The task's observation of onsets around these rows (...): times, then velocities.

        Of its entries, those `kept` (..., len(kept)).
        """
        seen, size = self._onsets_seen, len(self._onsets_seen) * self._num_keys
        at, places = self._onsets.at((rows[..., None] + seen).ravel())
        values = observed_onsets(
            self._onsets.time[places], self._onsets.velocity[places], self._control_timestep
        )
        column = np.full(2 * size, -1)
        column[kept] = np.arange(len(kept))
        result = np.zeros((rows.size, len(kept)), np.float32)
        entry = (at % len(seen)) * self._num_keys + self._onsets.key[places]
        for part, first in zip(values, (0, size), strict=True):
            to = column[first + entry]
            result[at[to >= 0] // len(seen), to[to >= 0]] = part[to >= 0]
        return result.reshape(*rows.shape, len(kept))

    def _unpacked(self, rows: NDArray[np.integer]) -> NDArray[np.uint8]:
        return np.unpackbits(self._rows[rows], axis=-1, count=self._num_bits)

    def goals_used(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Keys and pedal (K + 1,) and fingers (F,) that at least one row asks for."""
        ever = np.unpackbits(np.bitwise_or.reduce(self._rows), count=self._num_bits).astype(bool)
        return ever[: self._num_goals], ever[self._num_goals :]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The table as arrays, for `restore`."""
        first = np.array(sorted(self._first.values()), np.int64)
        arrays: dict[str, NDArray[Any]] = {"rows": self._rows, "first": first}
        if self._shows_onsets:
            arrays |= {f"onset_{name}": part for name, part in self._onsets._asdict().items()}
        return arrays

    @property
    def num_rows(self) -> int:
        """The number of rows in which an observation may begin."""
        return len(self._rows) - self._silent_rows

    def restore(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Restore the table of `arrays`; raises a CadenzaError if they are something else."""
        expected = {
            "rows": ArrayOf("u", ("rows", self._rows.shape[1]), needed=True),
            "first": ArrayOf(INTEGERS, ("scores",), needed=True),
        }
        if self._shows_onsets:
            keys, velocities = (0, self._num_keys - 1), VELOCITIES
            expected |= {
                "onset_step": ArrayOf(INTEGERS, ("onsets",), needed=True),
                "onset_key": ArrayOf(INTEGERS, ("onsets",), needed=True, within=keys),
                "onset_time": ArrayOf(FLOATS, ("onsets",), needed=True, finite=True),
                "onset_velocity": ArrayOf(INTEGERS, ("onsets",), needed=True, within=velocities),
            }
        check_arrays(arrays, expected, "scores")
        self._rows = arrays["rows"]
        if self._shows_onsets:
            self._onsets = Onsets(**{name: arrays[f"onset_{name}"] for name in Onsets._fields})
        ends = [*arrays["first"].tolist(), len(self._rows)]
        self._first = {
            _bytes_of(self._rows[first:last], self._onsets.between(first, last)): first
            for first, last in pairwise(ends)
        }


def _bytes_of(bits: NDArray[np.uint8], onsets: Onsets) -> bytes:
    return b"".join(part.tobytes() for part in (bits, *onsets))


def pruned(
    spec: ObservationSpec, active_keys: NDArray[np.bool_], active_fingers: NDArray[np.bool_]
) -> Inputs:
    """Inputs without goals of inactive keys and fingers, see `GoalTable.goals_used`.

    These are always zero, so that their weights would neither matter nor change. A network without
    them begins with the same other weights.
    """
    layout = spec.layout
    goal, fingers = np.arange(spec.goal), np.arange(spec.fingering)
    onsets = np.arange(spec.goal_onset + spec.goal_velocity)
    kept = (
        goal[active_keys[goal % spec.goals_of_a_step]],
        layout["fingering"].start + fingers[active_fingers[fingers]],
        layout["goal_onset"].start + onsets[active_keys[onsets % spec.key_state]],
        np.arange(layout["key_state"].start, spec.size),
    )
    return Inputs(tuple(np.concatenate(kept).tolist()), spec.size)


class Observer:
    """Compose observations of a policy.

    An observation is that of the task, then, as published, the previous action in actuator units
    and its reward, and with a reference its next action. In the first step, previous action and
    reward are 0, where the published wrapper shows the least action. With ranges, joints and the
    previous action are on their scale.

    Attributes:
        inputs: The entries that an observation has.
    """

    def __init__(
        self,
        task: TaskSpec,
        goals: GoalTable,
        inputs: Inputs | None = None,
        reference: Floats | None = None,
        ranges: Ranges | None = None,
    ) -> None:
        """Observe nothing yet.

        All `inputs` are there by default. The only score has a `reference` (T, A) of actions in
        [-1, 1], and `ranges` of joints and actions are normalised to that.
        """
        spec = ObservationSpec.of(task, residual=reference is not None)
        self.inputs = inputs or spec.inputs
        self._goals, self._reference = goals, reference
        self._centre = ((task.action_high + task.action_low) / 2).astype(np.float32)
        self._scale = ((task.action_high - task.action_low) / 2).astype(np.float32)
        self._ranges, self._joints = ranges, task.observation_layout.get("joints", slice(0, 0))
        if ranges is not None:
            self._centre, self._scale = np.zeros_like(self._centre), np.ones_like(self._scale)
        ends = [spec.layout[name].start for name in ("fingering", "goal_onset", "key_state")]
        kept = np.array(self.inputs.kept)
        parts = np.split(kept, np.searchsorted(kept, ends))
        self._goal, self._fingers, self._onsets, others = parts
        self._fingers, self._onsets = self._fingers - ends[0], self._onsets - ends[1]
        shown = ends[-1]
        self._others = None if len(others) == spec.size - shown else others - shown
        self._proprioception = slice(shown, task.observation_size)

    def proprioception(self, shown: Floats) -> Floats:
        """The entries (N, S) of the task's observation `shown` (N, D) that no score implies."""
        if self._ranges is not None:
            shown = shown.copy()
            shown[:, self._joints] = self._ranges.scaled(shown[:, self._joints])
        return shown[:, self._proprioception]

    @property
    def proprioception_size(self) -> int:
        """The number S of entries that no score implies."""
        return self._proprioception.stop - self._proprioception.start

    def observation(
        self,
        rows: NDArray[np.integer],
        proprioception: Floats,
        previous_action: Floats,
        previous_reward: Floats,
        first: NDArray[np.bool_],
    ) -> Floats:
        """Observations (..., D).

        Args:
            rows: (...) of the scores; the steps that come next.
            proprioception: (..., S)
            previous_action: (..., A) in [-1, 1].
            previous_reward: (...)
            first: (...) whether there is no previous action; it and its reward are then 0.
        """
        action = previous_action * self._scale + self._centre
        before = np.concatenate([action, previous_reward[..., None]], axis=-1)
        parts = [proprioception, np.where(first[..., None], np.float32(0), before)]
        if self._reference is not None:
            parts.append(self._reference[np.minimum(rows, len(self._reference) - 1)])
        if self._others is not None:
            parts = [np.concatenate(parts, axis=-1)[..., self._others]]
        goals = [self._goals.goals(rows, self._goal), self._goals.fingers(rows, self._fingers)]
        if len(self._onsets):
            goals.append(self._goals.onsets(rows, self._onsets))
        return np.concatenate([*goals, *parts], axis=-1)
