"""Playback of recorded or planned actions, and their files."""

import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from cadenza.agents.agent import Agent, Array, check_planned_for
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.practice.plan_variants import Variant
from cadenza.agents.planner.practice.practised_planner import PractisedPlan
from cadenza.episode import Episode
from cadenza.errors import CadenzaError, CadenzaWarning, quoted
from cadenza.files import (
    FLAGS,
    FLOATS,
    INTEGERS,
    NUMBERS,
    TENSORS,
    TEXT,
    ArrayOf,
    checked,
    read_arrays,
    read_tensors,
    write_tensors,
)
from cadenza.fingers import Fingers
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.view import View

T = TypeVar("T")

PHYSICS = "physics", "sleeping_keys"
"""Options of the scene that a plan determines.

A plan is played in the physics in which it was made, since a micrometre can decide whether a finger
is caught on a key.
"""
_ACTION = {"action": ArrayOf(NUMBERS, ("steps", "actions"), needed=True, finite=True)}
_RECORDING = _ACTION | {"physics": ArrayOf(TEXT), "sleeping_keys": ArrayOf(FLAGS)}
_PRACTISED = {
    "gain": ArrayOf(FLOATS, ("steps", "servos", 2), finite=True),
    "expected": ArrayOf(FLOATS, ("states", "servos", 2), finite=True),
    "later": ArrayOf(INTEGERS, ("steps", "hands"), within=(0, np.inf)),
}
PLAN = _ACTION | {"fingering": ArrayOf(FLOATS, ("notes", 3), needed=True, finite=True)}
PLAN |= _PRACTISED
"""The arrays that the file of a plan may hold."""
_MAX_BYTES = 2**31  # an hour of practice of both whole hands at 200 steps a second takes 60 %


class Playback(Agent):
    """An agent that plays `plan` (T, A), actions in actuator units, without feedback."""

    def __init__(self, plan: Array) -> None:
        self._plan = plan

    def act(self, view: View) -> Array:
        """Actions (N, A) of the plan for the steps of all environments.

        Raises CadenzaError if the plan has another width than the actions, or another length than
        the episode.
        """
        steps, width = self._plan.shape
        check_planned_for(view, steps, width)
        return self._plan[np.minimum(view.steps, steps - 1)]


@dataclass(frozen=True)
class _PlanHeader:
    song: str
    dt: float  # control step [s]
    metrics: dict[str, Any]
    # Options on which the result of the plan depends, and `PHYSICS`
    options: dict[str, Any]
    score: WrittenScore | None = None  # the song of a practised plan


@dataclass(frozen=True)
class SavedPlan:
    """A file that can be played: a plan, or the actions of a recorded episode."""

    path: Path
    actions: Array  # (T, A) the actions in actuator units, the pedal last
    # Options in the file with which the plan was made, see `task_identity`
    options: dict[str, Any] = field(default_factory=dict)
    practised: PractisedPlan | None = None
    score: Score | None = None  # the song, if it was practised

    @property
    def physics(self) -> dict[str, Any]:
        """Fields of `SceneConfig` of the physics in which the plan was made.

        Recordings of the published system have none; there, keys never sleep.
        """
        return {name: self.options[name] for name in PHYSICS if name in self.options}

    def config(self, kind: type[T]) -> T:
        """Options of a kind, such as `TaskConfig`, of the plan; raises CadenzaError if damaged."""
        names = {option.name for option in fields(cast(Any, kind))}
        options = {name: value for name, value in self.options.items() if name in names}
        return checked(options, kind, f"{self.path}, options")

    def check(self, options: Mapping[str, Any]) -> None:
        """Compare `options` with the plan's; raises CadenzaError if any but physics differ."""
        for name in self.options.keys() - set(PHYSICS):
            value = self.options[name]
            if name not in options:
                raise CadenzaError(
                    f"{self.path}: was planned with an option {quoted(name)}, which this version "
                    "of Cadenza does not have; plan it again"
                )
            if options[name] != value:
                raise CadenzaError(
                    f"{self.path}: was planned with {name} {quoted(value)}, but here it is "
                    f"{quoted(options[name])}; use the same value"
                )
        physics = self.physics.get("physics", SceneConfig.physics)
        if physics != options["physics"]:
            message = (
                f"{self.path}: made in the {physics} physics, "
                f"played in the {options['physics']} physics"
            )
            warnings.warn(message, CadenzaWarning, stacklevel=5)


def save_plan(
    path: Path,
    episode: Episode,
    metrics: Mapping[str, Any],
    options: Mapping[str, Any],
    fingered: Score,
    hands: Fingers,
    practised: PractisedPlan | None = None,
) -> None:
    """Write a plan as a .safetensors file, for `load_plan`.

    The arrays are action (T, A) as in an episode, and fingering (N, 3): start [s], MIDI pitch and
    finger of each note of the song, as numbered in the episode's arrays, -1 for none. A practised
    plan also has gain and expected, see `Tracking`, and later, the release delays of a `Variant`.
    The header has song, dt, metrics, options, and the score of a practised plan.
    """
    notes = [(note.start, note.pitch, hands.number(note.finger)) for note in fingered.notes]
    arrays = {"action": episode["action"], "fingering": np.array(notes, np.float64).reshape(-1, 3)}
    score = None
    if practised is not None:
        (_, gain, expected), variant = practised
        arrays |= {"gain": gain, "expected": expected, "later": variant.release_delays}
        score = WrittenScore.of(fingered)
    header = _PlanHeader(episode.song, episode.dt, dict(metrics), dict(options), score)
    write_tensors(path, arrays, asdict(header))


def load_plan(path: Path) -> SavedPlan:
    """Read a plan, or the array `action` (T, A) of a recorded episode, an .npz file.

    Raises CadenzaError if the file is missing, or holds something else.
    """
    if path.suffix != TENSORS:
        return _load_recording(path)
    arrays, fields_of_header = read_tensors(path, PLAN, _MAX_BYTES)
    header = checked(fields_of_header, _PlanHeader, f"{path}, header")
    actions = arrays["action"].astype(np.float64)
    is_practised = arrays.keys() >= _PRACTISED.keys()
    practised = _practised_plan(arrays, actions, path) if is_practised else None
    try:
        score = None if header.score is None else header.score.score
    except CadenzaError as error:
        raise CadenzaError(f"{path}, score: {error}; use another copy") from error
    plan = SavedPlan(path, actions, header.options, practised, score)
    for kind in TaskConfig, SceneConfig, Arrangement:
        plan.config(kind)
    return plan


def _load_recording(path: Path) -> SavedPlan:
    arrays = read_arrays(path, _RECORDING, _MAX_BYTES)
    options = {name: arrays[name].item() for name in PHYSICS if name in arrays}
    options.setdefault("sleeping_keys", False)
    plan = SavedPlan(path, arrays["action"].astype(np.float64), options)
    plan.config(SceneConfig)
    return plan


def _practised_plan(arrays: Mapping[str, Any], actions: Array, path: Path) -> PractisedPlan:
    ctrl, expected = actions[:, :-1], arrays["expected"]
    if expected.shape[:2] != (len(ctrl) + 1, ctrl.shape[1]):
        raise CadenzaError(f"{path}: does not fit together; it is damaged, use another copy")
    fingers = arrays["fingering"][:, 2].astype(np.int64)
    return PractisedPlan(
        Tracking(ctrl, arrays["gain"], expected), Variant(fingers, arrays["later"])
    )
