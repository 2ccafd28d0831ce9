"""A lock for objects that are copied, pickled, and alive when a process forks."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


class Lock:
    """Re-entrant. A copy is a lock of its own, and in a forked child it is free again."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        _LOCKS.add(self)

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[Lock], tuple[()]]:
        return Lock, ()

    def _free(self) -> None:
        self._lock = threading.RLock()


_LOCKS: weakref.WeakSet[Lock] = weakref.WeakSet()


def _free_all() -> None:
    # The thread that held one when the process forked does not exist in the child.
    for lock in _LOCKS:
        lock._free()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_free_all)


class _Locked(Protocol):
    _lock: Lock


_S = TypeVar("_S", bound=_Locked)


def one_at_a_time(
    method: Callable[Concatenate[_S, _P], _T],
) -> Callable[Concatenate[_S, _P], _T]:
    """Has threads that call this and other such methods of one object wait for each other."""

    @wraps(method)
    def locked(self: _S, *args: Any, **kwargs: Any) -> _T:
        with self._lock:
            return method(self, *args, **kwargs)

    return locked
