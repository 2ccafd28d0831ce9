"""Carries out one run: from a job to the files of its folder.

NAME/job.json         what the run is
NAME/training/        the run of training, of a policy that is trained first
NAME/episode.npz      and the other files of `cadenza play`, report.html where a page is wanted
NAME/result.json      how well it went; written last, so that a run with it is finished
NAME/failed.json      or why there is none; and what `cadenza.evaluation.at_work` leaves

A run that is killed leaves no result. Carried out again, a performance begins anew, and training
goes on from its last checkpoint. If a page is wanted of a run that was finished without one, it is
made from these files.
"""

from __future__ import annotations

import shutil
import time
import traceback
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

from cadenza.agents.agent import Progress
from cadenza.evaluation.at_work import check_song, failures_told, taken_up, telling, versions
from cadenza.evaluation.job import Job, JobSpec
from cadenza.evaluation.results import (
    FORMAT,
    PAGE,
    RESULT,
    ResultFile,
    Timing,
    Trained,
    is_finished,
)
from cadenza.files import read_json, write_json
from cadenza.learning.config import TrainingConfig
from cadenza.learning.cores import claimed_cores
from cadenza.learning.run_folder import RunFolder
from cadenza.performing.performance import Performance, add_page, perform
from cadenza.performing.setup import select, set_up


def carry_out(
    job: Job, folder: Path, num_threads: int, stop: Callable[[], bool] = lambda: False
) -> None:
    """Leaves a result, or why there is none, in `folder`; nothing where another process is at it.

    Of a run that is finished, leaves the page if one is wanted.

    Args:
        job: what to run.
        folder: of the run.
        num_threads: that a planner or training may use.
        stop: is asked now and then whether training is to end, with a checkpoint to go on from.
    """
    with taken_up(folder, lambda: is_complete(job, folder)) as ours:
        if not ours:
            return
        if is_finished(folder):
            _add_page(job.spec, folder)
        else:
            _carry_out(job, folder, num_threads, stop)


def is_complete(job: Job, folder: Path) -> bool:
    """Whether the run is finished, and has the page that is wanted."""
    return is_finished(folder) and (not job.page or (folder / PAGE).exists())


def _carry_out(job: Job, folder: Path, num_threads: int, stop: Callable[[], bool]) -> None:
    write_json(folder / "job.json", job.spec.as_json())
    with failures_told(folder):
        result = _result(job, folder, num_threads, stop)
        if result is not None:
            write_json(folder / RESULT, asdict(result))
            _drop_checkpoints(folder / "training")


def _add_page(spec: JobSpec, folder: Path) -> None:
    """Of a run that is finished; one of which none can be made keeps its result."""
    try:
        result = read_json(folder / RESULT, ResultFile)
        write_json(folder / RESULT, asdict(replace(result, pages={"report": PAGE})))
        check_song(spec)
        selection = select(spec.song, "zero", arrangement=spec.arrangement)
        with set_up(selection, spec.task, spec.scene, spec.seed) as setup:
            goal = perform(setup, stop=lambda: True).goal  # of its first step
        add_page(folder, goal)
    except Exception:
        traceback.print_exc()


def _result(
    job: Job, folder: Path, num_threads: int, stop: Callable[[], bool]
) -> ResultFile | None:
    """Of a run that comes to its end; None where it is stopped before."""
    spec, tell = job.spec, telling(folder)
    tell("beginning", 0, 0)
    check_song(spec)
    began, cpu_before, trained = time.perf_counter(), time.process_time(), None
    if spec.training is not None:
        trained = _train(spec, spec.training, folder / "training", num_threads, tell, stop)
        if trained is None:
            return None
    performance = _play(spec, folder, num_threads, tell)
    if trained is None:
        seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - cpu_before
    else:
        seconds, cpu_seconds = trained.seconds, None
    performance.save(folder, progress=tell, page=job.page)
    return ResultFile(
        format=FORMAT,
        job=spec.as_json(),
        song=replace(job.song, notes=len(performance.score.notes)),
        metrics=performance.metrics | {"energy": performance.energy},
        timing=Timing(seconds, performance.seconds, num_threads, cpu_seconds),
        versions=versions(),
        pages={"report": PAGE if job.page else None},
        training=trained,
    )


def _play(spec: JobSpec, folder: Path, num_threads: int, tell: Progress) -> Performance:
    agent = spec.agent if spec.training is None else str(folder / "training" / "best")
    configs = {} if spec.training is not None else {spec.agent: spec.config}
    selection = select(spec.song, agent, arrangement=spec.arrangement, configs=configs)
    with set_up(selection, spec.task, spec.scene, spec.seed, tell, num_threads) as setup:
        return perform(setup, tell)


def _train(
    spec: JobSpec,
    config: TrainingConfig,
    folder: Path,
    num_threads: int,
    tell: Progress,
    stop: Callable[[], bool],
) -> Trained | None:
    """Trains a policy, or goes on with that; None where it is stopped before the end."""
    from cadenza.learning.training import Training  # heavy

    run = RunFolder(folder)
    with claimed_cores(num_threads), run.locked():
        if not run.begun:
            run.begin(config, spec.arrangement.score(spec.song))
        config, score = run.settings()
        with closing(Training(config, score, run)) as training:

            def goes_on() -> bool:
                training.rows.clear()  # they are in the folder
                tell("learning", training.step, config.num_steps)
                return not stop()

            training.run(goes_on)
            if training.step < config.num_steps:
                return None
        return Trained(config.num_steps, run.rows()[-1]["seconds"])


def _drop_checkpoints(training: Path) -> None:
    """Of a run that is finished, which needs them no more: they are most of what it wrote."""
    for name in ("checkpoints", "replay"):
        shutil.rmtree(training / name, ignore_errors=True)
