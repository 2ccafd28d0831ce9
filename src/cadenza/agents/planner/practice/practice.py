"""Two hands practise a song: they play it, go back to what fails, and keep what is better.

What they have played is a *take*: controls, and what came of them in the whole scene, step by
step. The first is what the planner plays. The next ones are played as the planner plays, too, but
in other ways where something is lost (`other_ways`), and then like the best of all of them, put
together (`patchwork`). From the best take on, practice goes over the song again and again. A
*sweep* works on two seconds after two seconds, from the beginning to the end: each hand picks a
step that loses something and looks for something better to do (`hand_practice`), and what they
have found is put into the take if that and the next seconds are better for it in the whole scene.
The smallest change is felt for seconds, however feedback leads back to the take; therefore what
follows is always played anew from where the hands have really come to, with a search where they
would miss what they had, and a sweep that comes to a worse end is undone.

Effort is counted in simulated control steps, so that the same effort comes to the same on every
machine, by however many threads it is made.
"""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.practice.hand_practice import Attempt, Change, HandPractice
from cadenza.agents.planner.practice.initial_trajectories import Bounds, InitialTrajectories, Parts
from cadenza.agents.planner.practice.practised_planner import Rehearsal
from cadenza.agents.planner.practice.trajectory import Snapshots, Trajectory, scene_before
from cadenza.agents.playback import options_of
from cadenza.configs import identity
from cadenza.errors import CadenzaError
from cadenza.files import FLOATS, TEXT, ArrayOf, Expected, first_fitting
from cadenza.music.metrics import step_metrics
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State
from cadenza.sim.threads import Threads
from cadenza.tasks.view import View

EFFORT = 100  # control steps that each hand simulates for each one of the song: effort 1
MOST_EFFORT = 1e6
_SWEEPS = 0.5, 1.0  # effort of a sweep while no attempt has failed, and of each later one
_APART = 0.5  # [s] between passages
_BETWEEN = 0.5  # [s] between the moments of a take in which playing can begin
_WINDOW = 4  # times _BETWEEN are worked on at a time
_ADVANCE = 3  # times it later begins the next window
_AFTER = 2  # times it after a window must not suffer
# Parts of a state that are never missing.
_ALWAYS = ("practice", "take", "first", "pieced")
_AROUND = 0.15  # [s] before and after a step that share its failures
OF = {"practice/of": ArrayOf(TEXT, needed=True)}
"""What a state says first: what was practised."""


class _Sweep(NamedTuple):
    """How far practice has gone over the song."""

    first: int
    """Step at which the window begins that is worked on."""
    until: Array
    """(T,) simulated control steps after which a window is left that ends with each step."""
    before: Trajectory
    """The take when it began."""


class Practice:
    """How far a song has been practised.

    Attributes:
        take: what they play best so far; of steps that they have not played, what the plan expects.
        at: the steps that were worked on last.
        simulated: control steps of a hand, in all, after the first take.
        history: effort, F1 and F1 of note onsets of the first take, and of the best after each one
            in another way, and after each sweep.
    """

    def __init__(
        self,
        view: View,
        rng: np.random.Generator,
        config: PlannerConfig,
        num_threads: int,
        progress: Progress = silent,
    ) -> None:
        """Args:
            view: of the first step, of one environment.
            rng: what is random.
            config: how to plan.
            num_threads: that share the work.
            progress: is told of "fingers" and "postures".

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        (track,), start = view.tracks, view.state.hand_qpos[0]
        self._threads = Threads(num_threads)
        self._first = InitialTrajectories(track, start, config, rng, self._threads, progress)
        self._version, self.take = self._first.best
        self._about = _digest(self.plan, start, self._first.seed, config)
        dt = track.config.control_timestep
        self._around, self._apart, between = (
            steps_in(seconds, dt) for seconds in (_AROUND, _APART, _BETWEEN)
        )
        self._between, self._window, self._advance = between, _WINDOW * between, _ADVANCE * between
        self._ahead = self._window + _AFTER * between
        self.num_steps = self.plan.goals.num_steps
        self._tries = np.zeros_like(self.take.loss)
        self._units = self.simulated = 0
        self.at: list[int] = []
        self.history: list[tuple[float, float, float]] = []
        self._moments: Snapshots = {}
        self._sweep: _Sweep | None = None

    @property
    def plan(self) -> SongPlan:
        """Of the whole song, in the best way so far, before practice."""
        return self._version.plan

    @property
    def hands(self) -> list[HandPractice]:
        """That practise."""
        return self._version.hands

    @property
    def plays_another_take(self) -> bool:
        """Whether the song is being played from its beginning once more."""
        return self._first.plays_another_take

    @property
    def effort(self) -> float:
        """That has been made."""
        return self.simulated / self._steps_of(1.0)

    def share_made(self, effort: float) -> float:
        """Of that effort, 0 to 1; with nothing left to mend it is made."""
        if self.history and not self._has_work(effort):
            return 1.0
        return min(self.simulated / max(self._steps_of(effort), 1.0), 1.0)

    def how_far(self, effort: float) -> tuple[str, int, int]:
        """What is being done for that effort, how much of it is done, and of how much in all.

        Steps of the first take, which is no part of the effort; per cent; and steps of what has
        begun when the effort is made.
        """
        if not self.history:
            return "first take", self._first.played, self.num_steps
        if self.effort >= effort and self._first.is_playing:
            return "finishing a take", self._first.played, self.num_steps
        if self.effort >= effort and self._sweep:
            return "finishing a sweep", self._sweep.first, self.num_steps
        return "practising", int(100 * self.share_made(effort)), 100

    def _steps_of(self, effort: float) -> float:
        return effort * EFFORT * self.take.loss.size

    def _has_work(self, effort: float) -> bool:
        if self._first.is_playing or self._sweep:
            return True
        return self.effort < effort and bool(self.take.loss.any())

    def losing(self) -> list[int]:
        """The steps that lose something."""
        return np.flatnonzero(self.take.loss.any(axis=1)).tolist()

    def passages(self) -> list[int]:
        """The steps at which passages begin that lose something."""
        losing = np.array(self.losing(), np.intp)
        apart = np.diff(losing, prepend=-self._apart - 1) > self._apart
        return list(map(int, losing[apart]))

    def run(self, effort: float, goes_on: Callable[[], bool] = lambda: True) -> bool:
        """Practises until `effort` has been made, as long as `goes_on`, which is often asked.

        A sweep or a take that has begun is finished first.

        Whether there is nothing more to do.
        """
        while self._has_work(effort):
            if not goes_on():
                return False
            self._practise()
        return True

    def _practise(self) -> None:
        """Does one unit, a second of a core or so."""
        self._units += 1
        if not self._first.over:
            self._play_a_take()
        elif self._sweep is None:
            self._begin_sweep()
        else:
            self._go_on(self._sweep)

    def _play_a_take(self) -> None:
        if was_playing := self._first.is_playing:
            self.at = [self._first.played]
        simulated = self._first.go_on()
        self._version, self.take = self._first.best
        if self.history:
            self.simulated += simulated
        if was_playing and not self._first.is_playing:
            self._note()

    def _note(self) -> None:
        rehearsal = self._version.rehearsal(self.take)
        self.history.append((self.effort, rehearsal.f1, rehearsal.note_onset_f1))

    # Sweeps

    def _begin_sweep(self) -> None:
        weight = np.cumsum((self.take.loss / (1.0 + self._tries)).sum(axis=1))
        share = _SWEEPS[int(self._tries.any())]
        until = self.simulated + self._steps_of(share) * weight / weight[-1]
        self._sweep = _Sweep(0, until, self.take.part(0, self.num_steps))
        self._moments = {0: self._version.stage.beginning()}
        self._extend(self._sweep, 0, self._ahead)

    def _go_on(self, sweep: _Sweep) -> None:
        """Works on the window, or goes on to the next; after the last, the sweep is over."""
        last = min(sweep.first + self._window, self.num_steps)
        lost = self.take.loss[sweep.first : last].any()
        if lost and self.simulated < sweep.until[last - 1]:
            self._mend(sweep, last)
        elif last < self.num_steps:
            first, known = sweep.first + self._advance, sweep.first + self._ahead
            self._extend(sweep, known, known + self._advance)
            self._moments = {step: m for step, m in self._moments.items() if step >= first}
            self._sweep = sweep._replace(first=first)
        else:
            self._end(sweep)

    def _end(self, sweep: _Sweep) -> None:
        """Of a sweep, which is undone if the song is played worse than before.

        What is played with more onsets in time, but a lower F1, is worse.
        """
        before, now = map(self._version.rehearsal, (sweep.before, self.take))
        cheaper = self.take.cost.sum() < sweep.before.cost.sum()
        if not now.no_worse_than(before) or (now.worth == before.worth and not cheaper):
            self.take = sweep.before
        self._sweep = None
        self._note()

    def _extend(self, sweep: _Sweep, first: int, last: int) -> None:
        """Plays the take anew from one step to another, from where the hands have come to.

        If that is not where they were, they search for what sounded before the sweep.
        """
        if first >= self.num_steps:
            return
        before = sweep.before
        if (self.take.ctrl[:first] == before.ctrl[:first]).all():
            self._put(first, *self._played(self.take, first, last))
            return
        version = self._version
        version.follow(before, first, [self._rng(i) for i in range(len(version.parts))])
        self._put(first, *self._played(self.take, first, last, version.searching.act))
        self.simulated += version.searching.simulated

    def _mend(self, sweep: _Sweep, last: int) -> None:
        """Has each hand that loses something in the window up to `last` try to lose less."""
        first = sweep.first
        weight = self.take.loss[first:last] / (1.0 + self._tries[first:last])
        ahead = min(first + self._ahead, self.num_steps)
        losing = np.flatnonzero(weight.any(axis=0)).tolist()
        attempts: dict[int, Attempt] = {}
        hands = self.hands

        def attempt(i: int) -> None:
            attempts[i] = hands[i].attempt(
                self.take, first, weight[:, i], ahead, self._before_step, self._rng(i)
            )

        self._threads.for_each(losing, attempt)
        self.at = [attempts[i].step for i in losing]
        self.simulated += sum(attempts[i].simulated for i in losing)
        found = {i: change for i in losing if (change := attempts[i].change)}
        lost = {i: self.take.loss[attempts[i].first : ahead, i].sum() for i in losing}
        # Together, or else one of them.
        for changes in [found, *({i: found[i]} for i in found if len(found) > 1)]:
            if changes and self._keep(changes, ahead, sweep.before):
                break
        for i, (step, begin, *_) in attempts.items():
            if self.take.loss[begin:ahead, i].sum() >= lost[i]:
                self._tries[max(step - self._around, 0) : step + self._around + 1, i] += 1

    def _keep(self, changes: Mapping[int, Change], last: int, before: Trajectory) -> bool:
        """Puts changes by hands in, if all from there to `last` is cheaper then.

        For note onsets they may give up what F1 has risen by up to there, compared with `before`.
        """
        first = min(change.first for change in changes.values())
        first -= first % self._between
        take = self.take.part(0, last)
        for i, (begin, ctrl, expected) in changes.items():
            rows, servos = slice(begin, begin + len(ctrl)), self.hands[i].servos
            take.ctrl[rows, servos], take.expected[rows, servos] = ctrl, expected
        played, moments = self._played(take, first, last)
        if not played.cost.sum() < self.take.cost[first:last].sum():
            return False
        kept = self.take.sounding
        now, then = self._f1(played.sounding, first), self._f1(kept[first:last], first)
        earlier = self._f1(kept[:first], 0) - self._f1(before.sounding[:last], 0)
        if now < then and now + earlier < 0:
            return False
        self._put(first, played, moments)
        return True

    def _played(
        self, take: Trajectory, first: int, last: int, act: Callable[[State], Array] | None = None
    ) -> tuple[Trajectory, Snapshots]:
        """What comes of some steps of a take, from the moment before the first on."""
        simulation, part = self._before_step(first), take.part(first, last)
        self.simulated += part.loss.size
        heard = self.take.heard(first)
        return self._version.stage.play(simulation, first, part, heard, self._between, act)

    def _f1(self, sounding: NDArray[np.bool_], first: int) -> float:
        """Of the steps from `first` on, in sum; `sounding` is (L, K)."""
        wanted = self.plan.goals.keys[first : first + len(sounding)]
        return float(step_metrics(sounding, wanted)[2].sum())

    def _put(self, first: int, played: Trajectory, moments: Snapshots) -> None:
        self.take.put(first, played)
        self._moments |= moments

    def _before_step(self, step: int) -> PlanningSimulation:
        return scene_before(step, self.take, self._moments)

    def _rng(self, hand: int) -> np.random.Generator:
        """Of one hand in this unit."""
        return np.random.default_rng((self._first.seed, self._units, hand))

    # What has come of it

    def best(self) -> Rehearsal:
        """The best so far; within the first take, and within a sweep, with what is left to play."""
        if not self.history:
            return self._first.rehearsal()
        if not self._sweep:
            return self._version.rehearsal(self.take)
        version, known = self._version, min(self._sweep.first + self._ahead, self.num_steps)
        now = version.rehearsal(version.to_the_end(self.take, known, self._moments))
        before = version.rehearsal(self._sweep.before)
        return now if now.no_worse_than(before) else before

    # To go on later

    def state(self) -> dict[str, NDArray[Any]]:
        """All that decides how it goes on, as arrays by name; see `restore`."""
        return _named(self._parts(self._sweep) | self._first.parts())

    def _parts(self, sweep: _Sweep | None) -> Parts:
        parts: Parts = {
            "practice": {
                "of": self._about,
                "history": np.reshape(self.history, (-1, 3)),
                "numbers": [self._units, self.simulated],
                "tries": self._tries,
            },
            "take": self.take._asdict(),
        }
        if sweep:
            facts = {"first": sweep.first, "until": sweep.until}
            parts |= {"sweep": facts, "before": sweep.before._asdict()}
        return parts

    def expected(self) -> Expected:
        """What `state` holds, for whoever reads it from a file."""
        sweep = _Sweep(0, np.zeros(self.num_steps), self.take)
        at_times = _named(self._parts(sweep) | self._first.parts(everything=True))
        bounds: Bounds = {
            "practice/numbers": (0, np.inf),
            "practice/tries": (0, np.inf),
            "sweep/first": (0, self.num_steps - 1),
            **self._first.bounds,
        }
        return {
            name: ArrayOf(
                kind := values.dtype.kind,
                values.shape,
                needed=name.partition("/")[0] in _ALWAYS,
                finite=kind in FLOATS,
                within=first_fitting(name, bounds),
            )
            for name, values in at_times.items()
        } | {"practice/history": ArrayOf(FLOATS, ("sweeps", 3), needed=True, finite=True)}

    def check_is_of(self, arrays: Mapping[str, NDArray[Any]], where: object) -> None:
        """Raises: CadenzaError: `arrays` of a `state`, if only `OF`, are of another practice."""
        if str(arrays["practice/of"]) != self._about:
            raise CadenzaError(
                f"{where}: is the practice of another song, or with other options or another "
                "version of Cadenza; choose another folder with --output"
            )

    def restore(self, arrays: Mapping[str, NDArray[Any]], where: object) -> None:
        """Goes on from the `state` of the same practice, see `check_is_of`, as `expected`.

        Raises:
            CadenzaError: parts of it are missing.
        """
        try:
            self._restore(arrays)
        except (LookupError, OverflowError, TypeError, ValueError) as error:
            raise CadenzaError(
                f"{where}: damaged, parts of it are missing; delete it to practise from the start"
            ) from error

    def _restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        parts: Parts = defaultdict(dict)
        for path, values in arrays.items():
            part, _, name = path.partition("/")
            parts[part][name] = values.copy()
        practice = parts["practice"]
        self.history = [tuple(row) for row in practice["history"].tolist()]
        self._units, self.simulated = practice["numbers"].tolist()
        self._tries = practice["tries"]
        self._first.restore(parts, Trajectory(**parts["take"]))
        self._version, self.take = self._first.best
        if sweep := parts["sweep"]:
            self._restore_sweep(int(sweep["first"]), sweep["until"], Trajectory(**parts["before"]))

    def _restore_sweep(self, first: int, until: Array, before: Trajectory) -> None:
        if first % self._between:
            raise ValueError(f"no window begins at step {first}")
        self._sweep, stage = _Sweep(first, until, before), self._version.stage
        # Snapshots take much memory: none is kept of what comes before.
        here = scene_before(first, self.take, {0: stage.beginning()})
        known = self.take.part(first, min(first + self._ahead, self.num_steps))
        _, self._moments = stage.play(here, first, known, self.take.heard(first), self._between)


def _named(parts: Parts) -> dict[str, NDArray[Any]]:
    """As "part/name"."""
    return {
        f"{part}/{name}": np.array(value)
        for part, values in parts.items()
        for name, value in values.items()
    }


def _digest(plan: SongPlan, start: Array, seed: int, config: PlannerConfig) -> str:
    """Of all that practice begins with."""
    task, scene = plan.track.config, plan.track.scene.config
    physics = {"physics": scene.physics, "sleeping_keys": scene.sleeping_keys}
    options = options_of(task, scene, seed, **physics)
    chosen = json.dumps([seed, options, identity(config)], sort_keys=True)
    digest = hashlib.sha256(chosen.encode())
    for values in (*plan.nominal.tracking, plan.goals.keys, start):
        digest.update(values.tobytes())
    return digest.hexdigest()
