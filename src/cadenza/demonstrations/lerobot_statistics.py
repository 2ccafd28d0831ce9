"""Statistics of the features of a LeRobot dataset, merged from those of its episodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Statistics(NamedTuple):
    """Least, greatest, mean and variance (D,) of each of D columns over a number of rows."""

    rows: int
    least: Floats
    most: Floats
    mean: Floats
    variance: Floats

    @classmethod
    def of(cls, values: NDArray[Any]) -> Statistics:
        """Returns the statistics of values (N, ...), whose entries are the columns."""
        columns = values.reshape(len(values), -1).astype(np.float64)
        least, most = columns.min(axis=0), columns.max(axis=0)
        return cls(len(columns), least, most, columns.mean(axis=0), columns.var(axis=0))

    def merged(self, other: Statistics) -> Statistics:
        """Returns the statistics of the rows of both, by the law of total variance."""
        rows = self.rows + other.rows
        share = other.rows / rows
        mean = (1 - share) * self.mean + share * other.mean
        within = (1 - share) * self.variance + share * other.variance
        between = (1 - share) * (self.mean - mean) ** 2 + share * (other.mean - mean) ** 2
        least, most = np.minimum(self.least, other.least), np.maximum(self.most, other.most)
        return Statistics(rows, least, most, mean, within + between)

    def as_json(self, shape: tuple[int, ...] = (-1,)) -> dict[str, Any]:
        """Returns the statistics as LeRobot keeps them, each of this shape."""
        arrays = {"min": self.least, "max": self.most, "mean": self.mean}
        arrays["std"] = np.sqrt(self.variance)
        return {name: a.reshape(shape).tolist() for name, a in arrays.items()} | {
            "count": [self.rows]
        }
