"""A hand looks for something better to do where its playing loses something.

It begins a little before what fails, and tries many variations of the take in simulation, by
itself and with the keys near it only. Whether the best of them is of use shows when it is played
in the whole scene, where the other hand may be in the way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Follower
from cadenza.agents.planner.practice.losses import Losses
from cadenza.agents.planner.practice.perturbations import Variations
from cadenza.agents.planner.practice.trajectory import Trajectory
from cadenza.agents.planner.search.fingertip_correction import Correction
from cadenza.agents.planner.search.rollouts import EXPECTED
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import PLACES, HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]

_CANDIDATES = 18  # variations that are drawn
_CORRECTED = (1.0, 2.0, 1.0, 2.0, 0.5, 1.5)  # times the way that fingertips are off, as tried too
_BEFORE = 0.6  # [s] at most that a variation begins before what it is to mend
_BEYOND = 0.6  # [s] for which it is judged after it


class Change(NamedTuple):
    """What a hand with A servos may do for L steps instead of what it does."""

    first: int
    ctrl: Array
    """(L, A)"""
    expected: Array
    """(L, A, 2)"""


class Attempt(NamedTuple):
    """What a hand has looked for and found."""

    step: int
    """Which lost something."""
    first: int
    """Where variations began."""
    change: Change | None
    """The best of them, if one was better than the take."""
    simulated: int
    """Control steps."""


class _Trial(NamedTuple):
    cost: float
    ctrl: Array
    expected: Array
    steps: list[float]
    """What each of the steps that were simulated cost."""
    fingertips: list[Array]
    """(F, 3) after each of them [m]."""
    hand_qpos: list[Array]
    """(J,) likewise [m, rad]."""


class HandPractice:
    """One hand that practises.

    Attributes:
        servos: those of the hand among all.
    """

    def __init__(
        self,
        plan: SongPlan,
        side: Side,
        part: HandGoals,
        threads: Threads,
    ) -> None:
        """Args:
        plan: of the whole song.
        side: of the hand.
        part: what the hand has to do.
        threads: that share trials.
        """
        dt = plan.track.config.control_timestep
        alone, self.servos, _ = hand_alone(plan.scene, side)
        tracking = plan.nominal.tracking.of(self.servos)
        self._slides = servos_of(alone).along_keyboard
        self._gain, self._follower = tracking.gain, Follower(alone, tracking)
        self._part, self._losses, self._threads = part, Losses(plan, part), threads
        self._variations = Variations(alone, tracking.expected[:, :, 0], dt)
        self._toward = Correction(alone)
        self._trials = HandRollouts(alone, dt, plan.scene)
        self._before, self._beyond = steps_in(_BEFORE, dt), steps_in(_BEYOND, dt)
        self._keys = plan.goals.keys

    def attempt(
        self,
        take: Trajectory,
        first: int,
        weight: Array,
        last: int,
        at: Callable[[int], PlanningSimulation],
        rng: np.random.Generator,
    ) -> Attempt:
        """Tries to lose less at a step that is drawn.

        Args:
            take: of both hands.
            first: earliest step to change.
            weight: (L,) of the steps from there on, the more likely they are to be drawn.
            last: up to which variations may be judged.
            at: the scene before a step of the take.
            rng: what is random.
        """
        step = first + int(rng.choice(len(weight), p=weight / weight.sum()))
        if rng.random() < 0.5:
            step = self._since(take, first, step)
        begin = max(step - int(rng.integers(1, self._before + 1)), first)
        changed = min(begin + self._variations.length(rng), last)
        end = min(max(changed, step + 1) + self._beyond, last)
        path, simulation = take.expected[:, self.servos, 0], at(begin)
        offsets = self._variations.draw(path, begin, changed, _CANDIDATES, rng)
        self._begin_trials(simulation, offsets, begin, end)
        best, simulated = self._best_of(offsets, take, begin, end, rng)
        change = Change(begin, best.ctrl, best.expected) if best else None
        return Attempt(step, begin, change, simulated)

    def _since(self, take: Trajectory, first: int, step: int) -> int:
        """The step, from `first` on, since which a key has been wrong that is wrong at `step`."""
        rows = slice(first, step + 1)
        wrong = (take.sounding ^ self._keys)[rows] & (self._part.mine | ~self._keys)[rows]
        fine = ~(wrong & wrong[-1]).any(axis=1)
        return min(first + int(np.append(-1, np.flatnonzero(fine))[-1]) + 1, step)

    def _begin_trials(
        self, simulation: PlanningSimulation, offsets: Array, first: int, end: int
    ) -> None:
        """From where the hand is, over all keys on the way."""
        tips = self._part.fingertips[first : end + 1, :, 1]
        here = simulation.state.fingertip_xpos[0, self._part.fingers, 1]
        low, high = (edge(np.append(tips, here)) for edge in (np.min, np.max))
        slides = offsets[..., self._slides]  # of hands that slide
        self._trials.begin_from(
            simulation, low + slides.min(initial=0.0), high + slides.max(initial=0.0)
        )

    def _best_of(
        self, offsets: Array, take: Trajectory, first: int, end: int, rng: np.random.Generator
    ) -> tuple[_Trial | None, int]:
        """The cheapest trial with `offsets` (N, L, A), or corrections, if cheaper than the take.

        And how many control steps were simulated. Trials are made in pairs, so that an idle thread
        can take one of each: what is known of the pairs before decides what is given up, however
        many threads there are.
        """
        steps, changed = end - first, offsets.shape[1]
        as_it_is = self._try(
            take, first, np.inf, np.zeros(steps), np.zeros((steps + 1, offsets.shape[2]))
        )
        offsets = np.concatenate([self._corrections(as_it_is, first, changed, rng), offsets])
        # What a hand's servos are moved by before each step.
        offsets = np.pad(offsets, ((0, 0), (1, steps - changed), (0, 0)))
        best, most, simulated = None, as_it_is.cost, steps
        least = np.array(as_it_is.steps)
        for i in range(0, len(offsets), PLACES):
            rest = EXPECTED * (least.sum() - np.cumsum(least))
            tries = [
                partial(self._try, take, first, most, rest, each, place)
                for place, each in enumerate(offsets[i : i + PLACES])
            ]
            for trial in self._threads.together(tries):
                taken = len(trial.steps)
                simulated += taken
                least[:taken] = np.minimum(least[:taken], trial.steps)
                if trial.cost < most:
                    best, most = trial, trial.cost
        return best, simulated

    def _corrections(
        self, as_it_is: _Trial, first: int, changed: int, rng: np.random.Generator
    ) -> Array:
        """(C, L, A) what takes fingertips, or some of them, nearer to where the plan has them."""
        states = slice(first + 1, first + 1 + changed)
        off = self._part.fingertips[states] - np.array(as_it_is.fingertips[:changed])
        weight = self._part.weight[states] / self._part.weight.max()
        change = self._toward.of(self._trials, np.array(as_it_is.hand_qpos[:changed]), off, weight)
        change = change[np.minimum(np.arange(1, changed + 1), changed - 1)]
        some = [np.ones(change.shape[1], bool)] * 2
        some += [self._variations.servos(rng) for _ in _CORRECTED[2:]]
        return np.stack(
            [times * change * each for times, each in zip(_CORRECTED, some, strict=True)]
        )

    def _try(
        self, take: Trajectory, first: int, most: float, rest: Array, offsets: Array, place: int = 0
    ) -> _Trial:
        """Tries a take from `first` on, with offsets (L + 1, A) to where servos are before steps.

        One that is likely to cost `most` or more, as after its steps `rest` (L,) is to be expected,
        is given up, at infinite cost.
        """
        trials, rows = self._trials, slice(first, first + len(offsets) - 1)
        ctrl, expected = (
            take.ctrl[rows, self.servos].copy(),
            take.expected[rows, self.servos].copy(),
        )

        def controls() -> Iterator[Array]:
            for k, gain in enumerate(self._gain[rows]):
                here = self._follower.posture(*trials.hand_joints(place))
                off = here - expected[k]
                off[:, 0] -= offsets[k]
                expected[k] = here
                back = (gain * off).sum(axis=1)
                ctrl[k] = self._follower.clip(ctrl[k] - back + offsets[k + 1])
                yield ctrl[k]

        cost, heard, steps = 0.0, take.heard(first).of(trials.keys), list[float]()
        tips, qpos = list[Array](), list[Array]()
        for key_qpos, fingertips in trials.run(controls(), place):
            row = first + len(steps)
            _, more, heard = self._losses.after(row, key_qpos, fingertips, heard, trials.keys)
            cost += more
            steps.append(more)
            tips.append(fingertips)
            qpos.append(trials.hand_joints(place)[0].copy())
            if cost + rest[len(steps) - 1] >= most:
                return _Trial(np.inf, ctrl, expected, steps, tips, qpos)
        return _Trial(np.inf if trials.unstable(place) else cost, ctrl, expected, steps, tips, qpos)
