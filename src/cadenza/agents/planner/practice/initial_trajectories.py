"""The first takes of a song: as the planner plays it, then in other ways where it loses.

In between, what each take did best is put together (`patchwork`), and hands follow that. The best
take of all is where practice begins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.practice.plan_variants import OTHER_COSTS, SplicedTrajectory, Variant
from cadenza.agents.planner.practice.planned_variant import PlannedVariant
from cadenza.agents.planner.practice.practised_planner import Rehearsal
from cadenza.agents.planner.practice.trajectory import Snapshots, Trajectory, scene_before
from cadenza.agents.planner.search.hand_search import SearchState
from cadenza.fingering.transitions import Costs
from cadenza.fingers import NO_FINGER
from cadenza.sim.threads import Threads
from cadenza.tasks.goal_track import GoalTrack

_CHUNK = 1.0  # [s] that are played at a time
_LATER = 0.1  # [s] later than usual, at most, that hands let go before a jump
_TRIES = 4  # for each second, of hands that follow the best of all takes, put together

Parts = dict[str, dict[str, Any]]
"""Arrays by part and name."""

Bounds = dict[str, tuple[Any, Any]]
"""Least and most by "part/name", of which `*` stands for any."""


class _Played(NamedTuple):
    """What came of some steps."""

    take: Trajectory
    moments: Snapshots
    simulated: int
    """Control steps of a hand."""


class InitialTrajectories:
    """Takes of a song, one after the other.

    Attributes:
        seed: of what is random from the second on.
        played: steps of the take that is played now, or was last.
    """

    def __init__(
        self,
        track: GoalTrack,
        start: Array,
        config: PlannerConfig,
        rng: np.random.Generator,
        threads: Threads,
        progress: Progress = silent,
    ) -> None:
        """Args:
            track: the song.
            start: (J,) joint positions of the hands where it begins [m, rad].
            config: how to plan.
            rng: what is random.
            threads: that share the work.
            progress: is told of "fingers" and "postures".

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        found = config.fingering == "found"
        if found:
            track = track.with_found_fingers()
        self._start, self._config, self._threads = start, config, threads
        self._enter(PlannedVariant(track, start, config, rng, threads, progress))
        self.seed = int(rng.integers(2**63))
        self._chunk = steps_in(_CHUNK, track.config.control_timestep)
        fingers = [partial(self._with_fingers_by, costs) for costs in OTHER_COSTS if found]
        self._latest = steps_in(_LATER, track.config.control_timestep)
        jumps = [partial(self._letting_go, step) for step in range(1, self._latest + 1)]
        self._ways: list[Callable[[], Variant]] = [
            *fingers,
            self._put_together,
            *(trial for jump in jumps for trial in (jump, self._put_together)),
            self._put_together,
        ]
        self._tried = 0
        self._kept: tuple[PlannedVariant, Trajectory] | None = None
        self._pieced = self._as_played()

    def _enter(self, version: PlannedVariant) -> None:
        """Goes over to a version of which nothing has been played."""
        self._version, self._take, self.played = version, version.take_to_come, 0
        self._moments = {0: version.stage.beginning()}

    @property
    def best(self) -> tuple[PlannedVariant, Trajectory]:
        """The best take so far; of the first one what has been played, and what is expected."""
        return self._kept or (self._version, self._take)

    @property
    def is_playing(self) -> bool:
        """Whether the take has steps left."""
        return self.played < len(self._take.ctrl)

    @property
    def plays_another_take(self) -> bool:
        """Whether the take is not the first one."""
        return self._kept is not None

    @property
    def over(self) -> bool:
        """Whether there is nothing left to try."""
        return not self.is_playing and self._tried == len(self._ways)

    def go_on(self) -> int:
        """Plays a second, or begins another take.

        Returns:
            How many control steps of a hand were simulated.
        """
        if not self.is_playing:
            self._begin_another()
            return 0
        first = self.played
        last = min(first + self._chunk, len(self._take.ctrl))
        tries = self._followed(first, last) if self._follows else [self._play(first, last)]
        best = min(tries, key=lambda each: float(each.take.cost.sum()))
        self._take.put(first, best.take)
        self._moments = {step: moment for step, moment in best.moments.items() if step == last}
        self.played = last  # only now: whoever interrupts this may go on
        if not self.is_playing:
            self._compare()
        return sum(each.simulated for each in tries)

    def _play(self, first: int, last: int) -> _Played:
        """Plays from one step to another."""
        version, take = self._version, self._take
        simulation, before = scene_before(first, take, self._moments), version.searching.simulated
        part, heard, act = take.part(first, last), take.heard(first), version.searching.act
        played = version.stage.play(simulation, first, part, heard, self._chunk, act)
        simulated = version.searching.simulated - before + part.loss.size
        return _Played(*played, simulated)

    def _followed(self, first: int, last: int) -> list[_Played]:
        """Follows what was put together, until it loses no more than that."""
        version, pieced, tries = self._version, self._pieced.take, list[_Played]()
        wanted = pieced.loss[first:last].sum()
        while len(tries) < _TRIES and all(each.take.loss.sum() > wanted for each in tries):
            rng = np.random.default_rng((self.seed, self._tried, first, len(tries)))
            version.follow(pieced, first, rng.spawn(len(version.parts)))
            tries.append(self._play(first, last))
        return tries

    def _compare(self) -> None:
        """Of the take that is over and the best before it, goes on with the better one."""
        if not self._kept:
            self._pieced = self._as_played()
            return
        now, (version, take) = self._version, self._kept
        self._pieced = self._pieced.with_better(now.way, self._take, now.parts)
        if not now.rehearsal(self._take).no_worse_than(version.rehearsal(take)):
            self._version, self._take = version, take
        self._kept = None

    def _as_played(self) -> SplicedTrajectory:
        """The take that is the best so far."""
        take = self._take.part(0, len(self._take.ctrl))
        return SplicedTrajectory(self._version.plan.track, self._version.way, take)

    def _begin_another(self) -> None:
        """Goes over to the next take, if it is to be another one than the best so far."""
        self._tried += 1
        way = self._ways[self._tried - 1]()
        if self._follows:
            differs = self._pieced.take.loss.sum() < self._take.loss.sum()
        else:
            differs = not way.is_like(self._version.way)
        if differs:
            self._kept = self._version, self._take
            self._enter(self._version_in(way))

    @property
    def _follows(self) -> bool:
        """Whether the last take that was begun is to be as the best of all, put together."""
        return self._tried > 0 and self._ways[self._tried - 1] == self._put_together

    def _with_fingers_by(self, costs: Costs) -> Variant:
        return self._pieced.with_fingers_by(costs)

    def _letting_go(self, later: int) -> Variant:
        return self._pieced.letting_go(later)

    def _put_together(self) -> Variant:
        return self._pieced.way

    def _version_in(self, way: Variant) -> PlannedVariant:
        """The one that is there, if that is its way."""
        if way.is_like(self._version.way):
            return self._version
        rng, track = np.random.default_rng((self.seed, self._tried)), self._version.plan.track
        return PlannedVariant(track, self._start, self._config, rng, self._threads, way=way)

    def rehearsal(self) -> Rehearsal:
        """The first take, with what is left to play."""
        whole = self._version.to_the_end(self._take, self.played, self._moments)
        return self._version.rehearsal(whole)

    # To go on later

    def parts(self, *, everything: bool = False) -> Parts:
        """All that decides how they go on, beside the best take; or all that there may be."""
        version, _ = self.best
        numbers = {"numbers": [self.played, self._tried]}
        parts: Parts = {"first": numbers | version.way._asdict()}
        if self.is_playing or everything:
            memories = self._version.searching.memories
            for side, memory in zip(version.plan.scene.sides, memories, strict=True):
                parts[side] = memory._asdict()
        if self._kept or everything:
            parts["other"] = self._version.way._asdict() | self._take._asdict()
        parts["pieced"] = self._pieced.way._asdict() | self._pieced.take._asdict()
        return parts

    @property
    def bounds(self) -> Bounds:
        """Between which values what is kept of them lies."""
        counts = [len(self._take.ctrl), len(self._ways)]
        last = self._version.plan.scene.fingers.count - 1
        return {
            "first/numbers": ([0, 0], counts),
            "*/fingers": (NO_FINGER, last),
            "*/later": (0, self._latest),
        }

    def restore(self, parts: Mapping[str, dict[str, Any]], best: Trajectory) -> None:
        """Goes on from the `parts` of the same takes, of which `best` was the best."""
        first = parts["first"]
        played, self._tried = first["numbers"].tolist()
        pieced = parts["pieced"]
        self._pieced = self._pieced._replace(way=_way_in(pieced), take=_take_in(pieced))
        self._enter(self._version_in(_way_in(first)))
        self._take = best
        if other := parts.get("other"):
            self._kept = self._version, best
            self._enter(self._version_in(_way_in(other)))
            self._take = _take_in(other)
        self.played = played
        if self.is_playing:
            sides = self._version.plan.scene.sides
            self._go_back([SearchState(**parts[side]) for side in sides])

    def _go_back(self, memories: list[SearchState]) -> None:
        """To where the take was left."""
        (simulation,) = self._moments.values()
        searching = self._version.searching
        for ctrl in self._take.ctrl[: self.played]:
            searching.again(simulation.state, ctrl)
            simulation.step(ctrl[None])
        searching.remember(memories)
        self._moments = {self.played: simulation}


def _way_in(part: Mapping[str, Any]) -> Variant:
    return Variant(**{name: part[name] for name in Variant._fields})


def _take_in(part: Mapping[str, Any]) -> Trajectory:
    return Trajectory(**{name: part[name] for name in Trajectory._fields})
