"""Fits what fingers cost in `cadenza.fingering` to what is lost in playing.

    python tools/fit_fingering.py play repertoire:train -o plays.jsonl
    python tools/fit_fingering.py fit plays.jsonl

`play` has the planner play the opening of songs of libraries (see `cadenza libraries`) or folders,
without sampling, and writes a line for each: its notes, their fingers, and how many control steps
of each were planned but did not sound, as F1 counts them. Run again, it goes on where it was
stopped.
`fit` explains, for every time that a hand strikes keys, what was lost of them by how it struck
them, with weights of zero or more. Sampling mends most of what is lost without it: the weights
are printed as they are, and as `LEFT` of them, which is what the search takes, rounded.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from fit_difficulty import HANDS, opening, rows_of
from numpy.typing import NDArray
from scipy.optimize import nnls

from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.score_planner import ScorePlanner
from cadenza.agents.planning.song_plan import SongPlan
from cadenza.agents.rollout import play_episode
from cadenza.fingers import Finger
from cadenza.music.libraries.library import open_library
from cadenza.music.score import TOGETHER, Note
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

LEFT = 0.3
"""Of what is lost without sampling, the share that is lost with it."""
SOON = 0.3  # [s] as in `cadenza.fingering.changes`
MOST = 6.0  # control steps lost that count of one stroke: a long note that fails is one failure
REACH = HANDS.reach


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    playing = commands.add_parser("play", help="have the planner play")
    playing.add_argument("libraries", nargs="+", help="as LIBRARY or LIBRARY:SPLIT")
    playing.add_argument("--output", "-o", type=Path, required=True)
    playing.add_argument("--most", type=int, help="songs of each library, drawn; all by default")
    playing.add_argument("--seconds", type=float, default=12.0, help="that are played of each song")
    fitting = commands.add_parser("fit", help="fit the weights")
    fitting.add_argument("plays", type=Path)
    options = parser.parse_args()
    if options.command == "play":
        play(options.libraries, options.output, options.most, options.seconds)
    else:
        fit(options.plays)


def play(libraries: list[str], output: Path, most: int | None, seconds: float) -> None:
    done = {row["song"] for row in rows_of(output)} if output.exists() else set()
    for library in libraries:
        songs = open_library(library).songs
        for i in np.random.default_rng(0).permutation(len(songs))[:most]:
            name = songs[i].name
            if name in done:
                continue
            task = PianoTask([opening(songs[i].load(), seconds)], TaskConfig())
            planner = ScorePlanner(ScorePlannerConfig(method="none"))
            episode = play_episode(task, planner, 0).episode
            played = np.asarray(episode["key_activation"], bool)
            notes = list(losses(planner.planners[0].plan, played))
            task.close()
            with output.open("a") as file:
                print(json.dumps({"song": name, "notes": notes}), file=file)


def losses(plan: SongPlan, played: NDArray[np.bool_]) -> Iterator[list[Any]]:
    """Start, end, pitch, hand and finger of each note played, and how much of it is missing."""
    keys = plan.goals.keys
    planned = np.zeros_like(keys)
    for press in plan.nominal.presses:
        planned[press.first - 1 : press.last - 1, press.key] = True
    worth = 1 / np.maximum(2 * keys.sum(axis=1) - 1, 1)
    missing = (planned & ~played) * worth[:, None]
    track = plan.track
    dt = track.config.control_timestep
    for note in track.score.notes:
        if note.finger is not None:
            first = track.first_step(note)
            last = first + max(1, round((note.end - note.start) / dt))
            lost = missing[first:last, note.pitch - HANDS.keyboard.lowest_pitch].sum()
            yield [*note_fields(note), round(min(float(lost), MOST), 4)]


def note_fields(note: Note) -> tuple[float, float, int, int, int]:
    assert note.finger is not None
    return note.start, note.end, note.pitch, note.finger.hand, note.finger.index


def fit(path: Path) -> None:
    strokes = [stroke for row in rows_of(path) for stroke in strokes_of(row["notes"])]
    names = sorted(strokes[0][0])
    features = np.array([[what[name] for name in names] for what, _ in strokes])
    lost = np.array([lost for _, lost in strokes])
    weights, _ = nnls(features, lost)
    print(f"{len(lost)} strokes, {lost.mean():.3f} control steps lost of each")
    for name, weight in zip(names, weights, strict=True):
        print(f"{name:20} {weight:6.3f}  left {LEFT * weight:6.3f}")


def strokes_of(rows: list[list[Any]]) -> Iterator[tuple[dict[str, float], float]]:
    """How each hand strikes keys, each time that it does, and what is lost of them."""
    notes = [(Note(a, b, p, finger=Finger(h, f)), lost) for a, b, p, h, f, lost in rows]
    for hand in range(2):
        mine = [(note, lost) for note, lost in notes if note.finger and note.finger.hand == hand]
        before: list[Note] = []
        while mine:
            start = mine[0][0].start
            count = sum(note.start <= start + TOGETHER for note, _ in mine)
            struck, mine = mine[:count], mine[count:]
            now = [note for note, _ in struck]
            held = [note for note in before if note.end > start + TOGETHER]
            yield features_of(now, held, before, hand), sum(lost for _, lost in struck)
            before = now + held


def features_of(
    now: list[Note], held: list[Note], before: list[Note], hand: int
) -> dict[str, float]:
    """What the search knows of a hand that strikes notes `now` and played those `before`."""
    key_y = HANDS.key_y(hand)

    def y(note: Note) -> float:
        return float(key_y[note.pitch - HANDS.keyboard.lowest_pitch])

    def index(note: Note) -> int:
        assert note.finger is not None
        return note.finger.index

    def place(notes: list[Note]) -> float:
        return float(np.mean([y(note) - REACH.rest[index(note)] for note in notes]))

    what = {"stroke": 1.0, "notes beyond the first": len(now) - 1.0, "stretch": 0.0}
    for a, b in combinations(sorted(now + held, key=index), 2):
        ease = REACH.rest[index(b)] - REACH.rest[index(a)]
        beyond = y(b) - y(a) - ease
        limit = REACH.most if beyond > 0 else REACH.least
        room = max(abs(limit[index(a), index(b)] - ease), 1e-3)
        what["stretch"] += (beyond / room) ** 2
    for finger in range(REACH.num_fingers):
        mine = [note for note in now if index(note) == finger]
        black = [n for n in mine if HANDS.keyboard.is_black[n.pitch - HANDS.keyboard.lowest_pitch]]
        what |= {f"finger {finger}": len(mine), f"finger {finger} on black": len(black)}
    what |= {"way": abs(place(now) - place(before)) if before else 0.0}
    what |= {"same finger": 0.0, "crossing": 0.0, "other finger": 0.0}
    for note in now:
        for was in before:
            soon = 1 - min(max(note.start - was.end, 0.0) / SOON, 1.0)
            if was.pitch == note.pitch:
                what["other finger"] += index(was) != index(note)
            elif was not in held:
                outwards = (y(note) - y(was)) * (index(note) - index(was))
                what["same finger"] += soon * (index(note) == index(was))
                what["crossing"] += soon * (outwards < 0)
    return what


if __name__ == "__main__":
    main()
