"""The runs of a bench: songs x agents x seeds.

A run is a pure value, whose hash names the folder of its results.
"""

from __future__ import annotations

import hashlib
import json
import os.path
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, astuple, dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, Literal

from cadenza.configs import files_named
from cadenza.errors import CadenzaWarning, in_a_line
from cadenza.files import MAX_JSON, folder_name, plain, sha256_of
from cadenza.learning.config import TrainingConfig
from cadenza.music.arrangement import Arrangement
from cadenza.music.formats.fingering_file import SUFFIX
from cadenza.music.libraries.songs import Library, Song
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

_MAX_NAME = 80  # bytes of a song or an agent in the name of a folder
_HASH = 12  # hexadecimal digits

Pages = Literal["first-seed", "all", "none"]


@dataclass(frozen=True)
class JobSpec:
    """All inputs on which the result of a run depends, except versions of programs."""

    song: str  # the song as `cadenza play` takes it
    song_digest: str  # a hash of the song, see `song_digest`
    # A name that `cadenza play` takes, or train:PRESET(-residual): a policy is trained first
    agent: str
    seed: int
    task: TaskConfig
    scene: SceneConfig
    arrangement: Arrangement = field(default_factory=Arrangement)
    # The agent's options, a dataclass; a `TrainingConfig` for one that is trained first
    config: Any = None
    agent_digest: str = ""  # a hash of the files of a policy, or of files that options name

    @property
    def training(self) -> TrainingConfig | None:
        """The options of training before it plays; None for agents that are not trained."""
        return self.config if isinstance(self.config, TrainingConfig) else None

    def as_json(self) -> dict[str, Any]:
        """The job as JSON."""
        return plain(asdict(self))

    @cached_property
    def key(self) -> str:
        """A hash, the same on every machine."""
        return key_of(self.as_json())

    @property
    def name(self) -> str:
        """The name of its folder: SONG--AGENT--sSEED--HASH."""
        song, agent = (
            folder_name("-".join(path.split("/")[-2:]))
            .encode()[-_MAX_NAME:]
            .decode(errors="ignore")
            for path in (self.song, self.agent)
        )
        return f"{song}--{agent}--s{self.seed}--{self.key}"


@dataclass(frozen=True)
class SongFacts:
    """Facts about a song on which a result does not depend."""

    name: str
    title: str = ""
    composer: str = ""
    library: str = ""
    split: str = ""
    difficulty: float | None = None  # 1 to 10
    seconds: float | None = None  # length of the whole song
    notes: int | None = None  # number of notes to be played


@dataclass(frozen=True)
class BenchJob:
    """A run to be carried out."""

    command: ClassVar[str] = "cadenza bench"  # the command that begins and resumes it
    spec: JobSpec
    song: SongFacts
    page: bool = True  # whether to write a page to watch and hear


@dataclass(frozen=True)
class Contender:
    """An agent of a bench, with all options that it plays with."""

    agent: str
    task: TaskConfig
    scene: SceneConfig
    config: Any = None  # see `JobSpec.config`; the seed of training is that of the run
    agent_digest: str = ""

    def with_seed(self, seed: int) -> Contender:
        if not isinstance(self.config, TrainingConfig):
            return self
        return replace(self, config=replace(self.config, seed=seed))


def bench_jobs(
    library: Library,
    contenders: Callable[[str], Iterable[Contender]],
    seeds: Sequence[int],
    arrangement: Arrangement,
    pages: Pages = "first-seed",
) -> list[BenchJob]:
    """All runs, each once: those of the first seed come first.

    `contenders` returns the agents that play a song of this name; `pages` tells which runs write a
    page.
    """
    songs = songs_of(library)
    by_song = {song.name: list(contenders(song.name)) for song, _ in songs}
    jobs = dict[str, BenchJob]()
    for seed, (song, digest) in product(seeds, songs):
        for contender in by_song[song.name]:
            spec = JobSpec(
                song=song.name,
                song_digest=digest,
                seed=seed,
                arrangement=arrangement,
                **vars(contender.with_seed(seed)),
            )
            page = pages == "all" or (pages == "first-seed" and seed == seeds[0])
            jobs.setdefault(spec.key, BenchJob(spec, song, page))
    return list(jobs.values())


def key_of(content: Any) -> str:
    """The hash of a JSON value, such as `JobSpec.as_json`."""
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_HASH]


def digest_of_files(*configs: Any, others: Sequence[Path] = ()) -> str:
    """A hash of the files that these options name, and of others; empty without any.

    Raises CadenzaError if a file is missing, or cannot be read.
    """
    paths = [*(Path(path) for config in configs for path in files_named(config)), *others]
    return sha256_of(*paths)[:_HASH] if paths else ""


def songs_of(library: Library) -> list[tuple[SongFacts, str]]:
    """The facts and the hash of each song.

    A song that cannot be read is left out, with a warning.
    """
    songs = list[tuple[SongFacts, str]]()
    for song in library.songs:
        try:
            songs.append((_facts(song, library), song_digest(song)))
        except Exception as error:  # of any kind: the other songs are played
            warnings.warn(in_a_line(error, song.name), CadenzaWarning, stacklevel=2)
    return songs


def _facts(song: Song, library: Library) -> SongFacts:
    names = ("name", "title", "composer", "split", "difficulty", "seconds", "notes")
    values = {name: getattr(song, name) for name in names}
    return SongFacts(**values, library=library.name.partition(":")[0])


def song_digest(song: Song) -> str:
    """A hash of the song's files, which is fast, or of its notes if it has no file.

    Raises CadenzaError if a file cannot be read, or a song without one cannot be made.
    """
    files = [part for part in getattr(song.read, "args", ()) if isinstance(part, Path)]
    if files:
        fingers = [path for file in files if os.path.isfile(path := file.with_suffix(SUFFIX))]
        return sha256_of(*files, *fingers, max_bytes=MAX_JSON)[:_HASH]  # no song takes more
    score = song.load()
    notes = [  # `astuple` of the score takes as long as writing an etude
        (note.start, note.end, note.pitch, note.velocity, note.finger and astuple(note.finger))
        for note in score.notes
    ]
    pedal = [(event.time, event.value) for event in score.pedal]
    return key_of([notes, pedal])
