"""Fits `cadenza.hands.reach.JumpTimes` to how the jumps of a hand go in simulation.

    python tools/fit_jumps.py play jumps.jsonl --hand shadow
    python tools/fit_jumps.py fit jumps.jsonl

`play` has the default planner play made-up etudes with one hand: ten notes or chords at random
distances, on white keys or on black ones, with a random time between letting go of one and striking
the next. It writes a line for each of the nine jumps, and goes on where it was stopped. An etude
takes about 15 seconds of one core. `fit` prints how late the jumps land by their distance, and the
figures that say best how late each one lands, beside those that the hand has.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from openings import add_row, rows_of
from scipy.optimize import differential_evolution

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import play_episode
from cadenza.episode import Episode
from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.fingers import Finger
from cadenza.hands.hand import Hand
from cadenza.hands.reach import JumpTimes
from cadenza.hands.registry import hand_named
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

Array = NDArray[np.float64]

DT = 0.05  # [s] a control step
CHORDS, LASTS, MAX_AHEAD = 10, 9, 5  # of an etude; steps that each lasts; of them without keys
MAX_WAY = 0.35  # [m]
LOWEST = 21  # MIDI number of the first key
LATEST = 6  # steps; later is a hand that is caught, not one that is on its way
Chord = list[tuple[int, int]]  # pitches and their fingers
HAND: Hand
"""A hand whose jumps take no time, so that the planner lets go of no key early."""


class Jump(NamedTuple):
    """A jump of a hand from keys to others, and how late it landed."""

    way: float
    """The distance along the keyboard [m]."""
    left: int
    struck: int
    ahead: float
    """Time from the release of the keys to the strike [s]."""
    late: float
    """Mean time for which the keys struck were missing [s]."""


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    playing = commands.add_parser("play", help="have the planner jump")
    playing.add_argument("jumps", type=Path, help="lines are added to it")
    playing.add_argument("--etudes", type=int, default=20)
    fitting = commands.add_parser("fit", help="fit the figures")
    fitting.add_argument("jumps", type=Path, help="written by play")
    for command in (playing, fitting):
        command.add_argument("--hand", default="shadow", help="its name, or module:NAME")
    options = parser.parse_args()
    if options.command == "play":
        play(options.jumps, options.hand, options.etudes)
    else:
        fit(jumps_in(options.jumps, options.hand), hand_named(options.hand))


def jumps_in(path: Path, hand: str) -> list[Jump]:
    """The jumps in a file.

    Raises:
        CadenzaError: there are none, or they are of another hand.
    """
    rows = rows_of(path)
    if any(row.pop("hand", hand) != hand for row in rows):
        raise CadenzaError(f"{path}: holds jumps of another hand than {hand}; choose another file")
    if not rows:
        raise CadenzaError(f"{path}: holds no jumps")
    return [Jump(**row) for row in rows]


# Playing


def play(path: Path, name: str, etudes: int) -> None:
    global HAND
    at_once = JumpTimes(glide=np.inf, glide_of_chord=np.inf, descent=0.0, next_key=0.0)
    HAND = replace(hand_named(name), jump_times=at_once)
    scene = SceneConfig(hand=f"{__name__}:HAND", hands="right")
    done = len(jumps_in(path, name)) if path.exists() else 0
    for etude in range(done // (CHORDS - 1), etudes):
        rng = np.random.default_rng(etude)
        chords, ways = made_up(HAND.reach.rest, rng)
        config = TaskConfig()
        task = PianoTask([score_of(chords, rng)], config, scene)
        agent = Planner(PlannerConfig(fingering="score"))
        episode = play_episode(task, agent, etude).episode
        task.close()
        jumps = jumps_of(episode, chords, ways, round(config.initial_buffer_time / DT))
        for jump in jumps:
            add_row(path, {"hand": name, **jump._asdict()})


def jumps_of(episode: Episode, chords: list[Chord], ways: list[float], first: int) -> list[Jump]:
    """The jumps between `chords`, the first of which is struck in step `first`."""
    goal = episode["goal_keys"]
    missing = goal & ~episode["key_activation"]
    jumps = []
    for i, (was, now) in enumerate(pairwise(chords)):
        struck = first + (i + 1) * LASTS
        left_keys, keys = ([pitch - LOWEST for pitch, _ in chord] for chord in (was, now))
        ahead = int(np.argmax(goal[:struck, left_keys].any(axis=1)[::-1]))
        late = float(missing[struck : struck + LATEST, keys].sum(axis=0).mean())
        jumps.append(Jump(ways[i], len(was), len(now), ahead * DT, late * DT))
    return jumps


def made_up(rest: Array, rng: np.random.Generator) -> tuple[list[Chord], list[float]]:
    """Chords that are nearly at rest, and the ways between them [m]; of fingers at `rest` (F,)."""
    end = PIANO.grid_y.max() - 0.1
    place, chords, places = 0.0, list[Chord](), []
    while len(chords) < CHORDS:
        way = rng.uniform(0.02, MAX_WAY)
        there = place + way * (-1) ** rng.integers(2)
        size = rng.choice([1, 2, 3], p=[0.5, 0.25, 0.25])
        fingers = np.sort(rng.choice(len(rest), min(size, len(rest)), replace=False))
        keys = np.flatnonzero(PIANO.is_black == (rng.random() < 0.4))
        nearest = keys[np.abs(PIANO.grid_y[keys, None] - there - rest[fingers]).argmin(axis=0)]
        before = [pitch - LOWEST for pitch, _ in chords[-1]] if chords else []
        if abs(there) > end - 0.1 or len({*nearest, *before}) < len(nearest) + len(before):
            continue
        place = float((PIANO.grid_y[nearest] - rest[fingers]).mean())
        places.append(place)
        chords.append([(LOWEST + int(k), int(f)) for k, f in zip(nearest, fingers, strict=True)])
    return chords, [abs(b - a) for a, b in pairwise(places)]


def score_of(chords: list[Chord], rng: np.random.Generator) -> Score:
    notes = []
    for i, chord in enumerate(chords):
        start, ahead = i * LASTS * DT, rng.integers(MAX_AHEAD) * DT
        end = start + LASTS * DT - ahead
        notes += [Note(start, end, pitch, 80, Finger(0, finger)) for pitch, finger in chord]
    return Score(tuple(notes), title="jumps")


# Fitting


def fit(jumps: list[Jump], hand: Hand) -> None:
    """Prints how late jumps land, and the figures that say so best."""
    way, left, struck, ahead, late = np.array(jumps).T
    single = (left == 1) & (struck == 1)
    edges = np.array([0.0, 0.05, 0.1, 0.15, 0.2, MAX_WAY])
    for name, some in (("single keys", single), ("chords", ~single)):
        print(f"{name}: steps late (jumps), by steps let go before")
        for low, high in pairwise(edges):
            cells = [
                some & (way >= low) & (way < high) & (ahead == n * DT) for n in range(MAX_AHEAD)
            ]
            means = (f"{late[c].mean() / DT:.1f} ({c.sum()})" if c.any() else "-" for c in cells)
            print(f"  {low:.2f} to {high:.2f} m: " + "  ".join(means))

    def error(figures: Array) -> float:
        times = times_of(figures, hand.jump_times)
        short = np.maximum(times.seconds(way, left, struck) - ahead, 0.0)
        return float(np.abs(figures[-1] + short - late).mean())

    bounds = [(0.0, 0.15), (5.0, 400.0), (5.0, 400.0), (0.0, 0.1), (0.0, 0.05)]
    fitted = times_of(np.round(differential_evolution(error, bounds, seed=0).x, 3), hand.jump_times)
    for name, times in (("the hand's", hand.jump_times), ("fitted", fitted)):
        asked = np.ceil(np.round(times.seconds(way, left, struck) / DT, 6))
        spare = np.round(ahead / DT) - asked
        enough, short_by_one = (
            f"{late[some].mean() / DT:.2f}" for some in (spare >= 0, spare == -1)
        )
        print(
            f"{name}: {times}\n  {asked.mean():.2f} steps; landed {enough} late, {short_by_one} "
            "with a step less"
        )


def times_of(figures: Array, others: JumpTimes) -> JumpTimes:
    """Jump times with these figures: a reach, two glides and a descent; else as `others`."""
    reach, glide, of_chord, descent = figures[:4].tolist()
    return replace(
        others, within_reach=reach, glide=glide, glide_of_chord=of_chord, descent=descent
    )


if __name__ == "__main__":
    main()
