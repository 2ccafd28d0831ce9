"""Threads that share the work on a batch."""

from __future__ import annotations

import threading

import pytest

from cadenza.sim.threads import Threads


def test_no_call_is_under_way_once_an_error_is_raised() -> None:
    raised, done = threading.Event(), set()

    def work(i: int) -> None:
        if i == 0:
            raised.set()
            raise ValueError("no")
        raised.wait()
        threading.Event().wait(0.05)  # in which the error could get to the caller
        done.add(i)

    threads = Threads(2)
    with pytest.raises(ValueError, match="no"):
        threads.for_each(range(4), work)
    assert done == {1, 2, 3}
    threads.close()
