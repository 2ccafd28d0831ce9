"""Measures planner and generalist on robots that nobody knows: directly, and after ten plays.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.unknown_robots [SONG ...]
        [--profiles P ...] [--robots SEED ...] [--ways W ...] [--seconds S] [-o docs/results]

Plays the first seconds of each song on robots, by default 0 to 9. Directly, agents know how late
robots are by their profile. "causes" is the generalist without what differs, one cause after the
other, which tells what loses most. Writes robot-plays.csv, a row for each song and robot, from
which it goes on, and robots.csv and robot-causes.csv, with means and 95 % intervals of songs and
robots.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.arguments import parser_for
from cadenza.agents.agent import Agent
from cadenza.agents.generalist.generalist import Generalist
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.robot.practice import learn_in_ten_plays
from cadenza.agents.robot.simulated import SimulatedRobot
from cadenza.agents.rollout import EpisodeResult, begin_episodes, play_episode
from cadenza.errors import errors_in_a_line
from cadenza.evaluation.statistics import bootstrap_interval
from cadenza.evaluation.tables import write_csv
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Score
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.robots import PROFILES, Profile
from cadenza.tasks.unknown_robot import UnknownRobotEnv

SONGS = (
    *("TwinkleTwinkleLittleStar", "OdeToJoy", "MinuetInG"),
    *("BachPreludeInCMajor", "FurEliseOpening", "MoonlightOpening"),
)
"""From easy to hard."""
METRICS = "f1", "note_onset_f1"
DIRECT: Mapping[str, Callable[[], Agent]] = {
    "planner": Planner,
    "practised planner": lambda: Planner(PlannerConfig(effort=1.0)),
    "generalist": Generalist,
}
EACH_CAUSE = "causes"
PRACTICE, FIRST, AFTER = "practice", "first of ten plays", "after ten plays"
CAUSES: Mapping[str, tuple[str, ...]] = {
    "delays": ("latency", "observation_latency"),
    "limits of speed": ("joint_speed", "slide_speed"),
    "backlash": ("joint_backlash", "slide_backlash", "joint_dead_band", "slide_dead_band"),
    "noise": (
        *("joint_noise", "slide_noise", "key_noise", "touch_noise", "drift"),
        *("joint_bias", "slide_bias", "touch_bias", "joint_control_noise", "slide_control_noise"),
    ),
    "errors of place": ("keyboard_offset", "keyboard_tilt", "mount_offset", "mount_tilt"),
    "servo gains": ("servo_gain", "joint_damping", "force_limit"),
    "masses and friction": ("mass", "friction", "joint_friction"),
    "other keys": ("key_spring", "key_travel", "key_sounding"),
    "pushes": ("gravity_tilt", "push"),
}
"""What differs of robots, and its fields."""


def directly(
    score: Score, agent: str, profile: Profile, robot: int, cause: str | None = None
) -> Mapping[str, Any]:
    """How an agent plays a robot at once, with feedback, perhaps without a cause of differences."""
    same = {name: getattr(DomainRandomization, name) for name in CAUSES.get(cause or "", ())}
    config = TaskConfig(randomization=replace(PROFILES[profile], robot=robot, **same))
    return play_episode(PianoTask([score], config), DIRECT[agent](), 0).metrics


def without(cause: str) -> str:
    """What the table calls it when the generalist plays without a cause of differences."""
    return f"generalist, without {cause}"


def practised(
    score: Score, nominal: EpisodeResult, profile: Profile, robot: int
) -> dict[str, Mapping[str, Any]]:
    """How a robot is played at first, and after ten plays."""
    there, task = SimulatedRobot(UnknownRobotEnv(score, robot, profile)), PianoTask([score])
    begin_episodes(task, [0])
    assert nominal.plan is not None
    known = PROFILES[profile]
    plan, episode = nominal.plan, nominal.episode
    first, *_ = learn_in_ten_plays(there, task.view(), plan, episode, known)
    heard = {"f1": first.f1, "note_onset_f1": first.note_onset_f1}
    return {FIRST: heard, AFTER: there.scored}


def summary(plays: list[dict[str, Any]], ways: Sequence[str]) -> list[dict[str, Any]]:
    """Means with intervals of ways of playing, of robots that have played all songs."""
    rows = []
    for profile, how in product(PROFILES, ways):
        own = [row for row in plays if (row["profile"], row["how"]) == (profile, how)]
        songs = list(dict.fromkeys(row["song"] for row in own))
        found = {(row["robot"], row["song"]): row for row in own}
        every = list(dict.fromkeys(row["robot"] for row in own))
        robots = [robot for robot in every if all((robot, song) in found for song in songs)]
        if not robots:
            continue
        row = {"profile": profile, "how": how, "songs": len(songs), "robots": len(robots)}
        for name in METRICS:
            values = np.array([[float(found[r, s][name]) for s in songs] for r in robots])
            low, high = bootstrap_interval(values)
            row |= {name: values.mean(), f"{name}_low": low, f"{name}_high": high}
        rows.append(row)
    return rows


@errors_in_a_line()
def main() -> None:
    """Plays, and writes after each song and robot."""
    parser = parser_for(__doc__)
    parser.add_argument("songs", nargs="*", default=SONGS, help="bundled pieces or MIDI files")
    parser.add_argument("--profiles", nargs="+", choices=PROFILES, default=["realistic", "harsh"])
    parser.add_argument("--robots", nargs="+", type=int, default=range(10), help="their seeds")
    ways = [*DIRECT, EACH_CAUSE, PRACTICE]
    parser.add_argument("--ways", nargs="+", choices=ways, default=ways, help="of playing")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/results"))
    options = parser.parse_args()
    table, plays = options.output / "robot-plays.csv", list[dict[str, Any]]()
    if table.exists():
        with table.open(newline="") as file:
            plays = list(csv.DictReader(file))
    done = {(row["profile"], row["song"], str(row["robot"]), row["how"]) for row in plays}
    scores = {song: load_score(song).until(options.seconds) for song in options.songs}
    nominal = cache(lambda song: play_episode(PianoTask([scores[song]]), Planner(), 0))
    for robot, profile, song in product(options.robots, options.profiles, scores):
        measured = dict[str, Mapping[str, Any]]()
        for agent in [way for way in DIRECT if way in options.ways]:
            if (profile, song, str(robot), how := f"{agent}, directly") not in done:
                measured[how] = directly(scores[song], agent, profile, robot)
        for cause in CAUSES if EACH_CAUSE in options.ways else ():
            if (profile, song, str(robot), how := without(cause)) not in done:
                measured[how] = directly(scores[song], "generalist", profile, robot, cause)
        if PRACTICE in options.ways and (profile, song, str(robot), AFTER) not in done:
            measured |= practised(scores[song], nominal(song), profile, robot)
        for how, metrics in measured.items():
            row = {"profile": profile, "how": how, "song": song, "robot": str(robot)}
            plays.append(row | {name: metrics[name] for name in METRICS})
            print(*row.values(), *(f"{metrics[name]:.3f}" for name in METRICS), flush=True)
        if measured:
            write_csv(table, plays)
    tables = {"robots": [*(f"{agent}, directly" for agent in DIRECT), FIRST, AFTER]}
    tables["robot-causes"] = ["generalist, directly", *map(without, CAUSES)]
    for name, hows in tables.items():
        write_csv(options.output / f"{name}.csv", summary(plays, hows))


if __name__ == "__main__":
    main()
