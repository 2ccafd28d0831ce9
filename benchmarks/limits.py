"""Calculates how much of a song hands could hold at most, whoever plans for them.

    python -m benchmarks.limits LIBRARY[:SPLIT] [--first-seconds S] [--fingerings N]

Prints a table in Markdown: the mean F1 that plans would reach if they were carried out without a
mistake, with jumps as the planner plans them, as fast as the servo of the forearm can be, and in a
single control step. Once with the fingers that the planner finds, and once with the best of N
fingerings in each two seconds, as if hands could change between them at no cost. Nothing is
simulated, so a song takes seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from benchmarks.arguments import one_or_more, parser_for
from cadenza.agents.planner.plan.presses import presses_of
from cadenza.agents.planner.plan.releases import release_in_time
from cadenza.agents.planner.plan.rest_poses import forearm_places
from cadenza.errors import errors_in_a_line
from cadenza.fingering.search import COSTS, find_fingering
from cadenza.fingering.transitions import Costs
from cadenza.hands.reach import JumpTimes
from cadenza.music.libraries.library import open_library
from cadenza.music.metrics import step_metrics
from cadenza.music.score import Score
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import Scene, build_scene
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack, players_of

Array = NDArray[np.float64]

TASK = TaskConfig(initial_buffer_time=0.0)
DT = TASK.control_timestep
WINDOW = 2.0  # [s] in which one fingering is held to
WAYS = np.linspace(0.0, 0.6, 25)  # [m] of jumps
FINEST = 5e-4  # [s] steps in which the least times of jumps are calculated


def least_seconds(scene: Scene) -> Array:
    """Least times in which the servo of a forearm moves by each of `WAYS`, from rest to rest [s].

    Its control is at one end of its range and then at the other (bang-bang), from where along the
    keyboard that is fastest.
    """
    servos = servos_of(scene)
    servo = servos.along_keyboard[0]
    low, high = servos.low[servo], servos.high[servo]
    stiffness, damping, mass = (
        values[servo] for values in (servos.stiffness, servos.damping, servos.inertia)
    )

    def path(start: float, control: float, step: float) -> tuple[Array, Array]:
        """(N,) places and speeds from rest on, until half a second before or after."""
        place, speed = [start], [0.0]
        for _ in range(round(0.5 / FINEST)):
            force = stiffness * (control - place[-1]) - damping * speed[-1]
            speed.append(min(speed[-1] + step * force / mass, 20.0))
            place.append(place[-1] + step * speed[-1])
        return np.array(place), np.array(speed)

    def seconds(start: float, end: float) -> float:
        gone, gaining = path(start, high, FINEST)
        left, losing = path(end, low, -FINEST)
        between = np.linspace(start, end, 200)
        there = np.interp(between, gone, gaining) >= np.interp(between, left[::-1], losing[::-1])
        change = between[np.argmax(there)]
        steps = (gone < change).sum() + (left > change).sum()
        return float(steps * FINEST)

    starts = np.linspace(low, high, 25)
    return np.array(
        [min(seconds(at, at + way) for at in starts if at + way <= high) for way in WAYS]
    )


@dataclass(frozen=True)
class FastestJumps(JumpTimes):
    """Jump times of forearms as fast as their servos can be, without lifting the hand or landing.

    Where the planner takes less time, since it counts on fingers that swing, so do these.
    """

    least: tuple[float, ...] = ()

    def seconds(
        self, distance: ArrayLike, left: ArrayLike, struck: ArrayLike, holding: ArrayLike = False
    ) -> Array:
        reach = np.where(holding, self.while_holding, self.within_reach)
        glided = np.maximum(np.asarray(distance) - reach, 0.0)
        fastest = np.interp(glided, WAYS, self.least)
        return np.minimum(super().seconds(distance, left, struck, holding), fastest)


class Holding:
    """The keys that hands would hold whose jumps take these times."""

    def __init__(self, scene: Scene, times: JumpTimes) -> None:
        self._fingers, self._is_black = scene.fingers, scene.keyboard.is_black
        self._places = forearm_places(Kinematics(scene))
        self._hand = replace(scene.hand, jump_times=times)

    def f1(self, track: GoalTrack) -> Array:
        """(T,) F1 of each step, if the keys that are held sound and no others."""
        goals, held = track.goals, np.zeros_like(track.goals.keys)
        presses = presses_of(goals.fingers, self._fingers)
        for press in release_in_time(presses, self._places, self._is_black, DT, self._hand):
            held[press.first - 1 : press.last - 1, press.key] = True
        return step_metrics(held, goals.keys)[2]


def costs_to_try(number: int) -> list[Costs]:
    """The costs of the planner, and random ones: each multiplied by 1/16 to 16."""
    rng, costs = np.random.default_rng(0), np.array(astuple(COSTS))
    drawn = costs * 16.0 ** rng.uniform(-1, 1, (number - 1, len(costs)))
    return [COSTS, *(Costs(*each.tolist()) for each in drawn)]


def of_song(score: Score, scene: Scene, ways: Sequence[Holding], costs: Sequence[Costs]) -> Array:
    """(W, 2) mean F1 in each way: with the fingers of the first costs, and with the best."""
    players, track = players_of(scene), GoalTrack(score, None, TASK, scene)
    found = (find_fingering(score, players, costs=each)[0] for each in costs)
    tracks = [replace(track, score=fingered) for fingered in found]
    result = []
    for way in ways:
        f1 = np.array([way.f1(fingered) for fingered in tracks])
        windows = np.arange(0, f1.shape[1], round(WINDOW / DT))
        best = np.add.reduceat(f1, windows, axis=1).max(axis=0).sum() / f1.shape[1]
        result.append((f1[0].mean(), best))
    return np.array(result)


@errors_in_a_line()
def main() -> None:
    """Calculates and prints the table."""
    parser = parser_for(__doc__)
    parser.add_argument("library", help="as LIBRARY or LIBRARY:SPLIT, see cadenza libraries")
    parser.add_argument("--first-seconds", type=float, default=30.0, help="of each song [s]")
    parser.add_argument("--fingerings", type=one_or_more, default=40)
    options = parser.parse_args()
    songs, scene = open_library(options.library).songs, build_scene()
    usual = scene.hand.jump_times
    jumps = {
        "as the planner plans them": usual,
        "as fast as the servos can": FastestJumps(least=tuple(least_seconds(scene).tolist())),
        "in one control step": replace(usual, glide=1e9, glide_of_chord=1e9, descent=0.0),
    }
    ways = [Holding(scene, times) for times in jumps.values()]
    costs = costs_to_try(options.fingerings)
    scores = (song.load().without_fingers().beginning(options.first_seconds) for song in songs)
    f1 = np.array([of_song(s, scene, ways, costs) for s in tqdm(scores, total=len(songs))])
    print(f"| jumps | the planner's fingers | the best of {options.fingerings} fingerings |")
    print("| --- | --- | --- |")
    for name, (found, best) in zip(jumps, f1.mean(axis=0), strict=True):
        print(f"| {name} | {found:.3f} | {best:.3f} |")


if __name__ == "__main__":
    main()
