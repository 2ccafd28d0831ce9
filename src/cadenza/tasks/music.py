"""The music of the episodes: which score, changed how, as goals per control step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.music.goals import check_pitches, check_steps, silence
from cadenza.music.score import NUM_KEYS, Score, check_length
from cadenza.scene.scene import Scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack

_OCTAVE = 12
_MOST = {  # of options that are 0 or more
    "control_timestep": 60,
    "n_steps_lookahead": 100_000,
    "n_seconds_lookahead": 3600,
    "initial_buffer_time": 3600,
    "fingering_margin": 1,
    "energy_coefficient": 1000,
    "random_hand_position": 1,
    "random_stretch": 0.99,
    "random_pitch_shift": NUM_KEYS,
    "random_octave_shift": NUM_KEYS // _OCTAVE,
    "randomization_probability": 1,
}


def prepare(
    scores: Sequence[Score],
    config: TaskConfig,
    scene: Scene,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[GoalTrack, ...]:
    """The scores as the task will draw from them, for the hands of a `scene`.

    `progress` is that of `find_fingering`.

    Raises:
        CadenzaError: there is no score, or one without notes, or an option makes no sense.
    """
    if not scores:
        raise CadenzaError("no song to play: give at least one score")
    for score in scores:
        _check_notes(score)
    _check(config)
    scores = [_arranged(score, config) for score in scores]
    _check_longest(max(score.total_time for score in scores), config)
    for score in scores:
        check_pitches(score, scene.keyboard.pitches)
    tracks = [GoalTrack(score, None, config, scene) for score in scores]
    if _shows_fingers(config, scene):
        tracks = [track.fingered(progress) for track in tracks]
    return tuple(tracks)


def as_written(score: Score, config: TaskConfig, scene: Scene) -> GoalTrack:
    """A score as an episode plays it to which nothing is done: in its tempo, its key, its fingers.

    Only where it gives no fingers at all are they looked for, if the task shows any.

    Raises:
        CadenzaError: it has no notes, or some that the keyboard has not, or lasts too long.
    """
    _check_notes(score)
    _check_longest(score.total_time, replace(config, random_stretch=0.0))
    check_pitches(score, scene.keyboard.pitches)
    track = GoalTrack(score, None, config, scene)
    if not _shows_fingers(config, scene):
        return track
    return replace(track, dropped=()) if score.has_fingering else track.fingered()


def _shows_fingers(config: TaskConfig, scene: Scene) -> bool:
    return config.fingering == "auto" and len(scene.sides) > 0


def _check_notes(score: Score) -> None:
    if not score.notes:
        raise CadenzaError(f"nothing to play: {score.title or 'the score'} has no notes")


def _arranged(score: Score, config: TaskConfig) -> Score:
    if config.trim_silence:
        score = score.with_silence_trimmed()
    if config.stretch != 1:
        score = score.stretched(config.stretch)
    return score.transposed(config.transpose) if config.transpose else score


def _check(config: TaskConfig) -> None:
    for name in ("control_timestep", "fingering_margin"):
        if not (value := getattr(config, name)) > 0:
            raise CadenzaError(f"{name} {value}: choose more than 0")
    for name, most in _MOST.items():
        value = getattr(config, name)
        if value is not None and not 0 <= value <= most:
            raise CadenzaError(f"{name} {value}: choose 0 to {most}")


def _check_longest(seconds: float, config: TaskConfig) -> None:
    """That the longest episode, of a song of so many `seconds`, is one that memory has room for."""
    seconds = seconds * (1 + config.random_stretch) + config.initial_buffer_time
    what = "with its silence and any random stretch, the song"
    check_length(seconds, what, "; shorten the silence, or play its beginning (--first-seconds)")
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


def transposes(config: TaskConfig) -> bool:
    """Whether `draw` may ask for other keys, and fingers, than the songs do."""
    return bool(config.random_pitch_shift or config.random_octave_shift)


def draws(config: TaskConfig) -> bool:
    """Whether `draw` changes what is played."""
    return transposes(config) or bool(config.random_stretch)


def draw(
    tracks: Sequence[GoalTrack],
    config: TaskConfig,
    pitches: range,
    rng: np.random.Generator,
    song: int | None = None,
) -> GoalTrack:
    """What is played in one episode, on keys of these `pitches`.

    Draws from `rng` only what song and configuration leave open. Fingers that were found for the
    song are found anew where it is transposed: other keys are black then.
    """
    if song is None:
        song = int(rng.integers(len(tracks))) if len(tracks) > 1 else 0
    track, score = tracks[song], tracks[song].score
    if config.random_stretch and _happens(config, rng):
        score = score.stretched(1.0 + rng.uniform(-config.random_stretch, config.random_stretch))
    in_time = score
    if config.random_pitch_shift and _happens(config, rng):
        score = _shifted(score, config.random_pitch_shift, 1, pitches, rng)
    if config.random_octave_shift and _happens(config, rng):
        score = _shifted(score, config.random_octave_shift, _OCTAVE, pitches, rng)
    if score is track.score:
        return track
    if not track.found:
        return track.of(score)
    if score is in_time:
        return replace(track, score=score)
    return track.of(score.without_fingers()).fingered()


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


class _Coming(NamedTuple):
    """What N environments are to play next."""

    goal: NDArray[np.bool_]
    """(N, lookahead + 1, K + 1) keys and pedal; past the end nothing is to be played."""
    fingers: NDArray[np.int8]
    """(N, K) of the next step."""
    fingers_wanted: NDArray[np.bool_]
    """(N, F) in the next step."""


class Sheets:
    """What N environments have to play, step by step, and how far they have got.

    Attributes:
        tracks: what each environment plays.
        num_steps: (N,) control steps of its episode.
        steps_done: (N,) control steps since its reset.
        row: (N,) the step that comes next; after the last, as in the published system, the last.
    """

    def __init__(self, num_envs: int, lookahead: int, config: TaskConfig, scene: Scene) -> None:
        """Args:
        num_envs: N.
        lookahead: rows after the next that are observed.
        config: of the task.
        scene: whose keys are played, by fingers that are there.
        """
        self.tracks = [GoalTrack(Score(()), None, config, scene)] * num_envs
        self.num_steps = np.ones(num_envs, np.intp)
        self.steps_done = np.zeros(num_envs, np.intp)
        self.row = np.zeros(num_envs, np.intp)
        self._rows_seen = lookahead + 1
        self._num_keys, self._num_fingers = scene.keyboard.num_keys, scene.fingers.count
        self._goals = [silence(1, self._num_keys, self._num_fingers)] * num_envs
        self._coming: _Coming | None = None

    def put(self, env: int, track: GoalTrack) -> None:
        """Has environment `env` play `track` from the beginning."""
        self.tracks[env], self._goals[env] = track, track.goals
        self.num_steps[env] = track.goals.num_steps
        self.steps_done[env] = self.row[env] = 0
        self._coming = None

    @property
    def songs(self) -> tuple[Score, ...]:
        """The score of each environment."""
        return tuple(track.score for track in self.tracks)

    def advance(self, env_ids: NDArray[np.intp] | slice) -> None:
        """These environments have taken a step."""
        self.steps_done[env_ids] += 1
        self.row = np.minimum(self.steps_done, self.num_steps - 1)
        self._coming = None

    @property
    def goal(self) -> NDArray[np.bool_]:
        """(N, K + 1) keys and pedal of the next step."""
        return self._look().goal[:, 0]

    @property
    def fingers(self) -> NDArray[np.int8]:
        """(N, K) the fingers for the keys of the next step, -1 for none."""
        return self._look().fingers

    @property
    def fingers_wanted(self) -> NDArray[np.bool_]:
        """(N, F) which fingers have a key to press in the next step."""
        return self._look().fingers_wanted

    @property
    def lookahead(self) -> NDArray[np.bool_]:
        """(N, (lookahead + 1) * (K + 1)) the next step's goal and those of the steps after it."""
        return self._look().goal.reshape(len(self.row), -1)

    def _look(self) -> _Coming:
        """Gathers once a step what comes."""
        if self._coming is None:
            num_envs = len(self.row)
            goal = np.zeros((num_envs, self._rows_seen, self._num_keys + 1), bool)
            fingers = np.empty((num_envs, self._num_keys), np.int8)
            wanted = np.empty((num_envs, self._num_fingers), bool)
            for env, (goals, row) in enumerate(zip(self._goals, self.row.tolist(), strict=True)):
                keys = goals.keys[row : row + self._rows_seen]
                goal[env, : len(keys), :-1] = keys
                goal[env, : len(keys), -1] = goals.sustain[row : row + self._rows_seen]
                fingers[env] = goals.fingers[row]
                wanted[env] = goals.fingers_wanted[row]
            self._coming = _Coming(goal, fingers, wanted)
        return self._coming

    def part(self, env: int, first: int, last: int) -> tuple[NDArray[np.bool_], NDArray[np.int8]]:
        """Goals (last - first, K + 1) and fingers (last - first, K) of steps of one environment.

        Past the end nothing is to be played.
        """
        steps, goals = np.arange(first, last), self._goals[env]
        keys, fingers = goals.at(steps)
        inside = steps < goals.num_steps
        sustain = goals.sustain[np.minimum(steps, goals.num_steps - 1)] & inside
        return np.column_stack([keys, sustain]), fingers
