"""A lock for objects that are copied, pickled, and alive when a process forks."""

from __future__ import annotations

import os
import threading
import time
import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


class Lock:
    """A re-entrant lock. A copy is a lock of its own, and in a forked child it is free again."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        _LOCKS.add(self)

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[Lock], tuple[()]]:
        return Lock, ()

    def _acquire_within(self, seconds: float) -> bool:
        return self._lock.acquire(timeout=max(seconds, 0.0))

    def _renew(self) -> None:
        self._lock = threading.RLock()


_LOCKS: weakref.WeakSet[Lock] = weakref.WeakSet()
_HELD: list[Lock] = []  # while this process forks
_FORK_TIMEOUT = 2.0  # [s] that a fork waits for whoever holds a lock


def _acquire_all() -> None:
    # A child forked in the middle of a step would hold half of one, and locks of the C library.
    latest = time.monotonic() + _FORK_TIMEOUT
    _HELD.extend(lock for lock in list(_LOCKS) if lock._acquire_within(latest - time.monotonic()))


def _release_all() -> None:
    while _HELD:
        _HELD.pop().__exit__()


def _renew_all() -> None:
    # The thread that held one when the process forked does not exist in the child.
    _HELD.clear()
    for lock in _LOCKS:
        lock._renew()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_acquire_all, after_in_parent=_release_all, after_in_child=_renew_all
    )


class _Locked(Protocol):
    _lock: Lock


_S = TypeVar("_S", bound=_Locked)


def synchronised(method: Callable[Concatenate[_S, _P], _T]) -> Callable[Concatenate[_S, _P], _T]:
    """Has threads that call this and other such methods of one object wait for each other."""

    @wraps(method)
    def locked(self: _S, *args: Any, **kwargs: Any) -> _T:
        with self._lock:
            return method(self, *args, **kwargs)

    return locked
