"""A curriculum: draws the next song to learn, from easy to hard as learning progresses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError


@dataclass(frozen=True)
class Curriculum:
    """Draws songs by their grades and by the progress of learning.

        curriculum = Curriculum([song.difficulty for song in songs])
        song = songs[curriculum.draw(rng, progress=0.3)]

    Progress 0 asks for the easiest songs, 1 for the hardest, and between them for those that are
    harder than such a share of all songs.
    """

    grades: tuple[float, ...]
    """Grades of the songs, see `cadenza.fingering.difficulty.grade`."""
    width: float = 1.0
    """Standard deviation of the grades around the one that is asked for."""
    review: float = 0.1
    """Probability of any song instead, so that none is forgotten."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "grades", tuple(self.grades))
        if not self.grades or not np.isfinite(self.grades).all():
            raise CadenzaError("a curriculum needs songs, each with a grade")
        if not self.width > 0 or not 0 <= self.review <= 1:
            raise CadenzaError(
                f"curriculum of width {self.width} with review {self.review}: choose a width above "
                "0, and review from 0 to 1"
            )

    def probabilities(self, progress: float) -> NDArray[np.float64]:
        """Returns probabilities (num_songs,) of the songs at a `progress` from 0 to 1.

        Raises:
            CadenzaError: `progress` is something else.
        """
        if not 0 <= progress <= 1:
            raise CadenzaError(f"progress {progress}: choose 0 to 1")
        grades = np.array(self.grades)
        z = (grades - np.quantile(grades, progress)) / self.width
        density = np.exp((np.min(z**2) - z**2) / 2)  # its largest is 1, so that none underflows
        return self.review / len(grades) + (1 - self.review) * density / density.sum()

    def draw(self, rng: np.random.Generator, progress: float) -> int:
        """Draws the index of a song."""
        return int(rng.choice(len(self.grades), p=self.probabilities(progress)))
