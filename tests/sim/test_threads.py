"""Threads that share the work on a batch."""

import os
import threading
from collections.abc import Iterator

import pytest

from cadenza.sim.threads import Threads


def test_no_call_is_under_way_once_an_error_is_raised():
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


@pytest.mark.parametrize("num_threads", [1, 2])
def test_items_made_ahead_come_in_order_and_errors_where_they_belong(num_threads):
    made_by = list[int]()

    def items() -> Iterator[int]:
        for i in range(3):
            made_by.append(threading.get_ident())
            yield i
        raise ValueError("no")

    threads, came = Threads(num_threads), list[int]()
    with pytest.raises(ValueError, match="no"):
        came.extend(threads.ahead(items()))
    assert came == [0, 1, 2]
    assert made_by[0] == threading.get_ident()
    assert (made_by[2] == threading.get_ident()) == (num_threads == 1)
    threads.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_forked_process_starts_threads_of_its_own():
    threads, done = Threads(2), set()
    threads.for_each(range(4), done.add)
    if (child := os.fork()) == 0:
        threads.for_each(range(4, 8), done.add)
        os._exit(len(done))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 8
    threads.close()
