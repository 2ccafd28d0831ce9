"""The first takes of a song: as the planner plays it, then in other ways where it loses.

Of the takes with the best fingers, what each did best is then put together (`patchwork`), and
followed, again and again. The best take of all is where practice begins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.control_steps import steps_in
from cadenza.agents.planning.memory import Memory
from cadenza.agents.planning.other_ways import OTHER_COSTS, Pieced, Way
from cadenza.agents.planning.practised_planner import Rehearsal
from cadenza.agents.planning.takes import Take, scene_before
from cadenza.agents.planning.version import Version
from cadenza.fingering.changes import Costs
from cadenza.fingers import NO_FINGER
from cadenza.sim.threads import Threads
from cadenza.tasks.goal_track import GoalTrack

_CHUNK = 2.0  # [s] that are played at a time
_LATER = (1, 2)  # steps later than usual that hands let go before a jump
_FOLLOWED = 6  # times that hands follow the best of all takes, put together

Parts = dict[str, dict[str, Any]]
"""Arrays by part and name."""

Bounds = dict[str, tuple[Any, Any]]
"""Least and most by "part/name", of which `*` stands for any."""


class FirstTakes:
    """Takes of a song, one after the other.

    Attributes:
        seed: of what is random from the second on.
        played: steps of the take that is played now, or was last.
    """

    def __init__(
        self,
        track: GoalTrack,
        start: Array,
        config: ScorePlannerConfig,
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
        self._enter(Version(track, start, config, rng, threads, progress))
        self.seed = int(rng.integers(2**63))
        self._chunk = steps_in(_CHUNK, track.config.control_timestep)
        fingers = [partial(self._with_fingers_by, costs) for costs in OTHER_COSTS if found]
        jumps = [partial(self._letting_go, steps) for steps in _LATER]
        self._ways: list[Callable[[], Way]] = [
            *fingers,
            self._best_of_each,
            *(trial for jump in jumps for trial in (jump, self._best_of_each)),
        ]
        self._tried = 0
        self._kept: tuple[Version, Take] | None = None
        self._pieced, self._patchwork = self._as_played(), self._take

    def _enter(self, version: Version) -> None:
        """Goes over to a version of which nothing has been played."""
        self._version, self._take, self.played = version, version.take_to_come, 0
        self._moments = {0: version.stage.beginning()}

    @property
    def best(self) -> tuple[Version, Take]:
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
        return not self.is_playing and self._tried == len(self._ways) + _FOLLOWED

    def go_on(self) -> int:
        """Plays two seconds, or begins another take.

        Returns:
            How many control steps of a hand were simulated.
        """
        if not self.is_playing:
            self._begin_another()
            return 0
        version, take, first = self._version, self._take, self.played
        last = min(first + self._chunk, len(take.ctrl))
        before = version.searching.simulated
        played, moments = version.stage.play(
            scene_before(first, take, self._moments),
            first,
            take.part(first, last),
            take.heard(first),
            self._chunk,
            version.searching.act,
        )
        take.put(first, played)
        self.played = last
        self._moments = {step: moment for step, moment in moments.items() if step == last}
        if not self.is_playing:
            self._compare()
        return version.searching.simulated - before + (last - first) * len(version.parts)

    def _compare(self) -> None:
        """Of the take that is over and the best before it, goes on with the better one."""
        if not self._kept:
            self._pieced, self._patchwork = self._as_played(), self._take
            return
        self._pieced = self._pieced.with_better(self._version.way, self._take.loss)
        version, take = self._kept
        alike = np.array_equal(version.way.fingers, self._version.way.fingers)
        if alike:
            self._patchwork = self._version.patched(self._patchwork, self._take)
        if not self._version.rehearsal(self._take).no_worse_than(version.rehearsal(take)):
            self._version, self._take = version, take
        elif not alike:
            self._patchwork = self._take
        self._kept = None

    def _as_played(self) -> Pieced:
        """The way of the take that is the best so far."""
        return Pieced(self._version.plan.track, self._version.way, self._take.loss.copy())

    def _begin_another(self) -> None:
        """Goes over to the next take, if it is to be another one than the best so far."""
        self._tried += 1
        if self._is_following:
            if self._patchwork.loss.sum() < self._take.loss.sum():
                self._kept = self._version, self._take
                self._follow(self._version)
            return
        way = self._ways[self._tried - 1]()
        if not way.is_like(self._version.way):
            self._kept = self._version, self._take
            self._enter(self._other(way))

    @property
    def _is_following(self) -> bool:
        """Whether the last take that was begun is to be as the best of all."""
        return self._tried > len(self._ways)

    def _follow(self, version: Version) -> None:
        """Has a version play the best of all takes, put together."""
        self._enter(version)
        rngs = np.random.default_rng((self.seed, self._tried)).spawn(len(version.parts))
        version.follow(self._patchwork, 0, rngs)

    def _with_fingers_by(self, costs: Costs) -> Way:
        return self._pieced.with_fingers_by(costs)

    def _letting_go(self, later: int) -> Way:
        """As in the best take, but so many steps later before jumps."""
        self._pieced = self._as_played()
        return self._pieced.letting_go(later)

    def _best_of_each(self) -> Way:
        return self._pieced.way

    def _other(self, way: Way) -> Version:
        rng, track = np.random.default_rng((self.seed, self._tried)), self._version.plan.track
        return Version(track, self._start, self._config, rng, self._threads, way=way)

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
        _, way, loss = self._pieced
        parts["pieced"] = way._asdict() | {"loss": loss}
        parts["patchwork"] = self._patchwork._asdict()
        return parts

    @property
    def bounds(self) -> Bounds:
        """Between which values what is kept of them lies."""
        counts = [len(self._take.ctrl), len(self._ways) + _FOLLOWED]
        last = self._version.plan.scene.fingers.count - 1
        return {
            "first/numbers": ([0, 0], counts),
            "*/fingers": (NO_FINGER, last),
            "*/later": (0, len(_LATER)),
        }

    def restore(self, parts: Mapping[str, dict[str, Any]], best: Take) -> None:
        """Goes on from the `parts` of the same takes, of which `best` was the best."""
        first = parts["first"]
        played, self._tried = first["numbers"].tolist()
        pieced = parts["pieced"]
        self._pieced = self._pieced._replace(way=_way_in(pieced), loss=pieced["loss"])
        self._patchwork = Take(**parts["patchwork"])
        version = self._version_of(_way_in(first))
        if other := parts.get("other"):
            self._kept = version, best
            best = Take(**{name: other[name] for name in Take._fields})
        if other and self._is_following:
            self._follow(version)
        else:
            self._enter(self._version_of(_way_in(other)) if other else version)
        self._take, self.played = best, played
        if self.is_playing:
            self._go_back([Memory(**parts[side]) for side in version.plan.scene.sides])

    def _version_of(self, way: Way) -> Version:
        """The first one, if that is its way."""
        return self._version if way.is_like(self._version.way) else self._other(way)

    def _go_back(self, memories: list[Memory]) -> None:
        """To where the take was left."""
        (simulation,) = self._moments.values()
        searching = self._version.searching
        for ctrl in self._take.ctrl[: self.played]:
            searching.again(simulation.state, ctrl)
            simulation.step(ctrl[None])
        searching.remember(memories)
        self._moments = {self.played: simulation}


def _way_in(part: Mapping[str, Any]) -> Way:
    return Way(**{name: part[name] for name in Way._fields})
