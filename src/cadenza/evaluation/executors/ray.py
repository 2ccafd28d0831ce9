"""Carries out runs on a Ray cluster, whose machines have to share the folder."""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path
from typing import Any

from cadenza.errors import by_others, extra_packages
from cadenza.evaluation.bench import CarryOut, Ended
from cadenza.evaluation.jobs import BenchJob


class RayExecutor:
    """Carries out as many runs at once as the cluster has cores for, also when it grows."""

    def __init__(
        self, num_threads: int, num_jobs: int | None, address: str | None, carry_out: CarryOut
    ) -> None:
        """Join the cluster at `address`, or start one on this machine.

        Args:
            num_threads: The number of threads of a run, for each of which Ray reserves a core.
            num_jobs: The number of runs at once, None for as many as there are cores for.
            address: The address that `ray.init` takes, such as "auto" or "ray.example.org:6379", or
                None.
            carry_out: The function that carries out a job.

        Raises:
            CadenzaError: Ray is not installed, or there is no such cluster.
        """
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        with extra_packages("ray", "--executor ray"):
            import ray
        cores = num_jobs * num_threads if num_jobs and address is None else None
        with by_others(f"Ray cluster {address or 'on this machine'}"):
            ray.init(
                address or "local",
                num_cpus=cores,
                include_dashboard=False,
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
        self._ray = ray
        self._num_threads, self._num_jobs = num_threads, num_jobs
        self._running: dict[Any, BenchJob] = {}
        # A process a run, as on one machine: it leaves no memory behind.
        # One that dies is for the bench to take up again, as on one machine.
        self._carry_out = carry_out
        self._begin = ray.remote(num_cpus=num_threads, max_calls=1, max_retries=0)(_work)

    @property
    def capacity(self) -> int:
        cores = int(self._ray.cluster_resources().get("CPU", 0))
        return self._num_jobs or max(cores // self._num_threads, 1)

    def start(self, job: BenchJob, folder: Path) -> None:
        there = folder.resolve(), self._num_threads, os.getcwd()
        place = self._begin.remote(self._carry_out, job, *there)
        self._running[place] = job

    def ended(self, seconds: float) -> list[Ended]:
        places = list(self._running)
        ready, _ = self._ray.wait(places, num_returns=len(places), timeout=seconds)
        return [Ended(self._running.pop(place), self._crash(place)) for place in ready]

    def _crash(self, place: Any) -> str:
        try:
            self._ray.get(place)
        except self._ray.exceptions.RayError as error:
            message = str(error).strip().splitlines()[0]
            return f"its process crashed on the cluster ({type(error).__name__}: {message})"
        return ""

    def stop(self) -> None:
        for place in self._running:
            self._ray.cancel(place, force=True)
        self._running.clear()

    def close(self) -> None:
        """Leave the cluster; one that was started here ends."""
        self._ray.shutdown()


def _work(
    carry_out: CarryOut, job: BenchJob, folder: Path, num_threads: int, started_in: str
) -> None:
    if os.path.isdir(started_in):  # names of files are as they were given
        os.chdir(started_in)
    if started_in not in sys.path:
        sys.path.append(started_in)  # `module:Name` of an agent or a hand may lie there
    carry_out(job, folder, num_threads, lambda: False)
