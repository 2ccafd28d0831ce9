"""Plays actions that were recorded or planned before."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Agent, Array, check_planned_for
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.practice.plan_variants import Variant
from cadenza.agents.planner.practice.practised_planner import PractisedPlan
from cadenza.episode import Episode
from cadenza.errors import CadenzaError
from cadenza.files import (
    FLAGS,
    FLOATS,
    INTEGERS,
    NUMBERS,
    TEXT,
    ArrayOf,
    checked,
    parsed_json,
    read_arrays,
    write_atomically,
)
from cadenza.fingers import Fingers
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.score import Score
from cadenza.scene.config import Physics, SceneConfig, check_modules
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.view import View

T = TypeVar("T")

_CHANGE_NOTHING = {  # options that move no key and no hand
    "n_steps_lookahead",
    "n_seconds_lookahead",
    "fingering",
    "fingering_margin",
    "key_press",
    "energy_coefficient",
    "sustain_term",
    "forearm_term",
    "touch",
}
_DISTURB = {"randomization"}  # what plans are tried against
_TAKEN_FROM_PLAN = {"physics", "sleeping_keys"}
_ACTION = {"action": ArrayOf(NUMBERS, ("steps", "actions"), needed=True, finite=True)}
_ABOUT = {
    "physics": ArrayOf(TEXT),
    "sleeping_keys": ArrayOf(FLAGS),
    "options": ArrayOf(TEXT),
}
_PRACTISED = {
    "gain": ArrayOf(FLOATS, ("steps", "servos", 2), finite=True),
    "expected": ArrayOf(FLOATS, ("states", "servos", 2), finite=True),
    "later": ArrayOf(INTEGERS, ("steps", "hands"), within=(0, np.inf)),
    "fingering": ArrayOf(FLOATS, ("notes", 3), finite=True),
}
_MOST = 2**31  # bytes: practice of an hour at 200 steps a second, of both whole hands, takes 60 %


class Playback(Agent):
    """Plays `plan` (T, A), actions in actuator units, the pedal last, wherever the hands are."""

    def __init__(self, plan: Array) -> None:
        self._plan = plan

    def act(self, view: View) -> Array:
        """Raises:
        CadenzaError: the plan is not as wide as the actions or not as long as an episode.
        """
        steps, width = self._plan.shape
        check_planned_for(view, steps, width)
        return self._plan[np.minimum(view.steps, steps - 1)]


def physics_of(path: Path) -> dict[str, Any]:
    """The fields of `SceneConfig` that say in which physics a plan was made.

    A plan is played in the physics it was made in, since a micrometre can decide whether a finger
    catches on a key. Recordings of the published system do not say; there, keys never sleep.
    """
    arrays = read_arrays(path, _ABOUT, _MOST)
    physics = str(arrays.get("physics", "published"))
    return {
        "physics": checked(physics, cast(Any, Physics), f"{path}, physics"),
        "sleeping_keys": bool(arrays.get("sleeping_keys", False)),
    }


def options_of(task: TaskConfig, scene: SceneConfig, seed: int, **of_song: Any) -> dict[str, Any]:
    """What has to be the same for a plan to play the same, by name, as JSON has it.

    `of_song` says what of the song is played.
    """
    options = {n: v for n, v in asdict(task).items() if n not in _CHANGE_NOTHING | _DISTURB}
    drawn = any(value for name, value in options.items() if name.startswith("random_"))
    options |= {n: v for n, v in asdict(scene).items() if n not in _TAKEN_FROM_PLAN}
    options |= of_song | ({"seed": seed} if drawn else {})
    return dict(json.loads(json.dumps(options)))


def check_options(path: Path, options: Mapping[str, Any]) -> None:
    """Compares `options` with those that a plan was made with, where it says.

    Raises:
        CadenzaError: they differ.
    """
    text = str(read_arrays(path, _ABOUT, _MOST).get("options", "{}"))
    made_with = parsed_json(text, dict[str, Any], f"{path}, options")
    for name, value in made_with.items():
        if name in _CHANGE_NOTHING:
            continue
        if name not in options:
            raise CadenzaError(
                f"{path}: was planned with an option {name!a}, which this version of Cadenza does "
                "not have; plan it again"
            )
        if options[name] != value:
            raise CadenzaError(
                f"{path}: was planned with {name} {value!r}, but here it is {options[name]!r}; "
                "use the same value"
            )


def save_plan(
    path: Path,
    episode: Episode,
    metrics: Mapping[str, Any],
    options: Mapping[str, Any],
    fingered: Score,
    hands: Fingers,
    practised: PractisedPlan | None = None,
) -> None:
    """Writes what `load_plan` and its like and `check_options` read, and what there is to know.

    action (T, A), physics, sleeping_keys, song, dt as in an episode; metrics and options as JSON;
    fingering (N, 3), of each note of the song start [s], MIDI pitch and finger, -1 for none, by the
    numbers that fingers of these `hands` have in the episode's arrays. Of a practised plan also
    gain and expected, see `Tracking`, later, see `Variant`, and the song and its score as JSON.
    """
    notes = [(note.start, note.pitch, hands.number(note.finger)) for note in fingered.notes]
    more: dict[str, Any] = {}
    if practised is not None:
        (_, gain, expected), song = practised.tracking, asdict(WrittenScore.of(fingered))
        more = {"gain": gain, "expected": expected, "later": practised.variant.later}
        more["score"] = np.str_(json.dumps(song))
    with write_atomically(path) as file:
        np.savez_compressed(
            file,
            **more,
            allow_pickle=False,
            action=episode["action"],
            physics=episode["physics"],
            sleeping_keys=episode["sleeping_keys"],
            song=np.str_(episode.song),
            dt=np.float64(episode.dt),
            metrics=np.str_(json.dumps(metrics)),
            options=np.str_(json.dumps(options)),
            fingering=np.array(notes, np.float64),
        )


def practised_in(path: Path) -> PractisedPlan | None:
    """How a song was practised, where the file holds it.

    Raises:
        CadenzaError: it is damaged.
    """
    arrays = read_arrays(path, _ACTION | _PRACTISED, _MOST)
    if not _PRACTISED.keys() <= arrays.keys():
        return None
    ctrl, expected = arrays["action"][:, :-1].astype(np.float64), arrays["expected"]
    if expected.shape[:2] != (len(ctrl) + 1, ctrl.shape[1]):
        raise CadenzaError(f"{path}: does not fit together; it is damaged, use another copy")
    fingers = arrays["fingering"][:, 2].astype(np.int64)
    tracking = Tracking(ctrl, arrays["gain"], expected)
    return PractisedPlan(tracking, Variant(fingers, arrays["later"]))


class PractisedSong(NamedTuple):
    """A song and how it is to be set up, as a practised plan has them."""

    score: Score
    task: TaskConfig
    scene: SceneConfig
    arrangement: Arrangement


def practised_song(path: Path) -> PractisedSong:
    """The song that a practised plan plays.

    Raises:
        CadenzaError: the file is no such plan.
    """
    arrays = read_arrays(path, {"score": ArrayOf(TEXT, needed=True)} | _ABOUT, _MOST)
    score = parsed_json(str(arrays["score"]), WrittenScore, f"{path}, score").score
    options = parsed_json(str(arrays.get("options", "{}")), dict[str, Any], f"{path}, options")

    def part(kind: type[T], more: Mapping[str, Any]) -> T:
        named = {each.name for each in fields(cast(Any, kind))}
        given = {name: value for name, value in options.items() if name in named}
        return checked(given | dict(more), kind, f"{path}, options")

    scene = part(SceneConfig, physics_of(path))
    check_modules(scene, path)
    return PractisedSong(score, part(TaskConfig, {}), scene, part(Arrangement, {}))


def load_plan(path: Path) -> NDArray[np.float64]:
    """The array `action` (T, A) of a plan or of a recorded episode.

    Raises:
        CadenzaError: the file is not there or holds no such array.
    """
    return read_arrays(path, _ACTION, _MOST)["action"].astype(np.float64)
