"""Which runs there are to be: songs x agents x seeds."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

from cadenza.evaluation.job import Job, JobSpec
from cadenza.evaluation.results import FORMAT, PLANS
from cadenza.evaluation.songs import digest_of, facts_of
from cadenza.files import write_json
from cadenza.learning.config import TrainingConfig
from cadenza.music.arrangement import Arrangement
from cadenza.music.libraries.songs import Library
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

Pages = Literal["first-seed", "all", "none"]


@dataclass(frozen=True)
class Contender:
    """An agent of a bench, with all options that it plays with."""

    agent: str
    task: TaskConfig
    scene: SceneConfig
    config: Any = None
    """See `JobSpec.config`; the seed of training is that of the run."""
    digest: str = ""

    def with_seed(self, seed: int) -> Contender:
        if not isinstance(self.config, TrainingConfig):
            return self
        return replace(self, config=replace(self.config, seed=seed))


def matrix(
    library: Library,
    contenders: Callable[[str], Iterable[Contender]],
    seeds: Sequence[int],
    arrangement: Arrangement,
    pages: Pages = "first-seed",
) -> list[Job]:
    """All runs, each once: those of the first seed come first.

    Args:
        library: what is played.
        contenders: song -> who plays it.
        seeds: of everything random.
        arrangement: what of each song.
        pages: which runs leave a page.

    Raises:
        CadenzaError: a song cannot be read.
    """
    songs = [(facts_of(song, library), digest_of(song)) for song in library.songs]
    who = {song.name: list(contenders(song.name)) for song, _ in songs}
    jobs = dict[str, Job]()
    for seed, (song, digest) in product(seeds, songs):
        for contender in who[song.name]:
            own = contender.with_seed(seed)
            spec = JobSpec(
                song=song.name,
                song_digest=digest,
                agent=own.agent,
                seed=seed,
                task=own.task,
                scene=own.scene,
                arrangement=arrangement,
                config=own.config,
                agent_digest=own.digest,
            )
            page = pages == "all" or (pages == "first-seed" and seed == seeds[0])
            jobs.setdefault(spec.key, Job(spec, song, page))
    return list(jobs.values())


def write_plan(folder: Path, command: str, jobs: Iterable[Job]) -> None:
    """Keeps what was asked for, so that what is missing can be told."""
    names = [job.spec.name for job in jobs]
    key = hashlib.sha256(json.dumps(names).encode()).hexdigest()[:12]
    plan = {"format": FORMAT, "command": command, "runs": names}
    write_json(folder / PLANS / f"{key}.json", plan)
