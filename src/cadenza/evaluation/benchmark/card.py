"""The card of an entry: who played what, in which track, with what effort, and how well.

ENTRY/card.json               what this module reads and writes
ENTRY/actions/SONG--sSEED.safetensors   the actions of a run, an array `action` (T, A)
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, errors_in, quoted, shortened
from cadenza.evaluation.benchmark.definition import BENCHMARK, METRICS, TRACKS, open_set, own_track
from cadenza.files import TENSORS, content_of, folder_name, parsed_json
from cadenza.music.libraries.songs import Song

FORMAT: Literal[1] = 1
CARD, ACTIONS = "card.json", "actions"
MOST_SEEDS = 20
_MOST_CARD = 2**24  # bytes: a thousand songs with twenty seeds take 10 MB
_MOST_NAME = 80  # characters
_MOST_TEXT = 400
_MOST_OPTIONS = 4000
_MOST_EFFORT = 1e12  # steps, seconds or hours: more than anybody has spent


@dataclass(frozen=True)
class RecordedRun:
    """A song that was played with a seed."""

    song: str
    seed: int
    song_digest: str
    """See `song_digest` of the benchmark's definition."""
    steps: int
    """Number T of control steps."""
    actions: str
    """SHA-256 of the actions (T, A), little-endian float64."""
    metrics: dict[str, float | None]
    """All of `METRICS`."""
    wall_seconds: float
    cpu_seconds: float | None = None
    """CPU time of planning, playing and simulating; not known of training."""


@dataclass(frozen=True)
class Effort:
    """What was spent before the songs were played, for all of them together; None if not said."""

    steps: int | None = None
    """Control steps of training or practice."""
    cpu_hours: float | None = None
    """Hours of a core."""
    gpu_hours: float | None = None
    """Hours of a GPU."""


@dataclass(frozen=True)
class Card:
    """Content of card.json."""

    format: Literal[1]
    benchmark: Literal[1]
    """The version of the benchmark."""
    name: str
    """The name of the row."""
    by: str
    """Who entered it, and where its code is."""
    agent: str
    """The agent as `cadenza bench` names it."""
    options: dict[str, Any]
    """Its options."""
    track: str
    songs: str
    """The set."""
    fingering: Literal["given", "none"]
    """Whether it could see the fingers that scores give."""
    seeds: tuple[int, ...]
    data: str
    """What it has learnt from."""
    hardware: str
    """The processor, and the GPU if one was used."""
    versions: dict[str, str]
    runs: tuple[RecordedRun, ...]
    effort: Effort = field(default_factory=Effort)


def read_card(entry: Path) -> Card:
    """Reads the card of an entry, which makes sense by itself.

    Raises:
        CadenzaError: it is not there, is too large, or holds something else.
    """
    path = entry / CARD
    if path.is_symlink():
        raise CadenzaError(f"{path}: is a link; an entry holds its own files")
    card = parsed_json(content_of(path, _MOST_CARD), Card, path)
    with errors_in(path):
        _check(card)
    return card


def _check(card: Card) -> None:
    """Raises a CadenzaError if a card claims what cannot be."""
    for what, text, most in (
        ("name", card.name, _MOST_NAME),
        ("by", card.by, _MOST_TEXT),
        ("agent", card.agent, _MOST_TEXT),
        ("data", card.data, _MOST_TEXT),
        ("hardware", card.hardware, _MOST_TEXT),
        ("songs", card.songs, _MOST_NAME),
        *(("song", run.song, _MOST_TEXT) for run in card.runs),
    ):
        if not text.strip() or len(text) > most or not text.isprintable():
            raise CadenzaError(f"{what}: give 1 to {most} characters on one line")
    if len(json.dumps([card.options, card.versions])) > _MOST_OPTIONS or not all(
        f"{name}{version}".isprintable() for name, version in card.versions.items()
    ):
        raise CadenzaError(f"options and versions: give up to {_MOST_OPTIONS} characters of JSON")
    check_track(card.track, card.agent, card.options, card.songs, card.effort)
    if list(card.seeds) != list(range(len(card.seeds))) or not 0 < len(card.seeds) <= MOST_SEEDS:
        raise CadenzaError(
            f"seeds {', '.join(map(str, card.seeds))[:60]}: an entry has the seeds 0, 1 and so on, "
            f"up to {MOST_SEEDS} of them, and leaves none out"
        )
    effort = card.effort
    times = [effort.steps, effort.cpu_hours, effort.gpu_hours]
    times += [seconds for run in card.runs for seconds in (run.wall_seconds, run.cpu_seconds)]
    if any(time is not None and not 0 <= time <= _MOST_EFFORT for time in times):
        raise CadenzaError(f"a time or a number of steps is negative, or over {_MOST_EFFORT:g}")
    for run in card.runs:
        if run.metrics.keys() != set(METRICS):
            raise CadenzaError(f"{shortened(run.song)}: its metrics are not {', '.join(METRICS)}")


def check_track(
    track: str, agent: str, options: dict[str, Any], songs: str, effort: Effort
) -> None:
    """Checks that an agent may enter a track with a set, as far as that can be told.

    Raises:
        CadenzaError: there is no such track, it is another one's, or it is short of effort.
    """
    if track not in TRACKS:
        raise CadenzaError(f"track {quoted(track)}: choose from {', '.join(TRACKS)}")
    if (own := own_track(agent, options)) not in (None, track):
        raise CadenzaError(f"track {track}: {shortened(agent)} belongs to the track {own}")
    if track == "one-song" and not effort.steps:
        raise CadenzaError(
            "track one-song: say how many steps of training or practice it took (--training-steps)"
        )
    if track == "at-sight" and songs in (f"{BENCHMARK}:etudes-train", f"{BENCHMARK}:band-train"):
        raise CadenzaError(f"track at-sight: {songs} is there to learn from; choose another set")


def expected_runs(card: Card) -> list[tuple[Song, list[RecordedRun]]]:
    """Every song of the set with its runs, one for each seed.

    Raises:
        CadenzaError: there is no such set, or a run is missing, is there twice, or of another song.
    """
    songs = open_set(card.songs).songs
    names, given = {song.name for song in songs}, dict[tuple[str, int], RecordedRun]()
    for run in card.runs:
        if (key := (run.song, run.seed)) in given:
            raise CadenzaError(f"{shortened(run.song)}, seed {run.seed}: is there twice")
        if run.song not in names or run.seed not in card.seeds:
            raise CadenzaError(f"{shortened(run.song)}, seed {run.seed}: is no run of this entry")
        given[key] = run
    missing = [(s.name, seed) for s in songs for seed in card.seeds if (s.name, seed) not in given]
    if missing:
        song, seed = missing[0]
        raise CadenzaError(
            f"{song}, seed {seed}: is missing, as {len(missing)} of "
            f"{len(names) * len(card.seeds)} runs of {card.songs} are"
        )
    return [(song, [given[song.name, seed] for seed in card.seeds]) for song in songs]


def actions_path(entry: Path, song: str, seed: int) -> Path:
    """The path of the actions of a run."""
    return entry / ACTIONS / f"{folder_name(song.replace('/', '-'))}--s{seed}{TENSORS}"


def check_files(entry: Path, runs: Iterable[tuple[str, int]]) -> None:
    """Checks that an entry holds a card, the actions of these runs (song, seed), and nothing else.

    Raises:
        CadenzaError: it does not, or something in it is a link.
    """
    wanted = {CARD, ACTIONS}
    actions = {actions_path(entry, *run).name for run in runs}
    for folder, names in ((entry, wanted), (entry / ACTIONS, actions)):
        left = set(names)
        if folder.is_symlink() and folder != entry:
            raise CadenzaError(f"{folder}: is a link; an entry holds its own files")
        if not folder.is_dir():
            raise CadenzaError(f"{folder}: there is no such folder")
        for path in folder.iterdir():
            if path.name not in names:
                raise CadenzaError(f"{path}: does not belong to an entry; remove it")
            if path.is_symlink():
                raise CadenzaError(f"{path}: is a link; an entry holds its own files")
            left.discard(path.name)
        if left:
            raise CadenzaError(f"{folder / min(left)}: is missing")


def actions_digest(actions: NDArray[np.float64]) -> str:
    """The hash of actions (T, A) that a card holds."""
    return hashlib.sha256(np.ascontiguousarray(actions, "<f8").tobytes()).hexdigest()
