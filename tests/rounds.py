"""How long work goes on."""

from collections.abc import Callable


def so_often(rounds: int) -> Callable[[], bool]:
    """A function that is true so many times, as it is asked before each round of work."""
    left = iter(range(rounds))
    return lambda: next(left, None) is not None
