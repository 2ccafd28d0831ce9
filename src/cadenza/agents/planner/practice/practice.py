"""Practice of a song: two hands play it, go back to their faults, and keep improvements.

First come the initial trajectories: the song as the planner plays it, then variants, and the best
of all spliced together. From the best one on, practice goes over the song in sweeps. A *sweep*
works on one window of two seconds after the other, from the beginning to the end. Each hand refines
its strikes once, then draws a step with a loss and searches for an improvement (`hand_practice`),
which is kept if the cost of that window and the next second falls in the whole scene.

Even with feedback, the smallest change has effects for seconds. Therefore the steps that follow are
rolled out anew from the state that the hands have reached, with a search where they would miss keys
that sounded before. A sweep that ends with a lower score is undone.

Effort is counted in simulated control steps, so that the same effort has the same result on every
machine, and with any number of threads.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, steps_in
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.practice.hand_practice import Attempt, ChangedControls, HandPractice
from cadenza.agents.planner.practice.initial_trajectories import InitialTrajectories, Parts
from cadenza.agents.planner.practice.practised_planner import PracticeResult
from cadenza.agents.planner.practice.trajectory import Snapshots, Trajectory, scene_before
from cadenza.errors import CadenzaError
from cadenza.files import ANY, read_tensors, write_tensors
from cadenza.music.metrics import step_metrics
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State
from cadenza.tasks.config import task_identity
from cadenza.tasks.view import View

EFFORT = 100  # control steps that each hand simulates for each step of the song at effort 1
_FIRST_SWEEP, _SWEEP = 0.5, 1.0  # effort: the first sweep mends easy faults, and is over sooner
_APART = 0.5  # [s] between passages
_INTERVAL = 0.5  # [s] between snapshots, at which rollouts can begin
_WINDOW = 4  # intervals that are worked on at a time
_STRIDE = 3  # intervals from one window to the next
_AFTER = 2  # intervals after a window whose cost counts, too
_AROUND = 0.15  # [s] before and after a step that share its failed attempts
_MAX_BYTES = 2**32  # of a file: hours of music


class _Sweep(NamedTuple):
    first: int  # the step at which the current window begins
    refined: int  # the step up to which strikes have been refined
    # (T,) number of simulated control steps at which a window that ends with each step is left
    until: Array
    before: Trajectory  # the trajectory when the sweep began


class Practice:
    """Practice of one song.

    Attributes:
        trajectory: the best so far; steps that have not been played yet are the plan's.
        current_steps: the steps that were worked on last.
        num_steps: the number of control steps of the song.
        simulated: the control steps of a hand, in all, after the first trajectory.
        history: effort, F1 and note onset F1 of the first trajectory, and of the best one after
            each variant and each sweep.
    """

    def __init__(self, view: View, rng: np.random.Generator, context: PlanningContext) -> None:
        """Plan the song, from the view before the first step of one environment.

        Raises CadenzaError if there are no hands in the scene.
        """
        (track,), start = view.tracks, view.state.hand_qpos[0]
        self._threads = context.threads
        self._initial = InitialTrajectories(track, start, rng, context)
        self._planned, self.trajectory = self._initial.best
        self._identity = _digest(self.plan, start, self._initial.seed, context.config)
        dt = track.config.control_timestep
        self._around, self._apart = steps_in(_AROUND, dt), steps_in(_APART, dt)
        self._interval = steps_in(_INTERVAL, dt)
        self._window, self._stride, self._after = (
            intervals * self._interval for intervals in (_WINDOW, _STRIDE, _AFTER)
        )
        self._reach = self._window + self._after
        self.num_steps = self.plan.goals.num_steps
        self._num_failed = np.zeros_like(self.trajectory.loss)
        self._num_units = self.simulated = 0
        self.current_steps: list[int] = []
        self.history: list[tuple[float, float, float]] = []
        self._snapshots: Snapshots = {}
        self._sweep: _Sweep | None = None

    @property
    def plan(self) -> SongPlan:
        """The plan of the best variant so far, before practice."""
        return self._planned.plan

    @property
    def plays_variant(self) -> bool:
        """Whether the song is being played from its beginning once more."""
        return self._initial.plays_variant

    @property
    def effort(self) -> float:
        """The effort made so far."""
        return self.simulated / self._steps_of(1.0)

    def share_made(self, effort: float) -> float:
        """Share of an effort that has been made, 0 to 1; 1 if there is nothing left to improve."""
        if self.history and not self._has_work(effort):
            return 1.0
        return min(self.simulated / max(self._steps_of(effort), 1.0), 1.0)

    def progress(self, effort: float) -> tuple[str, int, int]:
        """The stage of practice, the amount done, and the total.

        The unit is steps for the first trajectory, which is no part of the effort; then per cent of
        the effort; and steps for a trajectory or a sweep that goes on after it.
        """
        if not self.history:
            return "first take", self._initial.num_played, self.num_steps
        if self.effort >= effort and self._initial.is_playing:
            return "finishing a take", self._initial.num_played, self.num_steps
        if self.effort >= effort and self._sweep:
            return "finishing a sweep", self._sweep.first, self.num_steps
        return "practising", int(100 * self.share_made(effort)), 100

    def _steps_of(self, effort: float) -> float:
        return effort * EFFORT * self.trajectory.loss.size

    def _has_work(self, effort: float) -> bool:
        if self._initial.is_playing or self._sweep:
            return True
        return self.effort < effort and bool(self.trajectory.all_loss.any())

    def steps_with_faults(self) -> list[int]:
        """The steps with a missed or an extra note."""
        return np.flatnonzero(self.trajectory.faults.any(axis=1)).tolist()

    def passages_with_faults(self) -> list[int]:
        """The first step of each passage with such a note."""
        steps = np.array(self.steps_with_faults(), np.intp)
        apart = np.diff(steps, prepend=-self._apart - 1) > self._apart
        return list(map(int, steps[apart]))

    def run(self, effort: float, goes_on: Callable[[], bool] = lambda: True) -> bool:
        """Practise until `effort` has been made, while `goes_on` returns true.

        A sweep or a trajectory that has begun is finished first. Returns whether practice is done.
        """
        while self._has_work(effort):
            if not goes_on():
                return False
            self._run_unit()
        return True

    def _run_unit(self) -> None:
        """Do a second or so of work for one core."""
        self._num_units += 1
        if not self._initial.over:
            self._advance_initial()
        elif self._sweep is None:
            self._begin_sweep()
        else:
            self._advance_sweep(self._sweep)

    def _advance_initial(self) -> None:
        if was_playing := self._initial.is_playing:
            self.current_steps = [self._initial.num_played]
        simulated = self._initial.advance()
        self._planned, self.trajectory = self._initial.best
        if self.history:
            self.simulated += simulated
        if was_playing and not self._initial.is_playing:
            self._record()

    def _record(self) -> None:
        result = self._planned.result(self.trajectory)
        self.history.append((self.effort, result.f1, result.note_onset_f1))

    # Sweeps

    def _begin_sweep(self) -> None:
        weight = np.cumsum((self.trajectory.all_loss / (1.0 + self._num_failed)).sum(axis=1))
        share = _SWEEP if self._num_failed.any() else _FIRST_SWEEP
        until = self.simulated + self._steps_of(share) * weight / weight[-1]
        self._sweep = _Sweep(0, 0, until, self.trajectory.copied())
        self._snapshots = {0: self._planned.scene.at_start()}
        self._replay(self._sweep, 0, self._reach)

    def _advance_sweep(self, sweep: _Sweep) -> None:
        """Work on the window, or go on to the next; after the last, the sweep is over."""
        last = min(sweep.first + self._window, self.num_steps)
        strikes = self.trajectory.strike_loss[max(sweep.first, sweep.refined) : last]
        lossy = self.trajectory.all_loss[sweep.first : last].any()
        if strikes.any():
            self._refine(sweep, last)
        elif lossy and self.simulated < sweep.until[last - 1]:
            self._improve(sweep, last)
        elif last < self.num_steps:
            first, end = sweep.first + self._stride, sweep.first + self._reach
            self._replay(sweep, end, end + self._stride)
            self._snapshots = {step: s for step, s in self._snapshots.items() if step >= first}
            self._sweep = sweep._replace(first=first)
        else:
            self._end_sweep(sweep)

    def _end_sweep(self, sweep: _Sweep) -> None:
        """End a sweep, and undo it if note onset F1 or the score is lower than before."""
        before, after = map(self._planned.result, (sweep.before, self.trajectory))
        cheaper = self.trajectory.cost.sum() < sweep.before.cost.sum()
        if not after.no_worse_than(before) or (after.score == before.score and not cheaper):
            self.trajectory = sweep.before
        self._sweep = None
        self._record()

    def _replay(self, sweep: _Sweep, first: int, last: int) -> None:
        """Roll the trajectory out anew between two steps, from the state that hands have reached.

        If the trajectory has changed up to there, they search for the keys that sounded before the
        sweep.
        """
        if first >= self.num_steps:
            return
        before, planned = sweep.before, self._planned
        if (self.trajectory.ctrl[:first] == before.ctrl[:first]).all():
            self._overwrite(first, *self._roll_out(self.trajectory, first, last))
            return
        planned.follow(before, first, [self._rng(i) for i in range(len(planned.goals))])
        self._overwrite(first, *self._roll_out(self.trajectory, first, last, planned.search.act))
        self.simulated += planned.search.simulated

    def _refine(self, sweep: _Sweep, last: int) -> None:
        """Let each hand refine its strikes up to `last`, once in a sweep."""
        first, end = max(sweep.first, sweep.refined), min(last + self._after, self.num_steps)
        strikes = self.trajectory.strike_loss[first:last]
        self._sweep = sweep._replace(refined=last)
        self._attempt(
            np.flatnonzero(strikes.any(axis=0)).tolist(),
            end,
            lambda hand, _: hand.refine(self.trajectory, first, last, end, self._scene_before),
        )

    def _improve(self, sweep: _Sweep, last: int) -> None:
        """Let each hand with a loss in the window up to `last` try to lower it."""
        first = sweep.first
        weight = self.trajectory.all_loss[first:last] / (1.0 + self._num_failed[first:last])
        end = min(first + self._reach, self.num_steps)
        loss = self.trajectory.all_loss[:end].copy()
        attempts = self._attempt(
            np.flatnonzero(weight.any(axis=0)).tolist(),
            end,
            lambda hand, i: hand.attempt(
                self.trajectory, first, weight[:, i], end, self._scene_before, self._rng(i)
            ),
        )
        for i, (step, begin, *_) in attempts.items():
            if self.trajectory.all_loss[begin:end, i].sum() >= loss[begin:, i].sum():
                around = slice(max(step - self._around, 0), step + self._around + 1)
                self._num_failed[around, i] += 1

    def _attempt(
        self, hands: list[int], end: int, attempt_of: Callable[[HandPractice, int], Attempt]
    ) -> dict[int, Attempt]:
        """Let `hands` make an attempt each, and keep changes that lower the cost up to `end`."""
        attempts: dict[int, Attempt] = {}

        def attempt(i: int) -> None:
            attempts[i] = attempt_of(self._planned.hands[i], i)

        self._threads.for_each(hands, attempt)
        self.current_steps = [attempts[i].step for i in hands]
        self.simulated += sum(attempts[i].simulated for i in hands)
        both = {i: change for i in hands if (change := attempts[i].change)}
        for changes in [both, *({i: both[i]} for i in both if len(both) > 1)]:
            if changes and self._accept(changes, end):
                break
        return attempts

    def _accept(self, changes: Mapping[int, ChangedControls], last: int) -> bool:
        """Make changes of hands, if they lower the cost up to `last` in the whole scene.

        They may not add faults, and may only lower F1 if they remove some. Returns whether they
        were made.
        """
        first = min(change.first for change in changes.values())
        first -= first % self._interval
        candidate, sounding = self.trajectory.segment(0, last), self.trajectory.sounding
        for i, (begin, ctrl, expected) in changes.items():
            rows, servos = slice(begin, begin + len(ctrl)), self._planned.hands[i].servos
            candidate.ctrl[rows, servos], candidate.expected[rows, servos] = ctrl, expected
        played, snapshots = self._roll_out(candidate, first, last)
        if not played.cost.sum() < self.trajectory.cost[first:last].sum():
            return False
        faults_removed = int(self.trajectory.faults[first:last].sum() - played.faults.sum())
        f1_gain = self._f1(played.sounding, first) - self._f1(sounding[first:last], first)
        if faults_removed < 0 or f1_gain + self._planned.scene.fault * faults_removed < 0:
            return False
        self._overwrite(first, played, snapshots)
        return True

    def _roll_out(
        self,
        trajectory: Trajectory,
        first: int,
        last: int,
        act: Callable[[int, State], Array] | None = None,
    ) -> tuple[Trajectory, Snapshots]:
        """Roll out some steps of a trajectory from the scene before the first of them."""
        played, snapshots = self._planned.scene.roll_out(
            trajectory, self._snapshots, first, last, self._interval, act
        )
        self.simulated += played.loss.size
        return played, snapshots

    def _f1(self, sounding: NDArray[np.bool_], first: int) -> float:
        """The sum of F1 over the steps from `first` on in which `sounding` (L, K) sounds."""
        target = self.plan.goals.keys[first : first + len(sounding)]
        return float(step_metrics(sounding, target)[2].sum())

    def _overwrite(self, first: int, played: Trajectory, snapshots: Snapshots) -> None:
        self.trajectory.overwrite(first, played)
        self._snapshots |= snapshots

    def _scene_before(self, step: int) -> PlanningSimulation:
        return scene_before(step, self.trajectory, self._snapshots)

    def _rng(self, hand: int) -> np.random.Generator:
        return np.random.default_rng((self._initial.seed, self._num_units, hand))

    # Results

    def best(self) -> PracticeResult:
        """The best so far; within the first trajectory or a sweep, the rest is rolled out first."""
        if not self.history:
            return self._initial.result()
        planned, sweep = self._planned, self._sweep
        if not sweep:
            return planned.result(self.trajectory)
        end = min(sweep.first + self._reach, self.num_steps)
        trajectory = planned.played_to_the_end(self.trajectory, end, self._snapshots)
        now, before = planned.result(trajectory), planned.result(sweep.before)
        return now if now.no_worse_than(before) else before

    # Saving and restoring

    def state(self) -> dict[str, NDArray[Any]]:
        """State from which practice goes on, as arrays by "part/name"."""
        parts: Parts = {
            "practice": {
                "history": np.reshape(self.history, (-1, 3)),
                "numbers": [self._num_units, self.simulated],
                "num_failed": self._num_failed,
            },
            "best": self.trajectory._asdict(),
        }
        if sweep := self._sweep:
            numbers = {"first": sweep.first, "refined": sweep.refined, "until": sweep.until}
            parts |= {"sweep": numbers, "before": sweep.before._asdict()}
        return {
            f"{part}/{name}": np.array(value)
            for part, values in (parts | self._initial.parts()).items()
            for name, value in values.items()
        }

    def save(self, path: Path) -> None:
        """Write the state, for `restore`."""
        write_tensors(path, self.state(), {"practice": self._identity})

    def restore(self, path: Path) -> None:
        """Go on from a saved state of the same practice.

        Raises CadenzaError if the file is of another practice, or damaged.
        """
        arrays, facts = read_tensors(path, ANY, _MAX_BYTES)
        if facts.get("practice") != self._identity:
            raise CadenzaError(
                f"{path}: is the practice of another song, or with other options or another "
                "version of Cadenza; choose another folder with --output"
            )
        try:
            self._restore(arrays)
        except (LookupError, OverflowError, TypeError, ValueError) as error:
            raise CadenzaError(
                f"{path}: parts of it are missing; delete it to practise from the start"
            ) from error

    def _restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        parts: Parts = defaultdict(dict)
        for path, values in arrays.items():
            part, _, name = path.partition("/")
            parts[part][name] = values.copy()
        practice = parts["practice"]
        self.history = [tuple(row) for row in practice["history"].tolist()]
        self._num_units, self.simulated = practice["numbers"].tolist()
        self._num_failed = practice["num_failed"]
        self._initial.restore(parts, Trajectory(**parts["best"]))
        self._planned, self.trajectory = self._initial.best
        if sweep := parts["sweep"]:
            before = Trajectory(**parts["before"])
            first, refined = int(sweep["first"]), int(sweep["refined"])
            self._restore_sweep(_Sweep(first, refined, sweep["until"], before))

    def _restore_sweep(self, sweep: _Sweep) -> None:
        first, scene = sweep.first, self._planned.scene
        if first % self._interval:
            raise ValueError(f"no window begins at step {first}")
        self._sweep = sweep
        # Snapshots take much memory: none is kept of earlier steps.
        start = {0: scene.at_start()}
        _, self._snapshots = scene.roll_out(
            self.trajectory, start, first, first + self._reach, self._interval
        )


def _digest(plan: SongPlan, start: Array, seed: int, config: PlannerConfig) -> str:
    """A digest of the song, the options and the plan with which practice begins."""
    options = task_identity(plan.track.config, plan.track.scene.config, seed)
    text = json.dumps({"seed": seed, "task": options, "planner": asdict(config)}, sort_keys=True)
    digest = hashlib.sha256(text.encode())
    for values in (*plan.nominal.tracking, plan.goals.keys, start):
        digest.update(values.tobytes())
    return digest.hexdigest()
