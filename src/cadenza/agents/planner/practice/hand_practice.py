"""Practice of one hand where it has a loss.

From a little before the fault, many perturbations of the trajectory are rolled out, with this hand
and the keys near it only. The best is then tested in the whole scene, where the other hand may be
in the way.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array, steps_in
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.strike_model import strike_model
from cadenza.agents.planner.practice.losses import KeyEvents, KeyHistory, Losses
from cadenza.agents.planner.practice.perturbations import Perturbations
from cadenza.agents.planner.practice.trajectory import Trajectory
from cadenza.agents.planner.search.fingertip_correction import servo_corrections
from cadenza.agents.planner.search.rollouts import Rollout, Rollouts
from cadenza.agents.planner.search.strike_refinement import StrikeRefinement
from cadenza.agents.planner.search.strikes import HorizonStrikes
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.key_crossings import last_key_events
from cadenza.sim.planning_simulation import PlanningSimulation

_CANDIDATES = 18  # random perturbations
# Scales of the correction that takes fingertips to their targets, a candidate each. The first two
# are for all servos, the others for a random choice of servos.
_CORRECTION_SCALES = (1.0, 2.0, 1.0, 2.0, 0.5, 1.5)
_MAX_LEAD = 0.6  # [s] from the beginning of a change to the fault
_HORIZON = 0.6  # [s] for which a change is evaluated after its end
_MAX_REFINEMENTS = 6  # rollouts that refine the strikes of a change
_MAX_REFINEMENTS_OF_ALL = 12  # rollouts that refine strikes without another change


class ChangedControls(NamedTuple):
    """Other controls for a hand with A servos over L steps, and the servos' states with them."""

    first: int  # the first of the steps
    ctrl: Array  # (L, A)
    expected: Array  # (L, A, 2) position and speed of each servo before each step


class Attempt(NamedTuple):
    """An attempt of a hand to mend a fault, and its result."""

    step: int  # the step with the loss
    first: int  # the step at which perturbations began
    change: ChangedControls | None  # the best perturbation; None if the trajectory is better
    simulated: int  # the number of control steps simulated


@dataclass
class _PracticeCost:
    """The cost of rollouts of one hand on some of the keys, see `rollouts.Cost`."""

    losses: Losses
    first: int
    num_steps: int
    start: KeyHistory
    keys: slice
    sounds_from: Array
    dt: float

    def costs(
        self, first: int, key_paths: Array, fingertips: Array, before: KeyHistory
    ) -> list[tuple[float, int, KeyHistory]]:
        costs, substep = [], self.dt / (key_paths.shape[1] - 1)
        events = map(KeyEvents, *last_key_events(key_paths, self.sounds_from, substep))
        steps = zip(key_paths, events, fingertips, strict=True)
        for step, (key_path, step_events, tips) in enumerate(steps, self.first + first):
            evaluation = self.losses.after(step, key_path[-1], step_events, tips, before, self.keys)
            before = evaluation.history
            costs.append((evaluation.cost, 0, before))
        return costs


class HandPractice:
    """Practice of one hand.

    Attributes:
        servos: the hand's servos among those of all hands.
    """

    def __init__(self, plan: SongPlan, side: Side, goals: HandGoals) -> None:
        """Prepare practice of the whole song."""
        dt = plan.track.config.control_timestep
        alone, self.servos, _ = hand_alone(plan.scene, side)
        tracking = plan.nominal.tracking.of(self.servos)
        self._servos, self._gain = servos_of(alone), tracking.gain
        self._goals, self._losses = goals, Losses(plan, goals)
        self._perturbations = Perturbations(alone, tracking.expected[:, :, 0], dt)
        self._simulator = HandRollouts(alone, dt, plan.scene)
        self._rollouts = Rollouts(self._simulator)
        self._refinement = StrikeRefinement(self._servos, strike_model(alone, dt))
        self._keyboard, self._dt = plan.scene.keyboard, dt
        self._lead, self._horizon = steps_in(_MAX_LEAD, dt), steps_in(_HORIZON, dt)
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
        """Try to lower the loss at a random step.

        It is drawn from the steps from `first` on, with probabilities proportional to `weight`
        (L,). Steps from `first` on may change, and changes are evaluated up to `last` at most.
        """
        step = first + int(rng.choice(len(weight), p=weight / weight.sum()))
        if rng.random() < 0.5:  # half of the time, go back to where the key went wrong
            step = self._first_wrong(trajectory, first, step)
        begin = max(step - int(rng.integers(1, self._lead + 1)), first)
        change_end = min(begin + self._perturbations.length(rng), last)
        end = min(max(change_end, step + 1) + self._horizon, last)
        path, simulation = trajectory.expected[:, self.servos, 0], scene_before(begin)
        offsets = self._perturbations.draw(path, begin, change_end, _CANDIDATES, rng)
        self._start_rollouts(trajectory, simulation, offsets, begin, end)
        change = self._best_change(offsets, trajectory, begin, end, rng)
        return Attempt(step, begin, change, self._rollouts.simulated)

    def refine(
        self,
        trajectory: Trajectory,
        first: int,
        last: int,
        end: int,
        scene_before: Callable[[int], PlanningSimulation],
    ) -> Attempt:
        """Refine the times and the loudness of the strikes from `first` to before `last`.

        Changes are evaluated up to `end`.
        """
        no_offsets = np.zeros((1, last - first, len(self._servos.noise)))
        self._start_rollouts(trajectory, scene_before(first), no_offsets, first, end)
        unchanged = self._unchanged(trajectory, first, end)
        change, rollout = self._refine(*unchanged, last - first, _MAX_REFINEMENTS_OF_ALL)
        better = rollout.cost < unchanged[1].cost
        return Attempt(first, first, change if better else None, self._rollouts.simulated)

    def _first_wrong(self, trajectory: Trajectory, first: int, step: int) -> int:
        """Step, from `first` on, since which the keys that are wrong at `step` have been wrong."""
        rows = slice(first, step + 1)
        may_be_wrong = self._goals.keys | ~self._keys
        wrong = (trajectory.sounding ^ self._keys)[rows] & may_be_wrong[rows]
        is_right = ~(wrong & wrong[-1]).any(axis=1)
        return min(first + int(np.append(-1, np.flatnonzero(is_right))[-1]) + 1, step)

    def _start_rollouts(
        self,
        trajectory: Trajectory,
        simulation: PlanningSimulation,
        offsets: Array,
        first: int,
        end: int,
    ) -> None:
        """Make rollouts start from the state of the hand, with all keys that it may pass."""
        tips = self._goals.fingertips[first : end + 1, :, 1]
        tips_now = simulation.state.fingertip_xpos[0, self._goals.fingers, 1]
        low, high = (edge(np.append(tips, tips_now)) for edge in (np.min, np.max))
        slides = offsets[..., self._servos.along_keyboard]  # of hands that slide
        self._simulator.start_from(
            simulation, low + slides.min(initial=0.0), high + slides.max(initial=0.0)
        )
        keys = self._simulator.keys
        history = trajectory.key_history(first, self._losses.notes).of(keys)
        sounds_from = self._keyboard.sounds_from[keys]
        self._rollouts.start(
            _PracticeCost(self._losses, first, end - first, history, keys, sounds_from, self._dt)
        )
        self._rollouts.simulated = 0

    def _best_change(
        self, offsets: Array, trajectory: Trajectory, first: int, end: int, rng: np.random.Generator
    ) -> ChangedControls | None:
        """Roll out `offsets` (N, L, A) and corrections from the step `first` up to `end`.

        The strikes of the cheapest are refined. Returns the controls of the cheapest rollout, None
        if the trajectory is as cheap.
        """
        steps, length = end - first, offsets.shape[1]
        base, unchanged = self._unchanged(trajectory, first, end)
        offsets = np.concatenate([self._corrections(unchanged, first, length, rng), offsets])
        # Offsets of each servo's target before each step.
        offsets = np.pad(offsets, ((0, 0), (1, steps - length), (0, 0)))
        changes, controls = zip(*(self._candidate(base, rows) for rows in offsets), strict=True)
        rollouts = self._rollouts.simulate_all(controls, unchanged.cost)
        candidates = zip((base, *changes), (unchanged, *rollouts), strict=True)
        change, rollout = self._refine(*min(candidates, key=_cost), steps, _MAX_REFINEMENTS)
        return change if rollout.cost < unchanged.cost else None

    def _unchanged(
        self, trajectory: Trajectory, first: int, end: int
    ) -> tuple[ChangedControls, Rollout]:
        """The controls from `first` to before `end` as they are, and their rollout."""
        rows = slice(first, end)
        base = ChangedControls(
            first, trajectory.ctrl[rows, self.servos], trajectory.expected[rows, self.servos]
        )
        no_offsets = np.zeros((end - first + 1, base.ctrl.shape[1]))
        return base, self._rollouts.simulate(self._candidate(base, no_offsets)[1])

    def _refine(
        self, change: ChangedControls, rollout: Rollout, num_steps: int, max_rollouts: int
    ) -> tuple[ChangedControls, Rollout]:
        """Refine the strikes of the first `num_steps` of a change.

        Returns the cheapest change, and its rollout.
        """
        candidates = [(change, rollout)]
        no_offsets = np.zeros((len(change.ctrl) + 1, change.ctrl.shape[1]))

        def simulate(ctrl: Array) -> Rollout:
            candidate, controls = self._candidate(change._replace(ctrl=ctrl), no_offsets)
            candidates.append((candidate, self._rollouts.simulate(controls)))
            return candidates[-1][1]

        steps = np.arange(change.first, change.first + len(change.ctrl))
        keys, jacobian = self._simulator.keys, self._simulator.fingertip_jacobian
        strikes = HorizonStrikes(self._goals, steps, self._keyboard, keys, num_steps)
        self._refinement.refine(change.ctrl, rollout, strikes, jacobian, simulate, max_rollouts)
        return min(candidates, key=_cost)

    def _corrections(
        self, unchanged: Rollout, first: int, length: int, rng: np.random.Generator
    ) -> Array:
        """Offsets (C, L, A) that take all or some fingertips nearer to their planned places."""
        states = slice(first + 1, first + 1 + length)
        error = self._goals.fingertips[states] - np.array(unchanged.fingertips[:length])
        weight = self._goals.weight[states] / self._goals.weight.max()
        jacobian = self._simulator.fingertip_jacobian(np.array(unchanged.hand_qpos[:length]))
        change = servo_corrections(error, weight, jacobian, self._servos)
        change = change[np.minimum(np.arange(1, length + 1), length - 1)]
        masks = [np.ones(change.shape[1], bool)] * 2
        masks += [self._perturbations.servos(rng) for _ in _CORRECTION_SCALES[2:]]
        scales = zip(_CORRECTION_SCALES, masks, strict=True)
        return np.stack([scale * change * mask for scale, mask in scales])

    def _candidate(
        self, base: ChangedControls, offsets: Array
    ) -> tuple[ChangedControls, Iterator[Array]]:
        """Candidate controls, with offsets (L + 1, A) to the positions of servos.

        Returns the change, which its rollout fills in, and the controls for this rollout.
        """
        first, ctrl, expected = base.first, base.ctrl.copy(), base.expected.copy()
        rows = slice(first, first + len(ctrl))

        def controls() -> Iterator[Array]:
            for k, gain in enumerate(self._gain[rows]):
                state = self._servos.state(*self._simulator.hand_joints())
                error = state - expected[k]
                error[:, 0] -= offsets[k]
                expected[k] = state
                feedback = (gain * error).sum(axis=1)
                ctrl[k] = self._servos.clip(ctrl[k] - feedback + offsets[k + 1])
                yield ctrl[k]

        return ChangedControls(first, ctrl, expected), controls()


def _cost(candidate: tuple[ChangedControls, Rollout]) -> float:
    return candidate[1].cost
