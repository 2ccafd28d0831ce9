"""Bounds on what a process takes, set by the process itself before it meets a file of others."""

from __future__ import annotations

from typing import NamedTuple

MOST_BYTES = 4 << 20  # of a file that is uploaded
MOST_SECONDS = 31 * 60.0  # of music
MOST_NOTES = 40_000
READING_SECONDS = 120.0  # for which a file is read, on a machine that has much else to do

_GIB = 1 << 30


class Limits(NamedTuple):
    """`memory` [bytes] of data, `cpu` [s], and `file` [bytes] that a file may grow to."""

    memory: int
    cpu: int
    file: int


READING = Limits(1 * _GIB, 20, 1 << 26)
PLAYING = Limits(6 * _GIB, 24 * 3600, 4 * _GIB)


def limit(limits: Limits) -> None:
    """Binds this process."""
    import resource  # which only Unix has

    kinds = resource.RLIMIT_DATA, resource.RLIMIT_CPU, resource.RLIMIT_FSIZE, resource.RLIMIT_CORE
    for kind, most in zip(kinds, (*limits, 0), strict=True):
        _, hard = resource.getrlimit(kind)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (most, most))
