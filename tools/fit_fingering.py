"""Fits the costs of the search for fingers to what the planner reaches with the fingers it finds.

    python tools/fit_fingering.py repertoire:train --most 24 -o fitted.jsonl

The planner plays the opening of songs of libraries (see `cadenza libraries`) or folders at sight,
with the fingers that the costs in use choose. Then one cost after the other is halved and doubled,
as long as that is better: F1, and half of the F1 of note onsets, on average. Each song that is
played is a line of the file; run again, it goes on where it was stopped. 24 songs of 8 s take two
or three minutes of a core for each choice of costs.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.planner.practice.losses import ONSET_WEIGHT
from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.files import parsed_json
from cadenza.fingering.search import COSTS, find_fingering
from cadenza.fingering.transitions import Costs
from cadenza.music.libraries.library import open_library
from cadenza.music.score import Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import players_of
from cadenza.tasks.piano_task import PianoTask

HANDS = players_of(build_scene())
WITH_THESE_FINGERS = PlannerConfig(fingering="score")


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("libraries", nargs="+", help="as LIBRARY or LIBRARY:SPLIT")
    parser.add_argument("--output", "-o", type=Path, required=True)
    parser.add_argument("--most", type=int, help="songs of each library, drawn; all by default")
    parser.add_argument("--seconds", type=float, default=8.0, help="that are played of each song")
    options = parser.parse_args()
    songs = openings(options.libraries, options.most, options.seconds)
    if not songs:
        raise CadenzaError("no songs to play")
    played = Played(songs, options.seconds, options.output)
    print(f"\nCOSTS = {fitted(played)}")


def openings(libraries: list[str], most: int | None, seconds: float) -> dict[str, Score]:
    """Of songs that are drawn, without fingers."""
    songs = {}
    for name in libraries:
        library = open_library(name).songs
        for i in np.random.default_rng(0).permutation(len(library))[:most]:
            score = library[i].load().with_silence_trimmed().beginning(seconds)
            songs[library[i].name] = score.without_fingers()
    return songs


class Played:
    """What has been played, in a file."""

    def __init__(self, songs: dict[str, Score], seconds: float, path: Path) -> None:
        self.songs, self.path = songs, path
        self._seconds = seconds
        self._known: dict[tuple[str, Costs], float] = {}
        lines = path.read_text().splitlines() if path.exists() else ()
        for number, line in enumerate(lines, start=1):
            row = parsed_json(line, dict, f"{path}, line {number}")
            if row.get("seconds") != seconds:
                raise CadenzaError(
                    f"{path}: holds other than {seconds:g} s; choose another --output"
                )
            self._known[row["song"], Costs(**row["costs"])] = (
                row["f1"] + ONSET_WEIGHT * row["onsets"]
            )

    def worth(self, costs: Costs) -> float:
        """The mean over all songs, with fingers by these costs."""
        return float(np.mean([self._of(song, costs) for song in self.songs]))

    def _of(self, song: str, costs: Costs) -> float:
        if (song, costs) not in self._known:
            metrics = metrics_of(self.songs[song], costs)
            f1, onsets = metrics["f1"], metrics["note_onset_f1"]
            row = {"song": song, "seconds": self._seconds, "costs": asdict(costs)}
            row |= {"f1": f1, "onsets": onsets}
            with self.path.open("a") as file:
                print(json.dumps(row), file=file)
            self._known[song, costs] = f1 + ONSET_WEIGHT * onsets
        return self._known[song, costs]


def metrics_of(score: Score, costs: Costs) -> dict[str, float]:
    fingered, _ = find_fingering(score, HANDS, costs=costs)
    task = PianoTask([fingered], TaskConfig(initial_buffer_time=0.5))
    try:
        return play_episode(task, Planner(WITH_THESE_FINGERS), 0).metrics
    finally:
        task.close()


def fitted(played: Played) -> Costs:
    """The best that halving and doubling leads to."""
    best, most = COSTS, played.worth(COSTS)
    print(f"{most:.4f}  {best}", flush=True)
    better = True
    while better:
        better = False
        for name in (field.name for field in fields(Costs)):
            for factor in 0.5, 2.0:
                costs = replace(best, **{name: factor * getattr(best, name)})
                worth = played.worth(costs)
                print(f"{worth:.4f}  {costs}", flush=True)
                if worth > most:
                    best, most, better = costs, worth, True
                    break
    return best


if __name__ == "__main__":
    main()
