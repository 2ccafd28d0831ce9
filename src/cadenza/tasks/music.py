"""The music of the episodes: which score, changed how, as goals per control step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.fingering.players import Players, seated
from cadenza.fingering.search import find_fingering
from cadenza.fingers import NUM_FINGERS, UNKNOWN_FINGER
from cadenza.keyboards.keyboard import Keyboard
from cadenza.music.goals import Goals, check_pitches, check_steps, score_to_goals
from cadenza.music.score import NUM_KEYS, Score, check_length
from cadenza.scene.scene import Scene
from cadenza.tasks.config import TaskConfig

_OCTAVE = 12
_MOST = {  # of options that are 0 or more
    "control_timestep": 60,
    "n_steps_lookahead": 100_000,
    "n_seconds_lookahead": 3600,
    "initial_buffer_time": 3600,
    "energy_coefficient": 1000,
    "random_hand_position": 1,
    "random_stretch": 0.99,
    "random_pitch_shift": NUM_KEYS,
    "random_octave_shift": NUM_KEYS // _OCTAVE,
    "randomization_probability": 1,
}


def players_of(scene: Scene) -> Players:
    """The hands of a scene at its keyboard."""
    slides = len(scene.slide_joints) > 0
    spacing = scene.config.hand_spacing
    return seated(scene.hand.reach, scene.keyboard, scene.sides, spacing, slides)


def prepare(
    scores: Sequence[Score],
    config: TaskConfig,
    scene: Scene,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Score, ...]:
    """The scores as the task will draw from them, for the hands of a `scene`.

    `progress` is that of `find_fingering`.

    Raises:
        CadenzaError: there is no score, or one without notes, or an option makes no sense.
    """
    if not scores:
        raise CadenzaError("no song to play: give at least one score")
    if empty := [score.title for score in scores if not score.notes]:
        raise CadenzaError(f"nothing to play: {empty[0] or 'the score'} has no notes")
    _check(config)
    scores = [_arranged(score, config) for score in scores]
    _check_longest(max(score.total_time for score in scores), config)
    for score in scores:
        check_pitches(score, scene.keyboard.pitches)
    if config.fingering == "auto" and scene.sides:
        players = players_of(scene)
        scores = [find_fingering(score, players, progress)[0] for score in scores]
    return tuple(scores)


def _arranged(score: Score, config: TaskConfig) -> Score:
    if config.trim_silence:
        score = score.with_silence_trimmed()
    if config.stretch != 1:
        score = score.stretched(config.stretch)
    return score.transposed(config.transpose) if config.transpose else score


def _check(config: TaskConfig) -> None:
    if not config.control_timestep > 0:
        raise CadenzaError(f"control_timestep {config.control_timestep}: choose more than 0")
    for name, most in _MOST.items():
        value = getattr(config, name)
        if value is not None and not 0 <= value <= most:
            raise CadenzaError(f"{name} {value}: choose 0 to {most}")


def _check_longest(seconds: float, config: TaskConfig) -> None:
    """That the longest episode, of a song of so many `seconds`, is one that memory has room for."""
    seconds = seconds * (1 + config.random_stretch) + config.initial_buffer_time
    check_length(seconds, "with its silence and any random stretch, the song")
    check_steps(seconds / config.control_timestep)


def find_song(scores: Sequence[Score], song: Any) -> int:
    """The index of the score that `song` names, by index or title.

    Raises:
        CadenzaError: that is none of them, or several.
    """
    if isinstance(song, str):
        found = [i for i, score in enumerate(scores) if score.title == song]
    else:
        is_number = isinstance(song, int | np.integer) and not isinstance(song, bool)
        found = [int(song)] if is_number and 0 <= song < len(scores) else []
    if len(found) > 1:
        raise CadenzaError(f"song {song!r}: {len(found)} have this title; give an index: {found}")
    if not found:
        titles = ", ".join(repr(score.title) for score in scores)
        raise CadenzaError(
            f"song {song!r:.100}: choose an index from 0 to {len(scores) - 1}, or a title: "
            f"{titles:.300}"
        )
    return found[0]


def draw(
    scores: Sequence[Score],
    config: TaskConfig,
    pitches: range,
    rng: np.random.Generator,
    song: int | None = None,
) -> Score:
    """The score of one episode, on keys of these `pitches`.

    Draws from `rng` only what song and configuration leave open.
    """
    if song is None:
        song = int(rng.integers(len(scores))) if len(scores) > 1 else 0
    score = scores[song]
    if config.random_stretch and _happens(config, rng):
        score = score.stretched(1.0 + rng.uniform(-config.random_stretch, config.random_stretch))
    if config.random_pitch_shift and _happens(config, rng):
        score = _shifted(score, config.random_pitch_shift, 1, pitches, rng)
    if config.random_octave_shift and _happens(config, rng):
        score = _shifted(score, config.random_octave_shift, _OCTAVE, pitches, rng)
    return score


def _happens(config: TaskConfig, rng: np.random.Generator) -> bool:
    return rng.uniform() < config.randomization_probability


def _shifted(
    score: Score, most: int, semitones: int, pitches: range, rng: np.random.Generator
) -> Score:
    """Moved by up to `most` steps of `semitones`, as far as the keyboard allows."""
    used = [note.pitch for note in score.notes]
    down = min(most, (min(used) - pitches[0]) // semitones)
    up = min(most, (pitches[-1] - max(used)) // semitones)
    return score.transposed(semitones * int(rng.integers(-down, up + 1)))


def goals_of(
    score: Score,
    config: TaskConfig,
    keyboard: Keyboard,
    there: NDArray[np.intp] | None = None,
) -> Goals:
    """Goals per control step on a `keyboard`, after the silent steps of the initial buffer.

    Fingers that are not among those `there` count as none; by default all are there.
    """
    shorten = config.repeats == "shortened"
    goals = score_to_goals(score, config.control_timestep, shorten, keyboard.pitches)
    if there is not None:
        fingers = np.where(np.isin(goals.fingers, there), goals.fingers, np.int8(UNKNOWN_FINGER))
        goals = replace(goals, fingers=fingers)
    silent = _silent_steps(config)
    if not silent:
        return goals
    return Goals(
        keys=np.pad(goals.keys, ((silent, 0), (0, 0))),
        fingers=np.pad(goals.fingers, ((silent, 0), (0, 0)), constant_values=-1),
        sustain=np.pad(goals.sustain, (silent, 0)),
    )


def on_the_clock(score: Score, config: TaskConfig) -> Score:
    """`score` as late as the episode has it, after the initial buffer."""
    silence = _silent_steps(config) * config.control_timestep
    return score.with_initial_silence(silence) if silence else score


def _silent_steps(config: TaskConfig) -> int:
    return round(config.initial_buffer_time / config.control_timestep)


class Sheets:
    """What N environments have to play, step by step, and how far they have got.

    Attributes:
        songs: the score of each environment.
        num_steps: (N,) control steps of its episode.
        steps_done: (N,) control steps since its reset.
        row: (N,) the step that comes next; after the last, as in the published system, the last.
    """

    def __init__(self, num_envs: int, lookahead: int, scene: Scene) -> None:
        """Args:
        num_envs: N.
        lookahead: rows after the next that are observed.
        scene: whose keys are played, by fingers that are there.
        """
        self.songs: list[Score] = [Score(())] * num_envs
        self.num_steps = np.ones(num_envs, np.intp)
        self.steps_done = np.zeros(num_envs, np.intp)
        self.row = np.zeros(num_envs, np.intp)
        self._env_ids = np.arange(num_envs)
        self._ahead = lookahead + 1
        self._rows_ahead = np.arange(self._ahead)
        self._keyboard, self._there = scene.keyboard, scene.fingers
        keys = scene.keyboard.num_keys
        # Rows past an episode's end are silent; `_ahead` more of them keep the lookahead inside.
        self._goal = np.zeros((num_envs, self._ahead, keys + 1), bool)
        self._fingers = np.full((num_envs, self._ahead, keys), UNKNOWN_FINGER, np.int8)
        self._wanted = np.zeros((num_envs, self._ahead, NUM_FINGERS), bool)

    def put(self, env: int, score: Score, config: TaskConfig) -> None:
        """Gives environment `env` a score to play from the beginning."""
        goals = goals_of(score, config, self._keyboard, self._there)
        length = goals.num_steps
        self._make_room(length + self._ahead)
        self.songs[env], self.num_steps[env] = score, length
        self.steps_done[env] = self.row[env] = 0
        self._goal[env], self._fingers[env], self._wanted[env] = False, UNKNOWN_FINGER, False
        self._goal[env, :length, :-1] = goals.keys
        self._goal[env, :length, -1] = goals.sustain
        self._fingers[env, :length] = goals.fingers
        step, key = (goals.fingers >= 0).nonzero()
        self._wanted[env, step, goals.fingers[step, key]] = True

    def _make_room(self, length: int) -> None:
        grow = length - self._goal.shape[1]
        if grow > 0:
            pad = ((0, 0), (0, grow), (0, 0))
            self._goal = np.pad(self._goal, pad)
            self._fingers = np.pad(self._fingers, pad, constant_values=UNKNOWN_FINGER)
            self._wanted = np.pad(self._wanted, pad)

    def advance(self, env_ids: NDArray[np.intp] | slice) -> None:
        """These environments have taken a step."""
        self.steps_done[env_ids] += 1
        self.row = np.minimum(self.steps_done, self.num_steps - 1)

    @property
    def goal(self) -> NDArray[np.bool_]:
        """(N, K + 1) keys and pedal of the next step."""
        return self._goal[self._env_ids, self.row]

    @property
    def fingers(self) -> NDArray[np.int8]:
        """(N, K) the fingers for the keys of the next step, -1 for none."""
        return self._fingers[self._env_ids, self.row]

    @property
    def fingers_wanted(self) -> NDArray[np.bool_]:
        """(N, 10) which fingers have a key to press in the next step."""
        return self._wanted[self._env_ids, self.row]

    @property
    def lookahead(self) -> NDArray[np.bool_]:
        """(N, (lookahead + 1) * (K + 1)) the next step's goal and those of the steps after it."""
        rows = self.row[:, None] + self._rows_ahead
        return self._goal[self._env_ids[:, None], rows].reshape(len(rows), -1)

    def part(self, env: int, first: int, last: int) -> tuple[NDArray[np.bool_], NDArray[np.int8]]:
        """Goals (last - first, K + 1) and fingers (last - first, K) of steps of one environment.

        Past the end nothing is to be played.
        """
        rows = np.arange(first, last)
        inside = rows < self.num_steps[env]
        rows = np.minimum(rows, self.num_steps[env] - 1)
        goal = self._goal[env, rows] & inside[:, None]
        return goal, np.where(inside[:, None], self._fingers[env, rows], np.int8(UNKNOWN_FINGER))
