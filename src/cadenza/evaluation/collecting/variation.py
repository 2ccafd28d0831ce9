"""Variation among the episodes of a song. Imports nothing heavy: the command line shows it."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cadenza.music.score import MIRROR, Score
from cadenza.tasks.config import TaskConfig

_MIRRORED_SHARE = 0.5  # share of episodes that are mirrored, where they can be


@dataclass(frozen=True)
class Variation:
    """Ranges of random variables of each episode beside tempo, transposition and start."""

    noise: float = 0.4
    """Maximum noise on the actions played, where 1 is the noise of the planner's search. Its amount
    is drawn per episode. The recorded actions have none, and lead back from where the noise before
    them has led."""
    mirror: bool = False
    """Mirror half of the episodes about D4: each hand plays what the other would."""
    excerpt: float | None = None
    """Length of an excerpt [s], which begins at a random note; the whole song if not given."""
    student: str | None = None
    """Another agent or a policy, which plays half of the time, in stretches of about a second. The
    recorded actions lead from there back to the first agent's performance."""

    def draw(
        self, score: Score, pitches: range, rng: np.random.Generator
    ) -> tuple[Score, dict[str, Any]]:
        """Draw the part of a song to play, and the values `since`, `mirrored` and `noise`.

        A mirror image beyond the keys, at `pitches`, is not played.
        """
        begin, mirror, noise = rng.random(3).tolist()
        since = 0.0
        if self.excerpt is not None:
            score, since = excerpt(score, self.excerpt, begin)
        has_image = all(MIRROR - note.pitch in pitches for note in score.notes)
        mirrored = self.mirror and mirror < _MIRRORED_SHARE and has_image
        if mirrored:
            score = score.mirrored
        return score, {"since": since, "mirrored": mirrored, "noise": noise * self.noise}


def excerpt(score: Score, seconds: float, where: float) -> tuple[Score, float]:
    """An excerpt of `seconds`, and its beginning in the score [s].

    It begins at a note: `where` is 0 for the first and 1 for the last possible one.
    """
    starts, last = sorted({note.start for note in score.notes}), score.total_time - seconds
    possible = [start for start in starts if start <= last] or starts[:1]
    since = possible[int(where * len(possible))]
    notes = tuple(note for note in score.notes if note.start >= since)
    return replace(score, notes=notes).beginning(seconds).with_silence_trimmed(), since


def collecting_task() -> TaskConfig:
    """The task in which demonstrations are collected, unless another one is chosen."""
    return TaskConfig(random_hand_position=0.05)  # [m] either way, about two white keys


def as_drawn(task: TaskConfig) -> TaskConfig:
    """The task for a score that has been trimmed, stretched and transposed already."""
    return replace(
        task,
        trim_silence=False,
        stretch=1.0,
        transpose=0,
        random_hand_position=0.0,
        random_stretch=0.0,
        random_pitch_shift=0,
        random_octave_shift=0,
    )
