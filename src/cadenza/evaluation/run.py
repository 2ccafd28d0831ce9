"""A run of a bench: from a job to the files of its folder.

NAME/job.json         the job
NAME/training/        the training of a policy that is trained first
NAME/episode.npz      and the other files of `cadenza play`, with report.html on request
NAME/result.json      the result; written last, so that a run with it is finished
NAME/failed.json      or the reason why there is none
NAME/log.txt          output of the process
NAME/progress.json    progress of the run
NAME/lock             held by the process

A run that is killed leaves no result. Carried out again, a performance begins anew, and training
goes on from its last checkpoint.
"""

import platform
import shutil
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

from cadenza.agents.agent import Progress
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.registry import PLANNER
from cadenza.errors import CadenzaError
from cadenza.evaluation.jobs import BenchJob, JobSpec, song_digest
from cadenza.evaluation.results import FORMAT, RESULT, ResultFile, Timing, Trained, is_finished
from cadenza.evaluation.run_status import claimed_run, progress_writer
from cadenza.files import write_json
from cadenza.learning.config import TrainingConfig
from cadenza.learning.cpu_affinity import claimed_cores
from cadenza.learning.run_folder import RunFolder
from cadenza.music.arrangement import load
from cadenza.music.libraries.library import find_song
from cadenza.performing.performance import perform
from cadenza.performing.setup import find_player, set_up
from cadenza.resumable import installed_versions
from cadenza.sim.threads import cpu_seconds

_VERSIONS = ("cadenza", "mujoco", "numpy")


def check_song(spec: JobSpec) -> None:
    """Check that the song is the planned one; raises CadenzaError if it has changed."""
    if song_digest(find_song(spec.song)) != spec.song_digest:
        raise CadenzaError(
            f"{spec.song}: has other notes here and now than when the run was planned; "
            "use the same files everywhere, and run the command again"
        )


def versions() -> dict[str, str]:
    """The versions of the programs that a result depends on."""
    python = {"python": platform.python_version(), "platform": platform.platform()}
    return python | installed_versions(_VERSIONS)


def carry_out(
    job: BenchJob, folder: Path, num_threads: int, stop: Callable[[], bool] = lambda: False
) -> None:
    """Write a result, or the reason why there is none, in `folder`, unless another process does.

    `stop` is polled during training; if true, training ends with a checkpoint.
    """
    with claimed_run(job, folder, is_finished) as ours:
        if ours and (result := _result(job, folder, num_threads, stop)) is not None:
            write_json(folder / RESULT, asdict(result))
            training = RunFolder(folder / "training")
            training.checkpoint.unlink(missing_ok=True)
            shutil.rmtree(training.replay, ignore_errors=True)  # most of the space


def _result(
    job: BenchJob, folder: Path, num_threads: int, stop: Callable[[], bool]
) -> ResultFile | None:
    """Train, if the job has a training, and play; return None if it is stopped."""
    spec, progress = job.spec, progress_writer(folder)
    progress("beginning", 0, 0)
    check_song(spec)
    wall_before, cpu_before, trained = time.perf_counter(), cpu_seconds(), None
    if spec.training is not None:
        trained = _train(spec, spec.training, folder / "training", num_threads, progress, stop)
        if trained is None:
            return None
    agent = spec.agent if trained is None else str(folder / "training" / "best")
    # Options of the planner hold for a practised plan, too.
    whose = PLANNER if isinstance(spec.config, PlannerConfig) else spec.agent
    configs = {whose: spec.config} if trained is None else {}
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
        seconds, cpu = time.perf_counter() - wall_before, cpu_seconds() - cpu_before
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
    """Train a policy, or resume its training; return None if it is stopped before the end."""
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
