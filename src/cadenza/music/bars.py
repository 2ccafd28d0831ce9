"""Where in the music something is, as musicians say it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable

from cadenza.music.score import Score

_ROUNDING = 1e-6  # [s]


def bar_at(score: Score, time: float) -> int:
    """The number of the bar in which `time` [s] lies, or of the first; of a score with bars."""
    begun = bisect_right(score.bars, time + _ROUNDING, key=lambda bar: bar.time)
    return score.bars[max(begun - 1, 0)].number


def places(score: Score, times: Iterable[float]) -> str:
    """Where `times` [s] lie, such as "bar 12" or "bars 3, 7-9"; "4.5, 6.0 s" where bars lack."""
    times = sorted(times)
    if not score.bars:
        return f"{', '.join(f'{time:.1f}' for time in times)} s"
    numbers = list(dict.fromkeys(bar_at(score, time) for time in times))
    runs: list[list[int]] = []
    for number in numbers:
        if runs and runs[-1][-1] + 1 == number:
            runs[-1].append(number)
        else:
            runs.append([number])
    named = ", ".join("-".join(map(str, run[:: max(len(run) - 1, 1)])) for run in runs)
    return f"bar{'s'[: len(numbers) > 1]} {named}"
