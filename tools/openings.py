"""The openings of songs, played by the planner, and the files in which tools keep the results.

A file of results has a JSON object in each line. A tool that is run again reads it, and plays only
what is missing.
"""

from __future__ import annotations

import json
from argparse import ArgumentParser
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import play_episode
from cadenza.files import parsed_json
from cadenza.music.libraries.library import open_library
from cadenza.music.libraries.songs import Song
from cadenza.music.score import Score
from cadenza.tasks.piano_task import PianoTask


def add_options(parser: ArgumentParser, seconds: float) -> None:
    """Adds the options that say which openings are played, of so many `seconds` by default."""
    parser.add_argument("libraries", nargs="+", help="as LIBRARY or LIBRARY:SPLIT")
    parser.add_argument("--output", "-o", type=Path, required=True)
    parser.add_argument("--most", type=int, help="songs of each library, drawn; all by default")
    parser.add_argument("--seconds", type=float, default=seconds, help="played of each song")


def drawn_songs(libraries: list[str], most: int | None) -> Iterator[tuple[str, Song]]:
    """Yields the name of a library and a song: `most` of each library, in a random order."""
    for library in libraries:
        songs = open_library(library).songs
        for i in np.random.default_rng(0).permutation(len(songs))[:most]:
            yield library, songs[i]


def opening(score: Score, seconds: float) -> Score:
    """The first seconds of a score, without fingers."""
    return score.with_silence_trimmed().beginning(seconds).without_fingers()


def metrics_of(score: Score, config: PlannerConfig) -> dict[str, Any]:
    """The metrics of an episode in which the planner plays a score."""
    task = PianoTask([score])
    try:
        return play_episode(task, Planner(config), 0).metrics
    finally:
        task.close()


def rows_of(path: Path) -> list[dict[str, Any]]:
    """The results in a file.

    Raises:
        CadenzaError: a line is no JSON object.
        OSError: the file cannot be read.
    """
    lines = enumerate(path.read_text().splitlines(), start=1)
    return [parsed_json(line, dict, f"{path}, line {n}") for n, line in lines]


def add_row(path: Path, row: dict[str, Any]) -> None:
    """Adds a result to a file."""
    with path.open("a") as file:
        print(json.dumps(row), file=file)
