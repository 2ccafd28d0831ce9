"""An entry: the actions of an agent that played a set, and the claims of its entrant.

ENTRY/entry.json                        what this module reads and writes
ENTRY/actions/SONG--sSEED.safetensors   the actions of a run, an array `action` (T, A)
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cadenza.errors import CadenzaError, errors_in, quoted, shortened
from cadenza.evaluation.benchmark.definition import (
    BENCHMARK,
    DEPLOYMENT,
    METRICS,
    ROBOTS,
    TRACKS,
    open_set,
    own_track,
)
from cadenza.files import TENSORS, content_of, folder_name, parsed_json
from cadenza.music.libraries.songs import Song

ENTRY, ACTIONS = "entry.json", "actions"
Metrics = dict[str, float | None]
_MAX_BYTES = 2**24  # bytes of entry.json: a thousand songs with twenty seeds take 10 MB
_MAX_SEEDS = 20  # to bound the time of verification
_MAX_TEXT = 300  # characters, as many as a cell of the table shows
_MAX_SECONDS = 1e12  # more than any run takes, with finite sums


@dataclass(frozen=True)
class EnteredRun:
    """The run of a song with a seed."""

    song: str
    seed: int
    song_digest: str  # see `song_digest` of the benchmark's definition
    metrics: Metrics  # all of `METRICS`
    # CPU time of planning, playing and simulating; not known of training
    cpu_seconds: float | None = None


@dataclass(frozen=True)
class BenchmarkEntry:
    """Content of entry.json. Its claims on the agent cannot be verified."""

    benchmark: Literal[1]  # the version of the benchmark
    name: str  # the name of the row
    by: str  # who entered it
    about: str  # what the agent has learnt from, for how long, and where its code is
    agent: str  # the name of the agent in `cadenza bench`
    options: dict[str, Any]  # its options
    track: str
    songs: str  # the set
    fingering: Literal["given", "none"]  # whether it could see the fingers that scores give
    versions: dict[str, str]  # the versions of the packages with which it was recorded
    runs: tuple[EnteredRun, ...]

    @property
    def seeds(self) -> list[int]:
        return sorted({run.seed for run in self.runs})


def read_entry(folder: Path) -> BenchmarkEntry:
    """Read the file of an entry, and check its claims.

    Raises CadenzaError if the file is missing, too large or invalid.
    """
    path = folder / ENTRY
    entry = parsed_json(content_of(path, _MAX_BYTES), BenchmarkEntry, path)
    with errors_in(path):
        check_claims(entry)
    return entry


def check_claims(entry: BenchmarkEntry) -> None:
    """Check the claims of an entry that can be checked before it is played.

    Raises CadenzaError if one is impossible.
    """
    texts = {name: getattr(entry, name) for name in ("name", "by", "about", "agent", "songs")}
    for what, text in (texts | entry.versions).items():
        if not text.strip() or len(text) > _MAX_TEXT or not text.isprintable():
            raise CadenzaError(f"{shortened(what)}: give 1 to {_MAX_TEXT} characters on one line")
    track, songs, seeds = entry.track, entry.songs, entry.seeds
    if track not in TRACKS:
        raise CadenzaError(f"track {quoted(track)}: choose from {', '.join(TRACKS)}")
    if (track_of_agent := own_track(entry.agent, entry.options)) not in (None, track):
        raise CadenzaError(
            f"track {track}: {shortened(entry.agent)} belongs to the track {track_of_agent}"
        )
    if track == "at-sight" and songs in (f"{BENCHMARK}:etudes-train", f"{BENCHMARK}:band-train"):
        raise CadenzaError(f"track at-sight: {songs} is there to learn from; choose another set")
    if (track == DEPLOYMENT) != (songs == DEPLOYMENT):
        raise CadenzaError(f"track {track}: {DEPLOYMENT} is a track and its songs; give it as both")
    if track == DEPLOYMENT and seeds != list(range(ROBOTS)):
        raise CadenzaError(f"seeds {quoted(seeds)}: they are the robots 0 to {ROBOTS - 1}")
    if seeds != list(range(len(seeds))) or not 0 < len(seeds) <= _MAX_SEEDS:
        raise CadenzaError(
            f"seeds {quoted(seeds)}: an entry has the seeds 0, 1 and so on, up to {_MAX_SEEDS} of "
            "them, and leaves none out"
        )
    for run in entry.runs:
        if run.metrics.keys() != set(METRICS):
            raise CadenzaError(f"{shortened(run.song)}: its metrics are not {', '.join(METRICS)}")
        if not 0 <= (run.cpu_seconds or 0.0) <= _MAX_SECONDS:
            raise CadenzaError(f"{shortened(run.song)}: its CPU time is not 0 to {_MAX_SECONDS:g}")


def runs_by_song(entry: BenchmarkEntry) -> list[tuple[Song, list[EnteredRun]]]:
    """Every song of the set with its runs, one for each seed.

    Raises CadenzaError if there is no such set, or a run is missing, duplicate, or of another song.
    """
    songs, seeds = open_set(entry.songs).songs, entry.seeds
    expected = {(song.name, seed) for song in songs for seed in seeds}
    counts = Counter((run.song, run.seed) for run in entry.runs)
    for song, seed in sorted(expected | counts.keys()):
        if (song, seed) not in expected:
            raise CadenzaError(f"{shortened(song)}: is no song of {entry.songs}")
        if (count := counts[song, seed]) != 1:
            fault = "is there twice" if count else "is missing"
            raise CadenzaError(f"{song}, seed {seed}: {fault}")
    runs = {(run.song, run.seed): run for run in entry.runs}
    return [(song, [runs[song.name, seed] for seed in seeds]) for song in songs]


def actions_path(folder: Path, song: str, seed: int) -> Path:
    """The path of the actions of a run."""
    return folder / ACTIONS / f"{folder_name(song.replace('/', '-'))}--s{seed}{TENSORS}"


def check_files(folder: Path, entry: BenchmarkEntry) -> None:
    """Check that the folder of an entry holds its files, and nothing else.

    Raises CadenzaError if a file is missing, superfluous or a link.
    """
    expected = {actions_path(folder, run.song, run.seed) for run in entry.runs}
    expected |= {folder / ENTRY, folder / ACTIONS}
    existing = {*folder.glob("*"), *(folder / ACTIONS).glob("*")}
    for path in sorted(expected ^ existing):
        fault = "is missing" if path in expected else "does not belong to an entry; remove it"
        raise CadenzaError(f"{path}: {fault}")
    for path in sorted(existing):
        if path.is_symlink():
            raise CadenzaError(f"{path}: is a link; an entry holds its own files")
