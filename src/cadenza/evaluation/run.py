"""Carries out one run: from a job to the files of its folder.

NAME/job.json         what the run is
NAME/training/        the run of training, of a policy that is trained first
NAME/episode.npz      and the other files of `cadenza play`, report.html where a page is wanted
NAME/result.json      how well it went; written last, so that a run with it is finished
NAME/failed.json      or why there is none; and what `cadenza.evaluation.run_status` leaves

A run that is killed leaves no result. Carried out again, a performance begins anew, and training
goes on from its last checkpoint.
"""

import shutil
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

from cadenza.agents.agent import Progress
from cadenza.evaluation.jobs import BenchJob, JobSpec
from cadenza.evaluation.results import (
    FORMAT,
    RESULT,
    ResultFile,
    Timing,
    Trained,
    is_finished,
)
from cadenza.evaluation.run_status import (
    check_song,
    claimed_run,
    progress_writer,
    versions,
)
from cadenza.files import write_json
from cadenza.learning.config import TrainingConfig
from cadenza.learning.cpu_affinity import claimed_cores
from cadenza.learning.run_folder import RunFolder
from cadenza.music.arrangement import load
from cadenza.performing.performance import perform
from cadenza.performing.setup import find_player, set_up
from cadenza.sim.threads import cpu_seconds


def carry_out(
    job: BenchJob, folder: Path, num_threads: int, stop: Callable[[], bool] = lambda: False
) -> None:
    """Leave a result, or why there is none, in `folder`, unless another process works on it.

    `stop` is asked now and then whether training is to end, with a checkpoint.
    """
    with claimed_run(job, folder, is_finished) as ours:
        if ours and (result := _result(job, folder, num_threads, stop)) is not None:
            write_json(folder / RESULT, asdict(result))
            training = RunFolder(folder / "training")
            training.checkpoint.unlink(missing_ok=True)
            shutil.rmtree(training.replay, ignore_errors=True)  # most of what training wrote


def _result(
    job: BenchJob, folder: Path, num_threads: int, stop: Callable[[], bool]
) -> ResultFile | None:
    """Play, after training if asked to; return None where it is stopped."""
    spec, progress = job.spec, progress_writer(folder)
    progress("beginning", 0, 0)
    check_song(spec)
    began, cpu_before, trained = time.perf_counter(), cpu_seconds(), None
    if spec.training is not None:
        trained = _train(spec, spec.training, folder / "training", num_threads, progress, stop)
        if trained is None:
            return None
    agent = spec.agent if trained is None else str(folder / "training" / "best")
    configs = {spec.agent: spec.config} if trained is None else {}
    with set_up(
        spec.song,
        find_player(agent, spec.song, configs=configs).playing_in(spec.task, spec.scene),
        arrangement=spec.arrangement,
        seed=spec.seed,
        num_threads=num_threads,
        progress=progress,
    ) as setup:
        performance = perform(setup, progress)
    if trained is None:
        seconds, cpu = time.perf_counter() - began, cpu_seconds() - cpu_before
    else:
        seconds, cpu = trained.seconds, None
    performance.save(folder, progress=progress, page=job.page)
    return ResultFile(
        format=FORMAT,
        job=spec.as_json(),
        song=replace(job.song, notes=len(performance.score.notes)),
        metrics=performance.metrics,
        timing=Timing(seconds, performance.seconds, num_threads, cpu),
        versions=versions(),
        training=trained,
    )


def _train(
    spec: JobSpec,
    config: TrainingConfig,
    folder: Path,
    num_threads: int,
    progress: Progress,
    stop: Callable[[], bool],
) -> Trained | None:
    """Train a policy, or resume its training; return None where it is stopped before the end."""
    from cadenza.learning.problem import problem_of  # heavy
    from cadenza.learning.training import Training

    run = RunFolder(folder)
    with claimed_cores(num_threads), run.locked():
        if not run.begun:
            song = load(spec.song, spec.arrangement).written_for(config.scene.hands)
            run.begin(config, [song.score])
        config, scores = run.settings()
        with closing(Training(problem_of(config, scores), run)) as training:

            def should_continue() -> bool:
                progress("learning", training.step, config.num_steps)
                return not stop()

            training.run(should_continue)
            if training.step < config.num_steps:
                return None
        return Trained(config.num_steps, run.metrics.rows()[-1]["seconds"])
