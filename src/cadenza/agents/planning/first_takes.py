"""How a song is played at sight: with the planner's fingers, then with others where it loses.

The best of these takes is where practice begins.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.control_steps import steps_in
from cadenza.agents.planning.other_fingers import OTHER_COSTS, Pieced, fingers_in, with_fingers
from cadenza.agents.planning.practised_planner import Rehearsal
from cadenza.agents.planning.refinement import Memory
from cadenza.agents.planning.takes import Take, scene_before
from cadenza.agents.planning.version import Version
from cadenza.sim.threads import Threads
from cadenza.tasks.goal_track import GoalTrack

_CHUNK = 2.0  # [s] that are played at a time

Parts = dict[str, dict[str, Any]]
"""Arrays by part and name."""


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
        self._tried = 0 if found else len(OTHER_COSTS) + 1
        self._kept: tuple[Version, Take] | None = None
        self._pieced: Pieced | None = None

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
    def tries_fingers(self) -> bool:
        """Whether the take is one with other fingers."""
        return self._kept is not None

    @property
    def over(self) -> bool:
        """Whether there is nothing left to try."""
        return not self.is_playing and self._tried > len(OTHER_COSTS)

    def go_on(self) -> int:
        """Plays two seconds, or chooses other fingers.

        Returns:
            How many control steps of a hand were simulated.
        """
        if not self.is_playing:
            self._choose_fingers()
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
        track, loss, pieced = self._version.plan.track, self._take.loss, self._pieced
        self._pieced = (
            pieced.with_better(track.score, loss) if pieced else Pieced(track, loss.copy())
        )
        if self._kept:
            version, take = self._kept
            if not self._version.rehearsal(self._take).no_worse_than(version.rehearsal(take)):
                self._version, self._take = version, take
            self._kept = None

    def _choose_fingers(self) -> None:
        """Goes over to other fingers where something is lost, if these costs choose any.

        In the end to the best of each passage.
        """
        assert self._pieced
        costs = OTHER_COSTS[self._tried : self._tried + 1]
        track = self._pieced.others(*costs) if costs else self._pieced.track
        self._tried += 1
        if track.score != self._version.plan.track.score:
            self._kept = self._version, self._take
            self._enter(self._other(track))

    def _other(self, track: GoalTrack) -> Version:
        rng = np.random.default_rng((self.seed, self._tried))
        return Version(track, self._start, self._config, rng, self._threads)

    def rehearsal(self) -> Rehearsal:
        """The first take, with what is left to play."""
        whole = self._version.to_the_end(self._take, self.played, self._moments)
        return self._version.rehearsal(whole)

    # To go on later

    def parts(self, *, everything: bool = False) -> Parts:
        """All that decides how they go on, beside the best take; or all that there may be."""
        version, take = self.best
        fingers = fingers_in(version.plan.track)
        parts: Parts = {"first": {"numbers": [self.played, self._tried], "fingers": fingers}}
        if self.is_playing or everything:
            memories = self._version.searching.memories
            for side, memory in zip(version.plan.scene.sides, memories, strict=True):
                parts[side] = memory._asdict()
        if self._kept or everything:
            fingers = fingers_in(self._version.plan.track)
            parts["other"] = {"fingers": fingers, **self._take._asdict()}
        if self._pieced or everything:
            pieced = self._pieced or Pieced(version.plan.track, take.loss)
            parts["pieced"] = {"fingers": fingers_in(pieced.track), "loss": pieced.loss}
        return parts

    def restore(self, parts: Mapping[str, dict[str, Any]], best: Take) -> None:
        """Goes on from the `parts` of the same takes, of which `best` was the best."""
        track, first = self._version.plan.track, parts["first"]
        played, self._tried = first["numbers"].tolist()
        if pieced := parts.get("pieced"):
            self._pieced = Pieced(with_fingers(track, pieced["fingers"]), pieced["loss"])
        version = self._version_with(first["fingers"])
        if other := parts.get("other"):
            self._kept = version, best
            version = self._version_with(other.pop("fingers"))
            best = Take(**other)
        self._enter(version)
        self._take, self.played = best, played
        if self.is_playing:
            self._go_back([Memory(**parts[side]) for side in version.plan.scene.sides])

    def _version_with(self, fingers: NDArray[np.int64]) -> Version:
        """The first one, if it has those."""
        track = self._version.plan.track
        other = with_fingers(track, fingers)
        return self._version if other.score == track.score else self._other(other)

    def _go_back(self, memories: list[Memory]) -> None:
        """To where the take was left."""
        (simulation,) = self._moments.values()
        searching = self._version.searching
        for ctrl in self._take.ctrl[: self.played]:
            searching.again(simulation.state, ctrl)
            simulation.step(ctrl[None])
        searching.remember(memories)
        self._moments = {self.played: simulation}
