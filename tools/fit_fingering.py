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
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
from openings import add_options, add_row, drawn_songs, metrics_of, opening, rows_of

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.practice.losses import NOTE_WEIGHT
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.fingering.search import COSTS, find_fingering
from cadenza.fingering.transitions import Costs
from cadenza.music.score import Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.goal_track import players_of

HANDS = players_of(build_scene())
WITH_THESE_FINGERS = PlannerConfig(fingering="score")


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add_options(parser, seconds=8.0)
    options = parser.parse_args()
    drawn = drawn_songs(options.libraries, options.most)
    songs = {song.name: opening(song.load(), options.seconds) for _, song in drawn}
    if not songs:
        raise CadenzaError("no songs to play")
    played = Played(songs, options.seconds, options.output)
    print(f"\nCOSTS = {fitted(played)}")


class Played:
    """The songs, and how well they were played with which costs, as a file keeps it."""

    def __init__(self, songs: dict[str, Score], seconds: float, path: Path) -> None:
        self.songs, self.path = songs, path
        self._seconds = seconds
        self._known: dict[tuple[str, Costs], float] = {}
        for row in rows_of(path) if path.exists() else ():
            if row.get("seconds") != seconds:
                raise CadenzaError(
                    f"{path}: holds other than {seconds:g} s; choose another --output"
                )
            self._known[row["song"], Costs(**row["costs"])] = (
                row["f1"] + NOTE_WEIGHT * row["onsets"]
            )

    def worth(self, costs: Costs) -> float:
        """The mean over all songs, with fingers by these costs."""
        return float(np.mean([self._of(song, costs) for song in self.songs]))

    def _of(self, song: str, costs: Costs) -> float:
        if (song, costs) not in self._known:
            fingered, _ = find_fingering(self.songs[song], HANDS, costs=costs)
            metrics = metrics_of(fingered, WITH_THESE_FINGERS)
            f1, onsets = metrics["f1"], metrics["note_onset_f1"]
            row = {"song": song, "seconds": self._seconds, "costs": asdict(costs)}
            row |= {"f1": f1, "onsets": onsets}
            add_row(self.path, row)
            self._known[song, costs] = f1 + NOTE_WEIGHT * onsets
        return self._known[song, costs]


def fitted(played: Played) -> Costs:
    """The best costs by coordinate descent, which halves or doubles one cost at a time."""
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
