"""The tracks of a task's songs, and their augmentation: random tempo and pitch of each episode."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cadenza.configs import check_ranges
from cadenza.errors import CadenzaError, quoted, shortened
from cadenza.music.goals import check_pitches, check_steps
from cadenza.music.score import NUM_KEYS, Score, check_length
from cadenza.scene.scene import Scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack

_OCTAVE = 12  # [semitones]
_MAX_OPTIONS = {  # maxima of options whose minimum is 0
    "control_timestep": 60,
    "n_steps_lookahead": 100_000,
    "n_seconds_lookahead": 3600,
    "initial_buffer_time": 3600,
    "fingering_margin": 1,
    "energy_coefficient": 1000,
    "onset_timing_coefficient": 1000,
    "loudness_coefficient": 1000,
    "random_hand_position": 1,
    "random_stretch": 0.99,
    "random_pitch_shift": NUM_KEYS,
    "random_octave_shift": NUM_KEYS // _OCTAVE,
    "randomization_probability": 1,
}


def prepare_tracks(
    songs: Sequence[Score | GoalTrack], config: TaskConfig, scene: Scene
) -> tuple[GoalTrack, ...]:
    """The tracks of songs, see `prepare_track`; songs that are tracks already stay as they are.

    Raises CadenzaError if there is no song, or one that cannot be prepared.
    """
    if not songs:
        raise CadenzaError("no song to play: give at least one score")
    return tuple(
        prepare_track(song, config, scene) if isinstance(song, Score) else song for song in songs
    )


def prepare_track(
    score: Score,
    config: TaskConfig,
    scene: Scene,
    progress: Callable[[int, int], None] | None = None,
) -> GoalTrack:
    """Trim, stretch and transpose a score, and finger it for the hands of a `scene`.

    `progress` is called as by `find_fingering`. Raises CadenzaError if the score has no notes, or
    an option makes no sense.
    """
    _check_notes(score)
    _check_options(config)
    score = _arranged(score, config)
    _check_duration(score.total_time, config)
    check_pitches(score, scene.keyboard.pitches)
    track = GoalTrack(score, None, config, scene)
    return track.fingered(progress) if _observes_fingers(config, scene) else track


def unchanged_track(score: Score, config: TaskConfig, scene: Scene) -> GoalTrack:
    """The track of a score in its own tempo, key and fingering.

    Fingers are found if it has none at all and the task observes them. Raises CadenzaError if it
    has no notes, lasts too long, or has notes beyond the keyboard.
    """
    _check_notes(score)
    _check_duration(score.total_time, replace(config, random_stretch=0.0))
    check_pitches(score, scene.keyboard.pitches)
    track = GoalTrack(score, None, config, scene)
    if not _observes_fingers(config, scene):
        return track
    return replace(track, dropped=()) if score.has_fingering else track.fingered()


def _observes_fingers(config: TaskConfig, scene: Scene) -> bool:
    return config.fingering not in ("transport", "off") and len(scene.sides) > 0


def _check_notes(score: Score) -> None:
    if not score.notes:
        raise CadenzaError(f"nothing to play: {score.title or 'the score'} has no notes")


def _arranged(score: Score, config: TaskConfig) -> Score:
    if config.trim_silence:
        score = score.with_silence_trimmed()
    if config.stretch != 1:
        score = score.stretched(config.stretch)
    return score.transposed(config.transpose) if config.transpose else score


def _check_options(config: TaskConfig) -> None:
    for name in ("control_timestep", "fingering_margin"):
        if not (value := getattr(config, name)) > 0:
            raise CadenzaError(f"{name} {value}: choose more than 0")
    given = {n: (0, most) for n, most in _MAX_OPTIONS.items() if getattr(config, n) is not None}
    check_ranges(config, given)


def _check_duration(seconds: float, config: TaskConfig) -> None:
    """Check that memory has room for the longest episode of a song of `seconds` [s]."""
    seconds = seconds * (1 + config.random_stretch) + config.initial_buffer_time
    song = "with its silence and any random stretch, the song"
    check_length(seconds, song, "; shorten the silence, or play its beginning (--first-seconds)")
    check_steps(seconds / config.control_timestep)


def find_song(scores: Sequence[Score], song: Any) -> int:
    """The index of a score that is given by index or title.

    Raises CadenzaError if there is no such score, or several have the title.
    """
    if isinstance(song, str):
        indices = [i for i, score in enumerate(scores) if score.title == song]
    else:
        is_number = isinstance(song, int | np.integer) and not isinstance(song, bool)
        indices = [int(song)] if is_number and 0 <= song < len(scores) else []
    if len(indices) > 1:
        raise CadenzaError(
            f"song {quoted(song)}: {len(indices)} have this title; give an index: {indices}"
        )
    if not indices:
        titles = ", ".join(repr(score.title) for score in scores)
        raise CadenzaError(
            f"song {quoted(song)}: choose an index from 0 to {len(scores) - 1}, or a title: "
            f"{shortened(titles)}"
        )
    return indices[0]


def draws_pitch(config: TaskConfig) -> bool:
    """Whether `draw_track` may transpose: episodes may need other keys and fingers than songs."""
    return bool(config.random_pitch_shift or config.random_octave_shift)


def draws_variation(config: TaskConfig) -> bool:
    """Whether `draw_track` may change the pitch or the tempo of a song."""
    return draws_pitch(config) or bool(config.random_stretch)


def draw_track(
    tracks: Sequence[GoalTrack], rng: np.random.Generator, song: int | None = None
) -> GoalTrack:
    """Draw a song, its tempo and its transposition for an episode, as its task says.

    `rng` draws only what `song`, an index, and the configuration leave open. Fingers that were
    found for the song are found anew if it is transposed: other keys are black then.
    """
    if song is None:
        song = int(rng.integers(len(tracks))) if len(tracks) > 1 else 0
    track, score = tracks[song], tracks[song].score
    config, pitches = track.config, track.scene.keyboard.pitches
    if config.random_stretch and _is_applied(config, rng):
        score = score.stretched(1.0 + rng.uniform(-config.random_stretch, config.random_stretch))
    stretched = score
    if config.random_pitch_shift and _is_applied(config, rng):
        score = _randomly_transposed(score, config.random_pitch_shift, 1, pitches, rng)
    if config.random_octave_shift and _is_applied(config, rng):
        score = _randomly_transposed(score, config.random_octave_shift, _OCTAVE, pitches, rng)
    if score is track.score:
        return track
    if not track.searched:
        return track.with_score(score)
    if score is stretched:
        return replace(track, score=score)
    return track.with_score(score.without_fingers()).fingered()


def _is_applied(config: TaskConfig, rng: np.random.Generator) -> bool:
    return rng.uniform() < config.randomization_probability


def _randomly_transposed(
    score: Score, max_steps: int, semitones: int, pitches: range, rng: np.random.Generator
) -> Score:
    """Transpose by up to `max_steps` steps of `semitones` either way, within the keyboard."""
    used = [note.pitch for note in score.notes]
    down = min(max_steps, (min(used) - pitches[0]) // semitones)
    up = min(max_steps, (pitches[-1] - max(used)) // semitones)
    return score.transposed(semitones * int(rng.integers(-down, up + 1)))
