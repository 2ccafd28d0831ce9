"""Improves what one hand plays where it has a loss.

The hand begins a little before the fault, and rolls out many perturbations of the trajectory, by
itself and with the keys near it only. Whether the best of them is of use shows in the whole scene,
where the other hand may be in the way.
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
from cadenza.agents.planner.practice.perturbations import Perturbations
from cadenza.agents.planner.practice.trajectory import Trajectory
from cadenza.agents.planner.search.fingertip_correction import servo_corrections
from cadenza.agents.planner.search.rollouts import EXPECTED
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import NUM_SLOTS, HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]

_CANDIDATES = 18  # perturbations that are drawn
# Scales of the correction that takes fingertips to their targets; each is another candidate. The
# first two are for all servos, the others for servos that are drawn.
_CORRECTION_SCALES = (1.0, 2.0, 1.0, 2.0, 0.5, 1.5)
_LEAD = 0.6  # [s] at most from the beginning of a change to the fault
_HORIZON = 0.6  # [s] for which a change is evaluated after its end


class Change(NamedTuple):
    """Other controls for a hand with A servos over L steps."""

    first: int
    ctrl: Array
    """(L, A)"""
    expected: Array
    """(L, A, 2)"""


class Attempt(NamedTuple):
    """An attempt of a hand to mend a fault, and its result."""

    step: int
    """The step with the loss."""
    first: int
    """The step at which perturbations began."""
    change: Change | None
    """The best of them, if one was better than the trajectory."""
    simulated: int
    """Control steps that were simulated."""


class _Rollout(NamedTuple):
    cost: float
    """Cost of all steps, infinite if the rollout was given up."""
    ctrl: Array
    expected: Array
    step_costs: list[float]
    """Cost of each step that was simulated."""
    fingertips: list[Array]
    """(F, 3) after each of these steps [m]."""
    hand_qpos: list[Array]
    """(J,) after each of these steps [m, rad]."""


class HandPractice:
    """Practice of one hand.

    Attributes:
        servos: the hand's servos among those of all hands.
    """

    def __init__(self, plan: SongPlan, side: Side, goals: HandGoals, threads: Threads) -> None:
        """Args:
        plan: the plan of the whole song.
        side: which hand.
        goals: what the hand has to do.
        threads: what shares the rollouts.
        """
        dt = plan.track.config.control_timestep
        alone, self.servos, _ = hand_alone(plan.scene, side)
        tracking = plan.nominal.tracking.of(self.servos)
        self._servos = servos_of(alone)
        self._gain, self._follower = tracking.gain, Follower(alone, tracking)
        self._goals, self._losses, self._threads = goals, Losses(plan, goals), threads
        self._perturbations = Perturbations(alone, tracking.expected[:, :, 0], dt)
        self._rollouts = HandRollouts(alone, dt, plan.scene)
        self._lead, self._horizon = steps_in(_LEAD, dt), steps_in(_HORIZON, dt)
        self._keys = plan.goals.keys

    def attempt(
        self,
        trajectory: Trajectory,
        first: int,
        weight: Array,
        last: int,
        scene_before: Callable[[int], PlanningSimulation],
        rng: np.random.Generator,
    ) -> Attempt:
        """Tries to lower the loss at a step that is drawn.

        Args:
            trajectory: what all hands play.
            first: the earliest step that may change.
            weight: (L,) how likely each step from there on is to be drawn, not normalised.
            last: the step up to which changes may be evaluated.
            scene_before: gives the whole scene before a step of the trajectory.
            rng: source of randomness.
        """
        step = first + int(rng.choice(len(weight), p=weight / weight.sum()))
        if rng.random() < 0.5:  # where a key went wrong, as often as where it still is
            step = self._first_wrong(trajectory, first, step)
        begin = max(step - int(rng.integers(1, self._lead + 1)), first)
        changed = min(begin + self._perturbations.length(rng), last)
        end = min(max(changed, step + 1) + self._horizon, last)
        path, simulation = trajectory.expected[:, self.servos, 0], scene_before(begin)
        offsets = self._perturbations.draw(path, begin, changed, _CANDIDATES, rng)
        self._begin_rollouts(simulation, offsets, begin, end)
        best, simulated = self._best_of(offsets, trajectory, begin, end, rng)
        change = Change(begin, best.ctrl, best.expected) if best else None
        return Attempt(step, begin, change, simulated)

    def _first_wrong(self, trajectory: Trajectory, first: int, step: int) -> int:
        """The step, from `first` on, since which a key has been wrong that is wrong at `step`."""
        rows = slice(first, step + 1)
        may_be_wrong = self._goals.mine | ~self._keys
        wrong = (trajectory.sounding ^ self._keys)[rows] & may_be_wrong[rows]
        fine = ~(wrong & wrong[-1]).any(axis=1)
        return min(first + int(np.append(-1, np.flatnonzero(fine))[-1]) + 1, step)

    def _begin_rollouts(
        self, simulation: PlanningSimulation, offsets: Array, first: int, end: int
    ) -> None:
        """Prepares rollouts from where the hand is, with all keys that it may come over."""
        tips = self._goals.fingertips[first : end + 1, :, 1]
        here = simulation.state.fingertip_xpos[0, self._goals.fingers, 1]
        low, high = (edge(np.append(tips, here)) for edge in (np.min, np.max))
        slides = offsets[..., self._servos.along_keyboard]  # of hands that slide
        self._rollouts.start_from(
            simulation, low + slides.min(initial=0.0), high + slides.max(initial=0.0)
        )

    def _best_of(
        self,
        offsets: Array,
        trajectory: Trajectory,
        first: int,
        end: int,
        rng: np.random.Generator,
    ) -> tuple[_Rollout | None, int]:
        """Rolls out `offsets` (N, L, A) and corrections from the step `first` up to `end`.

        Rollouts are made in pairs, so that an idle thread can take one of each: only what is known
        of earlier pairs decides what is given up, so any number of threads finds the same.

        Returns:
            The cheapest rollout, None if the trajectory is as cheap; control steps simulated.
        """
        steps, changed = end - first, offsets.shape[1]
        unchanged = self._roll_out(
            trajectory, first, np.inf, np.zeros(steps), np.zeros((steps + 1, offsets.shape[2]))
        )
        offsets = np.concatenate([self._corrections(unchanged, first, changed, rng), offsets])
        # How much each servo's target is moved before each step.
        offsets = np.pad(offsets, ((0, 0), (1, steps - changed), (0, 0)))
        best, lowest, simulated = None, unchanged.cost, steps
        lowest_by_step = np.array(unchanged.step_costs)
        for i in range(0, len(offsets), NUM_SLOTS):
            cost_to_go = EXPECTED * (lowest_by_step.sum() - np.cumsum(lowest_by_step))
            pair = [
                partial(self._roll_out, trajectory, first, lowest, cost_to_go, each, place)
                for place, each in enumerate(offsets[i : i + NUM_SLOTS])
            ]
            for rollout in self._threads.together(pair):
                done = len(rollout.step_costs)
                simulated += done
                lowest_by_step[:done] = np.minimum(lowest_by_step[:done], rollout.step_costs)
                if rollout.cost < lowest:
                    best, lowest = rollout, rollout.cost
        return best, simulated

    def _corrections(
        self, unchanged: _Rollout, first: int, changed: int, rng: np.random.Generator
    ) -> Array:
        """Offsets (C, L, A) that take all or some fingertips nearer to where the plan has them."""
        states = slice(first + 1, first + 1 + changed)
        off = self._goals.fingertips[states] - np.array(unchanged.fingertips[:changed])
        weight = self._goals.weight[states] / self._goals.weight.max()
        jacobian = self._rollouts.fingertip_jacobian(np.array(unchanged.hand_qpos[:changed]))
        change = servo_corrections(off, weight, jacobian, self._servos)
        change = change[np.minimum(np.arange(1, changed + 1), changed - 1)]
        servos = [np.ones(change.shape[1], bool)] * 2
        servos += [self._perturbations.servos(rng) for _ in _CORRECTION_SCALES[2:]]
        scaled = zip(_CORRECTION_SCALES, servos, strict=True)
        return np.stack([scale * change * each for scale, each in scaled])

    def _roll_out(
        self,
        trajectory: Trajectory,
        first: int,
        most: float,
        cost_to_go: Array,
        offsets: Array,
        place: int = 0,
    ) -> _Rollout:
        """Rolls out the trajectory from `first` on, with offsets (L + 1, A) to servos' positions.

        A rollout is given up, at infinite cost, once its cost and what `cost_to_go` (L,) says is to
        be expected after each step come to `most`.
        """
        rollouts, rows = self._rollouts, slice(first, first + len(offsets) - 1)
        ctrl = trajectory.ctrl[rows, self.servos].copy()
        expected = trajectory.expected[rows, self.servos].copy()

        def controls() -> Iterator[Array]:
            for k, gain in enumerate(self._gain[rows]):
                here = self._follower.posture(*rollouts.hand_joints(place))
                off = here - expected[k]
                off[:, 0] -= offsets[k]
                expected[k] = here
                feedback = (gain * off).sum(axis=1)
                ctrl[k] = self._follower.clip(ctrl[k] - feedback + offsets[k + 1])
                yield ctrl[k]

        cost, history = 0.0, trajectory.key_history(first).of(rollouts.keys)
        made = _Rollout(np.inf, ctrl, expected, [], [], [])
        for step, (key_qpos, fingertips) in enumerate(rollouts.run(controls(), place), first):
            _, more, history = self._losses.after(
                step, key_qpos, fingertips, history, rollouts.keys
            )
            cost += more
            made.step_costs.append(more)
            made.fingertips.append(fingertips)
            made.hand_qpos.append(rollouts.hand_joints(place)[0].copy())
            if cost + cost_to_go[step - first] >= most:
                return made
        return made if rollouts.unstable(place) else made._replace(cost=cost)
