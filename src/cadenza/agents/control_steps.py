"""Times in control steps."""

from __future__ import annotations


def steps_in(seconds: float, dt: float) -> int:
    """The number of control steps of `dt` [s] that is nearest to `seconds`, at least one."""
    return max(1, round(seconds / dt))
