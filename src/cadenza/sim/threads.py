"""A pool of threads that share the work on a batch."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

from cadenza.configs import whole_number

_T = TypeVar("_T")

MAX_THREADS = 1024


def available_cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def default_threads() -> int:
    """The number of threads of an agent by default: one for each hand, if there are cores."""
    return min(2, available_cores())


def cpu_seconds() -> float:
    """The CPU time of this process, and of its children that have ended [s]."""
    return sum(os.times()[:4])


class Threads:
    """A pool that starts when it is first used; a copy or a forked child starts its own."""

    def __init__(self, num_threads: int) -> None:
        """Prepare a pool of threads; raises CadenzaError if their number is not positive."""
        self._num_threads = whole_number(num_threads, "num_threads", 1, MAX_THREADS)
        self._pool: ThreadPoolExecutor | None = None
        self._pool_of = os.getpid()

    def for_each(self, ids: Sequence[int], work: Callable[[int], None]) -> None:
        """Call `work` with each of `ids` and wait for all calls.

        An exception of a call is raised when no other call is running.
        """
        workers = min(self._num_threads, len(ids))
        if workers <= 1:
            for i in ids:
                work(i)
            return
        pool = self._running_pool()
        queue = iter(list(ids))  # shared: each thread takes the next id

        def work_on_queue() -> None:
            for i in queue:
                work(i)

        futures = [pool.submit(work_on_queue) for _ in range(workers)]
        wait(futures)  # or some would go on to write while the caller handles an error
        for future in futures:
            future.result()

    def ahead(self, items: Iterator[_T]) -> Iterator[_T]:
        """Yield items up to None; idle threads make each while its predecessor is used.

        The caller makes the first one.
        """
        if self._num_threads == 1:
            yield from items
            return
        item = next(items, None)
        while item is not None:
            following = self._running_pool().submit(next, items, None)
            yield item
            item = following.result()

    def _running_pool(self) -> ThreadPoolExecutor:
        if self._pool is None or self._pool_of != os.getpid():
            self._pool, self._pool_of = ThreadPoolExecutor(self._num_threads), os.getpid()
        return self._pool

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None and self._pool_of == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __reduce__(self) -> tuple[type[Threads], tuple[int]]:
        return Threads, (self._num_threads,)
