"""The files of a recorded episode.

FOLDER/steps.npy      states and actions, see `steps_type`
FOLDER/plan.npy       the plan of the hands, see `plan_type`
FOLDER/score.json     the score with its fingers; goals are rebuilt from it
FOLDER/result.json    all other facts; written last
songs/DIGEST.json     two folders up: the song before anything was drawn, once for all its episodes

Both arrays have a row for each of T control steps and one for the state after the last. An episode
that was not good enough to be kept has only result.json.
"""

import hashlib
import io
import json
import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, quoted
from cadenza.files import checked, plain, read_json, sha256_of, write_atomically, write_json
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.goals import MAX_STEPS, Goals
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig, check_modules
from cadenza.scene.scene import Scene, build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.view import to_range

Array = NDArray[Any]

FORMAT: Literal[2] = 2
RESULT = "result.json"
STEPS, PLAN, SCORE, SONG = "steps.npy", "plan.npy", "score.json", "song"
SONGS = "songs"  # the folder of the songs of all episodes
_SEAL = "seal"  # the field of result.json with its own checksum
_MAX_STEPS = 2 * MAX_STEPS  # steps of a song, and of the silence before it
_MIN_TIMESTEP = 1e-4  # [s]; a shorter one is damage


def steps_type(scene: Scene) -> np.dtype[np.void]:
    """The type of a row of steps.npy.

    The scene has J joints, A servos, K keys and F fingers.

    The state before a step, and the step before:

    - `hand_qpos`, `hand_qvel` (J,) [m, rad] and [m/s, rad/s]
    - `fingertip_xpos` (F, 3) [m]
    - `key_state` (K,) how far the keys are down, from 0 to 1, as environments show it
    - `played` (A + 1,) the action of the step before, from -1 to 1, as environments take it, the
      pedal last: with the noise; 0 before the first
    - `pedal` () how far the pedal is down, from 0 to 1, as environments show it
    - `previous_reward` () of that action, 0 before the first
    - `sounding` the keys that sound, as bits
    - `key_onset`, `key_velocity` (K,) when keys began to sound in the step before, and how loud,
      from 0 to 1, as environments show it (`cadenza.tasks.view.observed_key_onsets`)
    - `touch` (F,) of scenes with touch sensors, forces on fingertips, as environments show them

    And actions, 0 in the last row:

    - `action` (A + 1,) the demonstrator's choice, without noise
    - `tracked` (A,) the action of the plan and its feedback alone
    """
    joints, servos = len(scene.hand_joint_names), len(scene.actuator_names)
    keys = scene.keyboard.num_keys
    touch = [("touch", np.float32, (len(scene.fingertip_sites),))] if scene.config.touch else []
    return np.dtype(
        [
            ("hand_qpos", np.float32, (joints,)),
            ("hand_qvel", np.float32, (joints,)),
            ("fingertip_xpos", np.float32, (scene.fingers.count, 3)),
            ("played", np.float32, (servos + 1,)),
            ("previous_reward", np.float64),
            ("pedal", np.float32),
            ("action", np.float32, (servos + 1,)),
            ("tracked", np.float32, (servos,)),
            ("key_state", np.float32, (keys,)),
            ("key_onset", np.float32, (keys,)),
            ("key_velocity", np.float32, (keys,)),
            ("sounding", np.uint8, (-(-keys // 8),)),
            *touch,
        ],
        align=True,
    )


def plan_type(scene: Scene) -> np.dtype[np.void]:
    """The type of a row of plan.npy: the planned state of the hands before a step.

    - `reference` (A, 2) position and speed of each servo [m, rad] and [m/s, rad/s]
    - `fingertips` (F, 3) [m]
    """
    servos, fingers = len(scene.actuator_names), scene.fingers.count
    return np.dtype(
        [("reference", np.float32, (servos, 2)), ("fingertips", np.float32, (fingers, 3))],
        align=True,
    )


@dataclass(frozen=True)
class EpisodeFacts:
    """Content of result.json."""

    format: Literal[2]
    job: dict[str, Any]  # the `EpisodeSpec` of the episode
    song: str
    kept: bool  # true if it was good enough; otherwise there is no other file
    # Metrics as in `cadenza.agents.rollout.EpisodeResult`
    metrics: dict[str, int | float | bool | str | None]
    drawn: dict[str, int | float | bool]  # values that were drawn for it, see `Variation.draw`
    # The task of a replay: nothing is drawn any more, and nothing done to the score
    task: TaskConfig
    scene: SceneConfig
    start: tuple[float, ...]  # joint positions (J,) of the hands at its beginning [m, rad]
    cpu_seconds: float  # CPU time of making it
    versions: dict[str, str]
    files: dict[str, str]  # name -> SHA-256 of the other files

    @property
    def num_steps(self) -> int:
        """The number T of control steps."""
        return int(self.metrics["steps"] or 0)

    @property
    def f1(self) -> float:
        return float(self.metrics["f1"] or 0.0)

    @property
    def note_onset_f1(self) -> float:
        return float(self.metrics["note_onset_f1"] or 0.0)


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode that was kept. Its arrays are mapped when they are first asked for."""

    folder: Path
    facts: EpisodeFacts

    def build_scene(self) -> Scene:
        """Build its scene; raises CadenzaError if the module of its hands is not imported."""
        check_modules(self.facts.scene, self.folder / RESULT)
        return build_scene(self.facts.scene)

    def path(self, name: str) -> Path:
        """The path of one of its files."""
        if name == SONG:
            return _path_of_song(self.folder, self.facts.files.get(name, ""))
        return self.folder / name

    @cached_property
    def steps(self) -> Array:
        """The rows (T + 1,) of `steps_type`."""
        return mapped(self.folder / STEPS)

    @cached_property
    def plan(self) -> Array:
        """The rows (T + 1,) of `plan_type`."""
        return mapped(self.folder / PLAN)

    @cached_property
    def score(self) -> Score:
        """The score of the episode, without the silence before it.

        Raises CadenzaError if the file is not there, or is not as it was written.
        """
        return self._score_in(SCORE)

    @cached_property
    def song(self) -> Score:
        """The song that this is a part or a variation of, as it was chosen to be played.

        Raises CadenzaError if the file is not there, or is not as it was written.
        """
        return self._score_in(SONG)

    def _score_in(self, name: str) -> Score:
        path = self.path(name)
        self.check_files((name,))
        try:
            return read_json(path, WrittenScore).score
        except CadenzaError as error:
            message = str(error) if str(path) in str(error) else f"{path}: {error}"
            raise CadenzaError(f"{message}; or {MAKE_AGAIN}") from error

    def check_files(self, names: Collection[str]) -> None:
        """Compare files with their checksums.

        Raises CadenzaError if one is not there, or not as it was written.
        """
        for name in names:
            path = self.path(name)
            if name not in self.facts.files:
                raise CadenzaError(f"{self.folder / RESULT}: does not name {name}; {MAKE_AGAIN}")
            if not path.is_file():
                raise CadenzaError(f"{path}: missing; {MAKE_AGAIN}")
            if sha256_of(path) != self.facts.files[name]:
                raise CadenzaError(f"{path}: damaged, its checksum is another; {MAKE_AGAIN}")

    def goals(self, scene: Scene) -> Goals:
        """Keys, fingers and pedal per control step, rebuilt from the score.

        Raises CadenzaError if the file of the score is not there, is damaged, or has other steps.
        """
        goals = GoalTrack(self.score, (), self.facts.task, scene).goals
        if goals.num_steps != self.facts.num_steps:
            raise CadenzaError(
                f"{self.folder / SCORE}: has {goals.num_steps} steps, the episode "
                f"{self.facts.num_steps}; {MAKE_AGAIN}"
            )
        return goals


def played_actions(steps: Array, scene: Scene) -> NDArray[np.float64]:
    """The played actions (T, A + 1) in rows of steps.npy, in actuator units."""
    return to_range(steps["played"][1:], scene.action_low, scene.action_high)


def mapped(path: Path) -> Array:
    """Map the array of an .npy file.

    Raises CadenzaError if the file is missing or no such file, or OSError if the system cannot open
    or map it.
    """
    if path.exists() and not path.is_file():  # such as a pipe, which would block
        raise CadenzaError(f"{path}: no regular file; {MAKE_AGAIN}")
    try:
        # As a plain array: what `numpy.memmap` adds to it takes longer than to read a row.
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    except FileNotFoundError as error:
        raise CadenzaError(f"{path}: there is no such file; {MAKE_AGAIN}") from error
    except OSError:  # the file may be sound: too many are open, or it is not ours to read
        raise
    except Exception as error:  # damage shows in many ways
        raise CadenzaError(f"{path}: not a readable .npy file; {MAKE_AGAIN}") from error


MAKE_AGAIN = "delete its folder and collect again"


def read_facts(folder: Path) -> EpisodeFacts:
    """Read the result.json of an episode; raises CadenzaError if it is not there, or damaged."""
    facts = read_json(folder / RESULT, dict[str, Any])
    sealed = facts.pop(_SEAL, None)
    checked_facts = checked(facts, EpisodeFacts, folder / RESULT)
    if sealed != _seal(folder, facts):
        raise CadenzaError(
            f"{folder / RESULT}: its checksum is another or gone, as it was changed or its folder "
            f"renamed or copied; {MAKE_AGAIN}"
        )
    if checked_facts.kept and (value := _impossible_value(checked_facts)):
        raise CadenzaError(f"{folder / RESULT}: {value} cannot be; {MAKE_AGAIN}")
    return checked_facts


def _impossible_value(facts: EpisodeFacts) -> str | None:
    """An impossible value of a field that readers rely on; None if there is none."""
    steps = facts.metrics.get("steps")
    if type(steps) is not int or not 0 < steps <= _MAX_STEPS:
        return f"steps {quoted(steps)}"
    for name in ("f1", "note_onset_f1"):
        value = facts.metrics.get(name)
        if not isinstance(value, float | int) or not 0 <= value <= 1:
            return f"{name} {quoted(value)}"
    if not isinstance(mirrored := facts.drawn.get("mirrored"), bool):
        return f"mirrored {quoted(mirrored)}"
    if not _MIN_TIMESTEP <= facts.task.control_timestep < math.inf:
        return f"control_timestep {quoted(facts.task.control_timestep)}"
    if not 0 <= facts.task.initial_buffer_time <= MAX_STEPS * facts.task.control_timestep:
        return f"initial_buffer_time {quoted(facts.task.initial_buffer_time)}"
    return None


def write(
    folder: Path, facts: EpisodeFacts, song: Score, score: Score, arrays: Mapping[str, Array]
) -> None:
    """Write an episode that is kept, whose facts do not name its files yet.

    The `score` is the played part of the `song`; `arrays` are STEPS and PLAN.
    """
    for name, array in arrays.items():
        content = io.BytesIO()
        np.save(content, array, allow_pickle=False)
        with write_atomically(folder / name) as file:
            file.write(content.getbuffer())  # NumPy itself would not say that the disk is full
    _write_score(folder / SCORE, score)
    files = {name: sha256_of(folder / name) for name in (*arrays, SCORE)}
    files[SONG] = hashlib.sha256(_bytes_of(song)).hexdigest()
    _write_score(_path_of_song(folder, files[SONG]), song)
    write_facts(folder, replace(facts, files=files))


def _write_score(path: Path, score: Score) -> None:
    with write_atomically(path) as file:
        file.write(_bytes_of(score))


def _bytes_of(score: Score) -> bytes:
    return json.dumps(written(score), allow_nan=False).encode()


def _path_of_song(folder: Path, digest: str) -> Path:
    """The path of an episode's song, which its episodes share."""
    return folder.parent.parent / SONGS / f"{digest}.json"


def written(score: Score) -> dict[str, Any]:
    """A score as JSON has it, see `WrittenScore`."""
    content: dict[str, Any] = plain(asdict(WrittenScore.of(score)))
    return content


def write_facts(folder: Path, facts: EpisodeFacts) -> None:
    """Write result.json, with which an episode is finished."""
    content = plain(asdict(facts))
    write_json(folder / RESULT, content | {_SEAL: _seal(folder, content)})


def _seal(folder: Path, facts: Mapping[str, Any]) -> str:
    """The SHA-256 of the name of the folder and the facts of result.json."""
    content = json.dumps([folder.name, facts], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()
