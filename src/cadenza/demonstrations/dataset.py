"""Recorded demonstrations as batches of steps with their goals, from mapped files.

from cadenza.demonstrations.dataset import open_dataset

dataset = open_dataset("demonstrations")
batch = dataset.batch(dataset.sample(np.random.default_rng(0), 256), lookahead=10)
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.demonstrations.recorded_episode import (
    MAKE_AGAIN,
    PLAN,
    RESULT,
    SCORE,
    SONGS,
    STEPS,
    EpisodeFacts,
    RecordedEpisode,
    plan_type,
    read_facts,
    steps_type,
)
from cadenza.errors import CadenzaError
from cadenza.fingers import NO_FINGER
from cadenza.hub import Kind, fetched
from cadenza.music.goals import Goals, Onsets
from cadenza.scene.scene import Scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.view import observed_onsets, to_range

Array = NDArray[Any]
Floats = NDArray[np.float32]
Ids = NDArray[np.intp]

LOOKAHEAD = TaskConfig.n_steps_lookahead  # control steps, as the environments show them
EPISODES = "runs"  # the folder of the episodes' folders
DATASET = Kind(
    "dataset",
    "dataset",
    (*(f"{EPISODES}/*/{name}" for name in (RESULT, STEPS, PLAN, SCORE)), f"{SONGS}/*.json"),
    max_bytes=2**36,  # some 500 hours of music
)
"""Demonstrations as the hub keeps them."""
_ROUNDING = 1e-6  # float32 actions may exceed their limits by this [m, rad]


class StepBatch(NamedTuple):
    """B steps of episodes of a scene with J joints, A servos, K keys and F fingers."""

    hand_qpos: Floats  # joint positions before the step (B, J) [m, rad]
    hand_qvel: Floats  # joint velocities (B, J) [m/s, rad/s]
    fingertip_xpos: Floats  # fingertips (B, F, 3) [m]
    key_state: Floats  # depth of the keys (B, K), 0 to 1
    pedal: Floats  # depth of the pedal (B,), 0 to 1
    sounding: NDArray[np.bool_]  # true for keys that sound (B, K)
    key_onset: Floats  # when keys began to sound in the step before (B, K), as environments show it
    key_velocity: Floats  # how loud they did (B, K)
    # Action that was played in the step before (B, A + 1), in actuator units, the pedal last; 0 in
    # the first step
    previous_action: Floats
    previous_reward: Floats  # reward of the previous action (B,)
    action: Floats  # action that the demonstrator chose (B, A + 1)
    # Keys and pedal that should sound after the step and after the L next (B, L + 1, K + 1)
    goal: NDArray[np.bool_]
    # Key that each finger should press in these steps (B, L + 1, F), -1 for none
    fingers: NDArray[np.int8]
    reference: Floats  # position and speed of each servo in the plan, S steps ahead (B, S, A, 2)

    @property
    def fingering(self) -> NDArray[np.bool_]:
        """True for fingers that have a key to press (B, L + 1, F)."""
        return self.fingers != NO_FINGER


class _GoalTable(NamedTuple):
    """Goals of R rows: each episode's steps, and one after the last that asks for nothing."""

    bits: NDArray[np.uint8]  # keys and pedal (R, bytes)
    fingers: NDArray[np.int8]  # key of each finger (R, F)
    made: NDArray[np.bool_]  # episodes whose goals are there (E,)


class Dataset:
    """Episodes that were kept, all of one scene, as one long list of steps.

    Attributes:
        episodes: E episodes.
        first: number of the first step of each (E,).
        num_steps: the number of steps of all episodes together.
        scene: the hands and the keys.
        control_timestep: between two steps [s].
        shows_fingers: True if the task's observations have the fingers with a key to press.
        shows_onsets: True if they have the times and velocities of onsets of notes and keys.
        shows_velocities: True if they have the velocities of joints.
    """

    def __init__(self, episodes: Sequence[RecordedEpisode]) -> None:
        """Raise a CadenzaError if there is none, or if their tasks differ."""
        if not episodes:
            raise CadenzaError("no demonstrations: none was kept, or none was asked for")
        _allow_open_files()
        self.episodes = tuple(episodes)
        _common(episodes, "scene", [e.facts.scene for e in episodes])
        self.scene = episodes[0].build_scene()
        dt = [e.facts.task.control_timestep for e in episodes]
        self.control_timestep = _common(episodes, "control_timestep", dt)
        fingers = [e.facts.task.fingering != "off" for e in episodes]
        self.shows_fingers = _common(episodes, "fingering", fingers)
        onsets = [e.facts.task.onset_goals for e in episodes]
        self.shows_onsets = _common(episodes, "onset_goals", onsets)
        velocities = [e.facts.task.joint_velocities for e in episodes]
        self.shows_velocities = _common(episodes, "joint_velocities", velocities)
        lengths = np.array([episode.facts.num_steps for episode in episodes], np.intp)
        ends = np.cumsum(lengths)
        self._lengths, self.first, self.num_steps = lengths, ends - lengths, int(ends[-1])
        self._first_row = self.first + np.arange(len(lengths))  # each has a row more
        self._notes: dict[int, Onsets] = {}  # of episodes whose goals are there
        self._joined: Onsets | None = None  # the same, one after the other
        self._steps = [_Rows(e, STEPS, steps_type(self.scene)) for e in episodes]
        self._plans = [_Rows(e, PLAN, plan_type(self.scene)) for e in episodes]

    def sample(self, rng: np.random.Generator, count: int) -> Ids:
        """Draw numbers of steps (count,) uniformly with replacement."""
        return rng.integers(self.num_steps, size=count)

    def place(self, steps: Ids) -> tuple[Ids, Ids]:
        """The episodes of steps (B,), and which of their steps; or raises CadenzaError."""
        if steps.size and not 0 <= steps.min() <= steps.max() < self.num_steps:
            raise CadenzaError(
                f"steps {steps.min()} to {steps.max()}: choose from 0 to {self.num_steps - 1}"
            )
        episode = np.searchsorted(self.first, steps, side="right") - 1
        return episode, steps - self.first[episode]

    def batch(self, steps: Ids, lookahead: int = LOOKAHEAD, ahead: Sequence[int] = ()) -> StepBatch:
        """The examples of `steps` (B,), with goals for L steps after the next.

        There are references to the states `ahead`: 0 for the one before the step, 1 for the one
        after it, and so on; past the end of the song, its last. Raises CadenzaError if there is no
        such step, or a file is not there, or is damaged.
        """
        episode, step = self.place(steps)
        rows = _gathered(self._steps, episode, step[:, None])[:, 0]
        plan = _gathered(self._plans, episode, self._within(episode, step, ahead))
        keys = self.scene.keyboard.num_keys
        goal, fingers = self._goal(episode, step, lookahead)
        return StepBatch(
            hand_qpos=rows["hand_qpos"],
            hand_qvel=rows["hand_qvel"],
            fingertip_xpos=rows["fingertip_xpos"],
            key_state=rows["key_state"],
            pedal=rows["pedal"],
            sounding=np.unpackbits(rows["sounding"], axis=-1, count=keys).view(bool),
            key_onset=rows["key_onset"],
            key_velocity=rows["key_velocity"],
            previous_action=self._in_units(rows["played"], step),
            previous_reward=rows["previous_reward"].astype(np.float32),
            action=rows["action"],
            goal=goal,
            fingers=fingers,
            reference=plan["reference"],
        )

    def actions(self, steps: Ids, count: int) -> Floats:
        """The chosen actions (B, count, A + 1) in these `steps` (B,) and after them.

        Past the end of an episode its last action is repeated. Later actions follow from the states
        in which the episode really was.
        """
        episode, step = self.place(steps)
        within = np.minimum(step[:, None] + np.arange(count), self._lengths[episode, None] - 1)
        rows: Floats = _gathered(self._steps, episode, within)["action"]
        return rows

    def onsets(self, steps: Ids, lookahead: int = LOOKAHEAD) -> tuple[Floats, Floats]:
        """When the notes around `steps` (B,) begin, and how loud they are, (B, L + 2, K) each.

        Notes are those of the previous step, the next one and the L after it, as environments show
        them (`cadenza.tasks.view.observed_onsets`).
        """
        episode, step = self.place(steps)
        self._make_goals(episode)
        around = step[:, None] + np.arange(-1, lookahead + 1)
        inside = (around >= 0) & (around < self._lengths[episode, None])
        rows = np.where(inside, self._first_row[episode, None] + around, -1)
        notes = self._all_onsets
        row, note = notes.at(rows.ravel())
        shape = rows.size, self.scene.keyboard.num_keys
        time, velocity = np.zeros(shape), np.zeros(shape)
        time[row, notes.key[note]] = notes.time[note]
        velocity[row, notes.key[note]] = notes.velocity[note]
        time, velocity = (values.reshape(*rows.shape, -1) for values in (time, velocity))
        return observed_onsets(time, velocity, self.control_timestep)

    @property
    def _all_onsets(self) -> Onsets:
        """The onsets of all episodes whose goals are there, by their rows in the table."""
        if self._joined is None:
            parts = [
                self._notes[number].delayed(int(self._first_row[number]))
                for number in sorted(self._notes)
            ]
            self._joined = Onsets._make(map(np.concatenate, zip(*parts, strict=True)))
        return self._joined

    def goals(self, episode: int) -> Goals:
        """Keys, fingers and pedal per step of an episode, rebuilt from its score."""
        return self.episodes[episode].goals(self.scene)

    def _in_units(self, played: Floats, step: Ids) -> Floats:
        """Actions (B, A + 1) in actuator units, 0 before the first step."""
        ctrl = to_range(played, self.scene.action_low, self.scene.action_high)
        return np.where(step[:, None] > 0, ctrl, 0.0).astype(np.float32)

    def _within(self, episode: Ids, step: Ids, ahead: Sequence[int]) -> Ids:
        """Rows of the episodes (B, S)."""
        return np.minimum(step[:, None] + np.array(ahead, np.intp), self._lengths[episode, None])

    def _goal(
        self, episode: Ids, step: Ids, lookahead: int
    ) -> tuple[NDArray[np.bool_], NDArray[np.int8]]:
        table = self._table
        self._make_goals(episode)
        within = self._within(episode, step, range(lookahead + 1))
        rows = self._first_row[episode, None] + within
        count = self.scene.keyboard.num_keys + 1
        goal = np.unpackbits(table.bits[rows], axis=-1, count=count).view(bool)
        return goal, table.fingers[rows]

    @cached_property
    def _table(self) -> _GoalTable:
        rows = self.num_steps + len(self.episodes)
        keys, fingers = self.scene.keyboard.num_keys, self.scene.fingers.count
        return _GoalTable(
            bits=np.zeros((rows, -(-(keys + 1) // 8)), np.uint8),
            fingers=np.full((rows, fingers), NO_FINGER, np.int8),
            made=np.zeros(len(self.episodes), bool),
        )

    def _make_goals(self, episodes: Ids) -> None:
        """Rebuild the goals of these episodes (B,), as far as they are not there."""
        for missing in np.unique(episodes[~self._table.made[episodes]]).tolist():
            self._rebuild(missing)

    def _rebuild(self, episode: int) -> None:
        goals, first = self.goals(episode), int(self._first_row[episode])
        steps = np.column_stack([goals.keys, goals.sustain])
        self._table.bits[first : first + len(steps)] = np.packbits(steps, axis=1)
        step, key = (goals.fingers >= 0).nonzero()
        self._table.fingers[first + step, goals.fingers[step, key]] = key
        self._notes[episode], self._joined = goals.onsets, None
        self._table.made[episode] = True


class _Rows:
    """The rows of an episode's array as bytes, which are copied faster than fields."""

    def __init__(self, episode: RecordedEpisode, name: str, kind: np.dtype[np.void]) -> None:
        self._episode, self._name, self.kind = episode, name, kind

    @cached_property
    def bytes(self) -> NDArray[np.uint8]:
        """The rows (T + 1, bytes). Raises CadenzaError if the array is not as it should be."""
        episode = self._episode
        try:
            array = episode.steps if self._name == STEPS else episode.plan
        except OSError as error:
            raise CadenzaError(
                f"{episode.folder / self._name}: cannot be opened ({error.strerror}); each episode "
                "that is read keeps a file open, or two: choose fewer, or allow more (ulimit -n)"
            ) from error
        check_rows(episode, self._name, array, self.kind)
        return array.view(np.uint8).reshape(len(array), self.kind.itemsize)


def check_rows(episode: RecordedEpisode, name: str, array: Array, kind: np.dtype[np.void]) -> None:
    """Raise a CadenzaError if an array has rows of another type or number than the episode."""
    if array.dtype != kind or array.shape != (episode.facts.num_steps + 1,):
        raise CadenzaError(
            f"{episode.folder / name}: not the {episode.facts.num_steps + 1} rows of this episode; "
            f"{MAKE_AGAIN}"
        )


def check_values(episode: RecordedEpisode, scene: Scene) -> None:
    """Read all of an episode's arrays; raises CadenzaError if one is not as it was written."""
    episode.check_files((STEPS, PLAN))
    for name, array, kind in (
        (STEPS, episode.steps, steps_type(scene)),
        (PLAN, episode.plan, plan_type(scene)),
    ):
        check_rows(episode, name, array, kind)
        for field in array.dtype.names or ():
            if not np.isfinite(array[field]).all():
                raise CadenzaError(f"{episode.folder / name}: {field} is not finite; {MAKE_AGAIN}")
    chosen, played = episode.steps["action"][:-1], episode.steps["played"][1:]
    low, high = scene.action_low - _ROUNDING, scene.action_high + _ROUNDING
    for field, beyond in (
        ("action", (chosen < low) | (chosen > high)),
        ("played", np.abs(played) > 1),
    ):
        if beyond.any():
            raise CadenzaError(
                f"{episode.folder / STEPS}: {field} beyond the actions' limits; {MAKE_AGAIN}"
            )


def _gathered(rows: Sequence[_Rows], episode: Ids, within: Ids) -> Array:
    """Rows (B, S) of these episodes (B,)."""
    kind = rows[0].kind
    result = np.empty((*within.shape, kind.itemsize), np.uint8)
    if within.size:
        for i, (of, at) in enumerate(zip(episode.tolist(), within, strict=True)):
            result[i] = rows[of].bytes[at]
    return result.view(kind)[..., 0]


def _allow_open_files() -> None:
    """Allow all open files that the system does, as each episode maps two."""
    try:
        import resource  # which only Unix has
    except ImportError:
        return
    _, limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(ValueError, OSError):  # where not even that is allowed
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))


def _common(episodes: Sequence[RecordedEpisode], name: str, values: Sequence[Any]) -> Any:
    for episode, value in zip(episodes, values, strict=True):
        if value != values[0]:
            raise CadenzaError(
                f"{episode.folder}: has another {name} than {episodes[0].folder}; "
                "choose episodes that go together"
            )
    return values[0]


def dataset_folder(place: str | Path) -> Path:
    """The folder of a dataset, which is fetched if it is one of the hub: see `cadenza.hub`.

    Raises CadenzaError if there is none on the hub, or it cannot be fetched.
    """
    return fetched(place, DATASET)


def finished(folder: str | Path) -> list[tuple[Path, EpisodeFacts]]:
    """The episodes of a folder that are finished, kept or not, by name.

    Raises CadenzaError if it holds no demonstrations, or a result.json is damaged.
    """
    runs = dataset_folder(folder) / EPISODES
    if not runs.is_dir():
        raise CadenzaError(
            f"{folder}: holds no demonstrations; make some with: cadenza dataset collect"
        )
    return [(at, read_facts(at)) for at in sorted(runs.iterdir()) if (at / RESULT).exists()]


def open_dataset(
    folder: str | Path, is_chosen: Callable[[EpisodeFacts], bool] = lambda _: True
) -> Dataset:
    """Open the episodes of a folder that were kept and are chosen.

    Raises CadenzaError if there is none, they do not go together, or a result.json is damaged.
    """
    return Dataset([episode for episode in kept(folder) if is_chosen(episode.facts)])


def kept(folder: str | Path) -> list[RecordedEpisode]:
    """The episodes of a folder that were kept, by name; none of their arrays is read.

    Raises CadenzaError if it holds no demonstrations, or a result.json is damaged.
    """
    return [RecordedEpisode(path, facts) for path, facts in finished(folder) if facts.kept]
