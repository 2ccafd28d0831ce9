"""Whether work takes time in proportion to how much there is of it."""

import time

TIMES = 10
MOST = 2.5 * TIMES  # as long for ten times as much; it would be 100 times for what is squared
FIXED = 0.005  # [s] for anything, so that little is no less
TRIALS = 3  # of which one must do, as other work on the machine takes time, too


def grows_in_proportion(work, few):
    """Whether `work` of ten times as much takes about ten times the time of the processor."""

    def cpu_time(n):
        do = work(n)
        begin = time.process_time()
        do()
        return time.process_time() - begin + FIXED

    return any(cpu_time(few * TIMES) < MOST * cpu_time(few) for _ in range(TRIALS))
