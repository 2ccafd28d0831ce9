"""The music of an episode: which score, changed how, as goals per control step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.music.goals import Goals, score_to_goals
from cadenza.music.score import HIGHEST_PITCH, LOWEST_PITCH, Score
from cadenza.tasks.config import TaskConfig

_OCTAVE = 12


def prepare(scores: Sequence[Score], config: TaskConfig) -> tuple[Score, ...]:
    """The scores as the task will draw from them.

    Raises:
        CadenzaError: there is no score, or one without notes, or an option makes no sense.
    """
    if not scores:
        raise CadenzaError("no song to play: give at least one score")
    if empty := [score.title for score in scores if not score.notes]:
        raise CadenzaError(f"nothing to play: {empty[0] or 'the score'} has no notes")
    if not 0 <= config.random_stretch < 1:
        raise CadenzaError(f"random_stretch {config.random_stretch}: choose 0 up to below 1")
    if config.initial_buffer_time < 0:
        raise CadenzaError(f"initial_buffer_time {config.initial_buffer_time} s: choose 0 or more")
    return tuple(s.with_silence_trimmed() if config.trim_silence else s for s in scores)


def draw(scores: Sequence[Score], config: TaskConfig, rng: np.random.Generator) -> Score:
    """The score of one episode; draws from `rng` only what the configuration leaves open."""
    score = scores[int(rng.integers(len(scores)))] if len(scores) > 1 else scores[0]
    if config.random_stretch and _happens(config, rng):
        score = score.stretched(1.0 + rng.uniform(-config.random_stretch, config.random_stretch))
    if config.random_pitch_shift and _happens(config, rng):
        score = _shifted(score, config.random_pitch_shift, 1, rng)
    if config.random_octave_shift and _happens(config, rng):
        score = _shifted(score, config.random_octave_shift, _OCTAVE, rng)
    return score


def _happens(config: TaskConfig, rng: np.random.Generator) -> bool:
    return rng.uniform() < config.randomization_probability


def _shifted(score: Score, most: int, semitones: int, rng: np.random.Generator) -> Score:
    """Moved by up to `most` steps of `semitones`, as far as the keyboard allows."""
    pitches = [note.pitch for note in score.notes]
    down = min(most, (min(pitches) - LOWEST_PITCH) // semitones)
    up = min(most, (HIGHEST_PITCH - max(pitches)) // semitones)
    return score.transposed(semitones * int(rng.integers(-down, up + 1)))


def goals_of(score: Score, config: TaskConfig) -> Goals:
    """Goals per control step, after the silent steps of the initial buffer."""
    goals = score_to_goals(score, config.control_timestep)
    silent = round(config.initial_buffer_time / config.control_timestep)
    if not silent:
        return goals
    return Goals(
        keys=np.pad(goals.keys, ((silent, 0), (0, 0))),
        fingers=np.pad(goals.fingers, ((silent, 0), (0, 0)), constant_values=-1),
        sustain=np.pad(goals.sustain, (silent, 0)),
    )
