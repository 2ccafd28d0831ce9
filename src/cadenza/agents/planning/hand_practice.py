"""A hand practises: it plays its part by itself, goes back to what failed, keeps what is better.

What it has played is a *take*: controls, and what came of them, step by step. The first is what
the planner plays. Then the hand goes over the song again and again. A *sweep* works on two seconds
after two seconds, from the beginning to the end: it picks a step that loses something, begins a
little before it, tries many variations of the take in simulation, and puts the best of them
into the take if that and what comes after it are better for it. The smallest change is felt for
seconds, however feedback leads back to the take; therefore what follows is always played anew from
where the hand has really come to, and a sweep that comes to a worse end is undone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.control_steps import steps_in
from cadenza.agents.planning.losses import Heard, Losses
from cadenza.agents.planning.refinement import HandPart, HandRefinement, Here
from cadenza.agents.planning.song_plan import SongPlan
from cadenza.agents.planning.tracking import Follower
from cadenza.agents.planning.variations import Variations
from cadenza.files import ArrayOf, Expected
from cadenza.fingers import SIDES, Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CANDIDATES = 24  # variations that are tried in a unit
_KEPT_STATES = 0.5  # [s] between the states of a take in which playing can begin
_CHUNK = 2.0  # [s] of the first take in a unit
_WINDOW = 4  # times this are worked on at a time
_ADVANCE = 3  # times this later begins the next window
_AFTER = 2  # times this after a window must not suffer
_BEFORE = 0.6  # [s] at most that a variation begins before what it is to mend
_BEYOND = 0.6  # [s] for which it is judged after it
_UNSTABLE = 1000.0  # what a step costs after which the simulation is of no more use
_AROUND = 0.15  # [s] before and after a step that share its failures


class Take(NamedTuple):
    """What a hand has played over T steps with A servos, by itself."""

    ctrl: Array
    """(T, A)"""
    expected: Array
    """(T, A, 2) position and speed of each servo before the step."""
    sounding: Mask
    """(T, K) after it, as all that follows."""
    loss: Array
    """(T,) see `Losses`."""
    cost: Array
    """(T,)"""

    def part(self, first: int, last: int) -> Take:
        """A copy of the steps from `first` up to, not including, `last`."""
        return Take._make(values[first:last].copy() for values in self)

    def put(self, first: int, part: Take) -> None:
        """Replaces the steps from `first` on."""
        for values, new in zip(self, part, strict=True):
            values[first : first + len(new)] = new


class _Sweep(NamedTuple):
    """How far a hand has gone over the song."""

    first: int
    """Step at which the window begins that is worked on."""
    until: Array
    """(T,) simulated control steps after which a window is left that ends with each step."""
    before: Take
    """The take when it began."""
    states: Array
    """Those of that take."""


class HandPractice:
    """One hand's practice of a song.

    Attributes:
        servos: those of the hand among all.
        gain: (T, A, 2) of the feedback that leads back to the take.
        take: what it plays; of steps that it has not played yet, what the plan expects.
        at: the step that was worked on last.
        simulated: control steps, in all, after the first take.
    """

    def __init__(
        self,
        plan: SongPlan,
        start: Array,
        side: Side,
        config: ScorePlannerConfig,
        seed: int,
    ) -> None:
        """Args:
        plan: of the whole song.
        start: (J,) joint positions of the hands where the song begins [m, rad].
        side: of the hand.
        config: how the first take is planned.
        seed: of everything random.
        """
        dt = plan.track.config.control_timestep
        alone, self.servos, joints = hand_alone(plan.scene, side)
        part, tracking = HandPart(plan, side), plan.nominal.tracking.of(self.servos)
        self.gain = tracking.gain
        self._seed = (seed, SIDES.index(side))
        self._planner = HandRefinement(
            alone,
            part,
            tracking,
            config,
            dt,
            np.random.default_rng(self._seed),
            Threads(1),
        )
        servos = servos_of(alone)
        self._low, self._high = servos.low, servos.high
        self._to_posture = Follower(alone, tracking).posture
        self._part, self._losses = part, Losses(plan, part)
        self._slides = servos.along_keyboard
        self._variations = Variations(alone, tracking.expected[:, :, 0], dt)
        self._one = PlanningSimulation(alone, 1, dt)
        self._trials = self._planner.trials
        self._before, self._beyond = steps_in(_BEFORE, dt), steps_in(_BEYOND, dt)
        self._around, self._chunk = steps_in(_AROUND, dt), steps_in(_CHUNK, dt)
        self._between = between = steps_in(_KEPT_STATES, dt)
        self._window, self._advance = _WINDOW * between, _ADVANCE * between
        self._ahead = self._window + _AFTER * between
        self.num_steps = steps = len(tracking.ctrl)
        keys, start = part.mine.shape[1], start[joints]
        self.take = Take(
            tracking.ctrl.copy(),
            tracking.expected[:-1].copy(),
            np.zeros((steps, keys), bool),
            np.zeros(steps),
            np.zeros(steps),
        )
        self._planner.twin.place(start, np.zeros_like(start), np.zeros(keys))
        self._here = self._planner.here
        self._states = np.zeros((steps // between + 1, len(self._here.state)))
        self._tries = np.zeros(steps)
        self._units = self.simulated = self.at = 0
        self._sweep: _Sweep | None = None

    @property
    def played(self) -> int:
        """How many steps the first take has so far."""
        return self._here.step

    def has_work(self, most: float) -> bool:
        """Whether there is something to do before it has simulated so many control steps."""
        if self.played < self.num_steps or self._sweep:
            return True
        return self.simulated < most and bool(self.take.loss.any())

    # To go on later

    @property
    def state(self) -> dict[str, NDArray[Any]]:
        """All that decides how practice goes on, as arrays by name; see `restore`."""
        parts: dict[str, dict[str, Any]] = {
            "take": self.take._asdict(),
            "here": self._here._asdict(),
            "hand": {
                "states": self._states,
                "tries": self._tries,
                "units": self._units,
                "simulated": self.simulated,
            },
        }
        arrays = _named(parts)
        return arrays | (_state_of(self._sweep) if self._sweep else {})

    @property
    def expected(self) -> Expected:
        """What `state` holds, for whoever reads it from a file."""
        in_a_sweep = _state_of(_Sweep(0, np.zeros(self.num_steps), self.take, self._states))
        return {
            name: ArrayOf(values.dtype.kind, values.shape, name not in in_a_sweep, finite=True)
            for name, values in (self.state | in_a_sweep).items()
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Goes on from the `state` of the same practice."""

        def part(of: str) -> dict[str, Any]:
            named = {name.partition("/"): value for name, value in state.items()}
            return {name: value.copy() for (part, _, name), value in named.items() if part == of}

        self.take, here, hand, sweep = Take(**part("take")), *map(part, ("here", "hand", "sweep"))
        step, savings = int(here["step"]), float(here["savings"])
        self._here = Here(step, here["state"], here["correction"], savings)
        self._states, self._tries = hand["states"], hand["tries"]
        self._units, self.simulated = int(hand["units"]), int(hand["simulated"])
        self._sweep = None
        if sweep:
            first, before = int(sweep["first"]), Take(**part("before"))
            self._sweep = _Sweep(first, sweep["until"], before, sweep["states"])

    # Practice

    def practise(self, most: float) -> None:
        """Does one unit, about half a second of a core, of those before `most` control steps."""
        rng = np.random.default_rng((*self._seed, self._units))
        self._units += 1
        if self.played < self.num_steps:
            self._play_on(rng)
        elif self._sweep is None:
            self._sweep = self._begin_sweep(most)
        else:
            self._sweep = self._go_on(self._sweep, rng)

    def _play_on(self, rng: np.random.Generator) -> None:
        """Adds a chunk to the first take."""
        planner, first = self._planner, self.played
        planner.go_to(self._here, rng)
        heard = self._heard(first)
        self.at = first
        for row in range(first, min(first + self._chunk, self.num_steps)):
            if row % self._between == 0:
                self._states[row // self._between] = planner.twin.physics_state(0)
            here = self._posture(planner.twin)
            ctrl = planner.play_on()
            step, heard = self._judged(planner.twin, row, heard)
            self.take.put(row, Take(ctrl[None], here[None], *step))
        self._here = planner.here

    def _begin_sweep(self, most: float) -> _Sweep:
        weight = np.cumsum(self.take.loss / (1.0 + self._tries))
        until = self.simulated + (most - self.simulated) * weight / weight[-1]
        sweep = _Sweep(0, until, self.take.part(0, self.num_steps), self._states.copy())
        self._extend(0, self._ahead)
        return sweep

    def _go_on(self, sweep: _Sweep, rng: np.random.Generator) -> _Sweep | None:
        """Works on the window, or goes on to the next; None after the last."""
        last = min(sweep.first + self._window, self.num_steps)
        loss = self.take.loss[sweep.first : last]
        if loss.any() and self.simulated < sweep.until[last - 1]:
            self._mend(sweep.first, loss, rng)
            return sweep
        if last < self.num_steps:
            known = sweep.first + self._ahead
            self._extend(known, known + self._advance)
            return sweep._replace(first=sweep.first + self._advance)
        if self.take.cost.sum() > sweep.before.cost.sum():
            self.take, self._states = sweep.before, sweep.states
        return None

    def _extend(self, first: int, last: int) -> None:
        """Plays the take anew from one step to another, from where the hand has come to."""
        if first < self.num_steps:
            self._put(first, *self._played(self.take.part(first, last), first))

    def _mend(self, first: int, loss: Array, rng: np.random.Generator) -> None:
        """Tries to lose less at a step that is drawn, the likelier the more it loses.

        Args:
            first: step of the window.
            loss: (L,) of its steps.
            rng: what is random.
        """
        weight = loss / (1.0 + self._tries[first : first + len(loss)])
        step = self.at = first + int(rng.choice(len(loss), p=weight / weight.sum()))
        begin = max(step - int(rng.integers(1, self._before + 1)), first)
        last = min(begin + self._variations.length(rng), self.num_steps)
        ahead = min(first + self._ahead, self.num_steps)
        end = min(max(last, step + 1) + self._beyond, ahead)
        path, lost = self.take.expected[:, :, 0], self.take.loss[begin:ahead].sum()
        offsets = self._variations.draw(path, begin, last, _CANDIDATES, rng)
        self._go_to(begin)
        better = self._best_of(offsets, begin, end)
        kept = better is not None and self._keep(better, begin, ahead)
        if not kept or self.take.loss[begin:ahead].sum() >= lost:
            self._tries[max(step - self._around, 0) : step + self._around + 1] += 1

    def _best_of(self, offsets: Array, first: int, end: int) -> Take | None:
        """The cheapest variation of the steps from `first` to `end`, if one is cheaper than they.

        Only `ctrl` and `expected` of what is returned mean anything.

        Args:
            offsets: (N, L, A) to the positions of the servos after each of the first L steps.
        """
        self._begin_trials(offsets, first, end)
        best, most = None, float(self.take.cost[first:end].sum())
        for each in np.pad(offsets, ((0, 0), (1, end - first - offsets.shape[1]), (0, 0))):
            tried = self.take.part(first, end)
            cost = self._try(each, tried, first, most)
            if cost < most:
                best, most = tried, cost
        return best

    def _begin_trials(self, offsets: Array, first: int, end: int) -> None:
        """From where the one simulation is, over all keys on the way."""
        tips = self._part.fingertips[first : end + 1, :, 1]
        here = self._one.state.fingertip_xpos[0, self._part.fingers, 1]
        low, high = (edge(np.append(tips, here)) for edge in (np.min, np.max))
        slides = offsets[..., self._slides]
        self._trials.begin_from(
            self._one, low + min(slides.min(), 0.0), high + max(slides.max(), 0.0)
        )

    def _try(self, offsets: Array, take: Take, first: int, most: float) -> float:
        """What steps of a take cost, with offsets (L + 1, A) to where servos are before each.

        Infinite where they cost `most` or more. They are written to the `take`.
        """
        trials = self._trials

        def controls() -> Iterator[Array]:
            for k, row in enumerate(range(first, first + len(take.ctrl))):
                here = self._to_posture(*trials.hand_joints())
                off = here - take.expected[k]
                off[:, 0] -= offsets[k]
                take.expected[k] = here
                take.ctrl[k] = self._clip(take.ctrl[k] - self._feedback(row, off) + offsets[k + 1])
                yield take.ctrl[k]

        cost, heard = 0.0, self._heard(first).of(trials.keys)
        for k, (key_qpos, fingertips) in enumerate(trials.run(controls())):
            self.simulated += 1
            judged = self._losses.after(first + k, key_qpos, fingertips, heard, trials.keys)
            _, more, heard = judged
            cost += more
            if cost >= most:
                return np.inf
        return np.inf if trials.unstable() else cost

    def _keep(self, better: Take, first: int, last: int) -> bool:
        """Puts `better` in from `first` on, if it and the rest up to `last` are cheaper then."""
        begin = first - first % self._between
        take = self.take.part(begin, last)
        take.put(first - begin, better)
        played, states = self._played(take, begin)
        if not played.cost.sum() < self.take.cost[begin:last].sum():
            return False
        self._put(begin, played, states)
        return True

    def _put(self, first: int, played: Take, states: Array) -> None:
        self.take.put(first, played)
        self._states[first // self._between :][: len(states)] = states

    # Playing

    def _played(self, take: Take, first: int) -> tuple[Take, Array]:
        """What comes of playing some steps of a `take`, from the state that was kept at `first`.

        And the states to keep; where one belongs to the end of the last step, that, too.
        """
        one, between, last = self._one, self._between, first + len(take.ctrl)
        states = self._states[first // between : last // between + 1].copy()
        played = take.part(0, len(take.ctrl))
        one.set_physics_state(states[0])
        heard = self._heard(first)
        for k, row in enumerate(range(first, last)):
            if row % between == 0:
                states[k // between] = one.physics_state(0)
            here = self._posture(one)
            ctrl = self._clip(take.ctrl[k] - self._feedback(row, here - take.expected[k]))
            one.step(ctrl[None])
            step, heard = self._judged(one, row, heard)
            played.put(k, Take(ctrl[None], here[None], *step))
        if last % between == 0:
            states[-1] = one.physics_state(0)
        self.simulated += last - first
        return played, states

    def _go_to(self, step: int) -> None:
        """Has the one simulation where the take is before `step`."""
        begin = step - step % self._between
        self._one.set_physics_state(self._states[begin // self._between])
        for row in range(begin, step):
            off = self._posture(self._one) - self.take.expected[row]
            self._one.step(self._clip(self.take.ctrl[row] - self._feedback(row, off))[None])
        self.simulated += step - begin

    def _judged(
        self, simulation: PlanningSimulation, row: int, heard: Heard
    ) -> tuple[tuple[Mask, Array, Array], Heard]:
        """What sounds, is lost and costs after a step, as a row of a take, and what is heard."""
        state = simulation.state
        tips = state.fingertip_xpos[0, self._part.fingers]
        loss, cost, heard = self._losses.after(row, state.key_qpos[0], tips, heard)
        lost = np.array([[loss], [cost]]) + _UNSTABLE * state.unstable
        return (heard.sounding[None], lost[0], lost[1]), heard

    def _posture(self, simulation: PlanningSimulation) -> Array:
        """(A, 2) position and speed of each servo."""
        return self._to_posture(simulation.state.hand_qpos[0], simulation.state.hand_qvel[0])

    def _feedback(self, row: int, off: Array) -> Array:
        """(A,) what deviations (A, 2) before a step take from its controls."""
        return np.asarray((self.gain[row] * off).sum(axis=1))

    def _clip(self, ctrl: Array) -> Array:
        return np.clip(ctrl, self._low, self._high)

    def _heard(self, step: int) -> Heard:
        """Keys of the take before a step."""
        before, earlier = (
            self.take.sounding[row] if row >= 0 else np.zeros_like(self.take.sounding[0])
            for row in (step - 1, step - 2)
        )
        return Heard(before, before & ~earlier)


def _state_of(sweep: _Sweep) -> dict[str, NDArray[Any]]:
    first, until, before, states = sweep
    facts = {"first": first, "until": until, "states": states}
    return _named({"sweep": facts, "before": before._asdict()})


def _named(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
    """Copies of arrays, by the names of their part and their own."""
    return {
        f"{part}/{name}": np.array(value)
        for part, values in parts.items()
        for name, value in values.items()
    }
