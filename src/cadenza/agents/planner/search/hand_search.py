"""Receding-horizon sampling around the nominal trajectory of one hand.

At each step, the nominal controls of the horizon are rolled out, with the warm start of the last
step. If keys go wrong, candidates around the best controls so far are drawn and rolled out, too:
predictive sampling (Howell et al., 2022). The first controls are played; the others are the warm
start of the next step. The nominal trajectory is rehearsed first, half a second at a time, and
sampling is only needed where that fails.

The model is the hand alone, on the keys near it. It moves as in the whole scene unless the hands
touch, and takes a third of the time.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Mask, steps_in
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import ABOUT_TO_PRESS, HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.strike_model import strike_model
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.candidates import EscapeMotions, NetworkCandidate, crossover
from cadenza.agents.planner.search.fingertip_correction import servo_corrections
from cadenza.agents.planner.search.hand_rehearsal import HandRehearsal
from cadenza.agents.planner.search.horizon_cost import HorizonCost
from cadenza.agents.planner.search.networks.inputs import sizes_of
from cadenza.agents.planner.search.networks.weights import shipped
from cadenza.agents.planner.search.rollouts import (
    Rollout,
    Rollouts,
    cost_from,
    roll_out,
    start_rollouts,
)
from cadenza.agents.planner.search.strike_refinement import StrikeRefinement
from cadenza.agents.planner.search.strikes import HorizonStrikes
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import Path, State

Steps = NDArray[np.intp]

_IDLE_NOISE = 0.3  # of a servo's noise, for fingers that do not play within the horizon
_SPARSITY = 0.3  # share of the servos that half of the candidates change
_CAUGHT = 0.012  # [m] beside its target at which a finger does not come free by itself
_STUCK = 0.005  # maximum motion within the horizon of a finger that stays caught [m]
_ESCAPE_HORIZON = 0.6  # [s] in which an escape pays: in the air, a hand gives up the keys it holds
_CORRECTION_GAINS = np.array([1.0, 2.0])  # of fingertip corrections
_HALF_LIFE = 1.0  # of a warm start that is no longer needed [s]

# Share of a full search's control steps that a hand may simulate at each step, or save for later.
# It keeps planning within the time of the music on two cores where every step fails. Rehearsals
# come on top.
BUDGET_SHARE = 0.4
_INITIAL_BUDGET = 1.0  # [s] of saved budget of a hand that begins to follow another trajectory
REFINED_HORIZON = 5  # steps that are simulated to refine the strikes of the first ones
_REFINED = 2  # first steps whose strikes are refined
REFINEMENTS = 8  # maximum rollouts to refine strikes, beside one of the controls before
_SEEDS = 1 << 32  # of the random numbers from a step on
_MAX_DRIFT = 1e-5  # [m, rad] between the model and the scene, above which the model is reset

# State of the search, beside its model and its random numbers.
_STATE = "_step", "_in_sync", "_rehearsal", "_warm_start", "_refined", "_is_refined", "_previous"


class PlayedStep(NamedTuple):
    """A control step of a hand in its own model."""

    ctrl: Array  # (A,)
    hand_qpos: Array  # (J,) before the step [m, rad]
    hand_qvel: Array  # (J,) before the step [m/s, rad/s]


class SimulatedStep(NamedTuple):
    """A control step of a hand in its own model, and its outcome."""

    played: PlayedStep
    key_path: Array  # (S + 1, K) before the step and after each of its physics steps [rad]
    fingertips: Array  # (F, 3) after the step [m]


class Snapshot(NamedTuple):
    """A hand's search before a step, and its model."""

    step: int
    state: State
    model: Any
    attributes: dict[str, Any]
    budget: int


class HandSearch:
    """Controls of one hand, step by step.

    Attributes:
        servos: the hand's servos among those of the scene.
        joints: the hand's joints among those of the scene.
    """

    def __init__(
        self, plan: SongPlan, side: Side, rng: np.random.Generator, config: PlannerConfig
    ) -> None:
        """Follow a plan from its first step on."""
        dt = plan.track.config.control_timestep
        scene, self.servos, self.joints = hand_alone(plan.scene, side)
        self._rng, self._dt, self._servos, self._side = rng, dt, servos_of(scene), side
        self._seed = int(rng.spawn(1)[0].integers(_SEEDS))
        self._searches = config.method != "none"
        self._num_candidates, self._iterations = config.num_candidates, config.iterations
        self._horizon = max(1, round(config.horizon / dt))
        self._escape_horizon = max(self._horizon, steps_in(_ESCAPE_HORIZON, dt))
        self._model, self._simulator = PlanningSimulation(scene, 1, dt), HandRollouts(scene, dt)
        self._rollouts = Rollouts(self._simulator)
        self._keyboard, self._all_keys = scene.keyboard, slice(0, scene.keyboard.num_keys)
        self._escapes = EscapeMotions(self._servos, dt)
        self._rehearsal = HandRehearsal(scene, self._simulator, dt)
        self._refinement = StrikeRefinement(self._servos, strike_model(scene, dt))
        self._warm_start = np.zeros((self._horizon, len(self._servos.noise)))
        # Controls of the next step, if its strikes are refined: feedback would undo this.
        self._refined, self._is_refined = np.zeros(len(self._servos.noise)), False
        self._previous = np.zeros(len(self._servos.noise))  # correction of the last step
        self._decay = 0.5 ** (dt / _HALF_LIFE)
        full_search = self._iterations * self._num_candidates * self._horizon
        # Budgets are whole numbers of control steps, so that sums are exact.
        self._income, self._granted = round(BUDGET_SHARE * full_search), 0
        self._rehearsed = 0
        self._path = Path.still(self._model.state, self._model.num_substeps + 1)
        self._step, self._in_sync, self._rehearses = 0, True, self._searches
        weights = shipped().get(plan.scene.hand.name) if config.proposals == "learnt" else None
        fits = weights is not None and weights.sizes == sizes_of(plan.scene)
        self._weights = weights if fits else None  # else they are those of another hand
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a longer plan.

        If the plan ends within the horizon, so does the song.
        """
        self._goals = HandGoals(plan, self._side)
        self._tracking = plan.nominal.tracking.of(self.servos)
        self._network = (
            NetworkCandidate(plan, self._side, self._weights, step) if self._weights else None
        )

    def restart(
        self, goals: HandGoals, tracking: Tracking, step: int, rng: np.random.Generator
    ) -> None:
        """Follow a trajectory from `step` on, with a saved budget and no warm start.

        It is not rehearsed, and has no network candidate. The goals are to hold the keys that
        sounded in it.
        """
        self._goals, self._tracking, self._network = goals, tracking, None
        self._rehearses = False
        self._rehearsed, self._rollouts.simulated = 0, 0
        self.go_back(step)
        self._rng = rng

    @property
    def simulated(self) -> int:
        """Number of control steps simulated since the beginning or the last restart."""
        return self._rollouts.simulated + self._rehearsed

    @property
    def _budget(self) -> int:
        """Number of control steps that it may still simulate."""
        return self._granted - self._rollouts.simulated

    @property
    def lookahead(self) -> int:
        """Number of steps of the plan that are needed, with presses that begin soon after."""
        rehearsal = self._rehearsal.lookahead if self._rehearses else 0
        return max(self._escape_horizon, rehearsal) + steps_in(ABOUT_TO_PRESS, self._dt)

    def act(self, hand_qpos: Array, hand_qvel: Array, key_qpos: Array) -> Array:
        """Controls (A,) of this hand for a step from its joints (J,) and all keys (K,)."""
        self.synchronise(hand_qpos, hand_qvel, key_qpos)
        return self.play().played.ctrl

    def play(self) -> SimulatedStep:
        """Play the next step in the hand's own model."""
        before = self._model.state
        self._granted += self._income
        self._rehearse()
        ctrl = self._optimise()
        key_path = self._advance(ctrl)
        fingertips = self._model.state.fingertip_xpos[0, self._goals.fingers]
        played = PlayedStep(ctrl, before.hand_qpos[0], before.hand_qvel[0])
        return SimulatedStep(played, key_path, fingertips)

    def synchronise(self, hand_qpos: Array, hand_qvel: Array, key_qpos: Array) -> None:
        """Put the model into the state of the scene, unless they agree."""
        drift = np.abs(self._model.state.hand_qpos[0] - hand_qpos).max()
        if not self._in_sync or drift > _MAX_DRIFT:
            self._model.set_joints(hand_qpos, hand_qvel, key_qpos)
            self._in_sync = True

    def _advance(self, ctrl: Array) -> Array:
        """Take a step in the model, and return the path (S + 1, K) of the keys through it [rad]."""
        _, nominal = self._nominal(1)
        self._previous = ctrl - self._servos.clip(nominal[0])
        self._model.step(ctrl[None], path=self._path)
        self._step += 1
        return self._path.key_qpos[0].copy()

    # Restarts

    @property
    def steps_left(self) -> int:
        """The number of steps of the plan that are still to be played."""
        return len(self._tracking.ctrl) - self._step

    def save(self) -> Snapshot:
        """A snapshot for `restore`, without random numbers."""
        attributes = {name: copy(getattr(self, name)) for name in _STATE}
        model = self._model.save(0)
        return Snapshot(self._step, self._model.state, model, attributes, self._budget)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot, with its budget and new random numbers."""
        self._granted = snapshot.budget + self._rollouts.simulated
        for name, value in snapshot.attributes.items():
            setattr(self, name, copy(value))
        self._model.restore(0, snapshot.model)

    def go_back(self, step: int) -> None:
        """Go on from `step`, at which the scene is in another state than the model was.

        The next steps do not depend on how far ahead the model was.
        """
        self._step, self._in_sync, self._is_refined = step, False, False
        self._warm_start[:], self._previous[:] = 0.0, 0.0
        self._rehearsal.reset()
        self._rng = np.random.default_rng([self._seed, step])
        self._granted = self._rollouts.simulated
        self._granted += self._income * steps_in(_INITIAL_BUDGET, self._dt)

    def cost(self, start: Snapshot, num_steps: int) -> HorizonCost:
        """The cost, with all keys, of `num_steps` from a snapshot on, or less at the end."""
        steps = np.arange(start.step, min(start.step + num_steps, len(self._tracking.ctrl)))
        return cost_from(start.state, self._goals, steps, self._keyboard, self._all_keys)

    def _rehearse(self) -> None:
        """Rehearse the next steps, unless they have been rehearsed."""
        if not self._rehearses or self._step < self._rehearsal.end:
            return
        last = min(self._step + self._rehearsal.lookahead, len(self._tracking.ctrl))
        if (steps := np.arange(self._step, last)).size:
            self._rehearsed += self._rehearsal.rehearse(
                self._goals, self._tracking, steps, self._model
            )

    def _optimise(self) -> Array:
        """First controls (A,) of the best sequence found for the horizon."""
        steps, nominal = self._nominal(self._horizon)
        if not self._searches:
            return self._servos.clip(nominal[0])
        if self._rehearsal.goes_as_rehearsed(self._step, self._model.state.hand_qpos[0]):
            self._warm_start[:], self._is_refined = 0.0, False
            return self._servos.clip(nominal[0])
        best = self._servos.clip(nominal + self._warm_start)
        if self._is_refined:
            best[0], self._is_refined = self._refined, False
        self._start_rollouts(steps)
        rollout = self._rollouts.simulate(best)
        fingertips = self._model.state.fingertip_xpos[0, self._goals.fingers]
        has_budget = self._budget > 0
        if rollout.mistakes and has_budget:
            caught = self._caught()
            best = self._search(nominal, best, rollout, steps, caught)
            if caught.any():
                best = self._escape(best, fingertips)
        best = self._refine(best, steps)
        # The warm start fades unless fingers are still off the plan or there was no budget.
        is_needed = self._off_target(fingertips, self._step).any() or (
            rollout.mistakes and not has_budget
        )
        self._warm_start[:-1] = (1.0 if is_needed else self._decay) * (best - nominal)[1:]
        self._warm_start[-1] = 0.0
        return best[0]

    def _refine(self, ctrl: Array, steps: Steps) -> Array:
        """Controls (H, A), refined for the strikes that begin in this step or the next."""
        steps = steps[: len(self._tracking.ctrl) - self._step][:REFINED_HORIZON]
        if not len(HorizonStrikes(self._goals, steps, self._keyboard, self._all_keys, _REFINED)):
            return ctrl
        horizon = start_rollouts(self._simulator, self._model, self._goals, steps, self._keyboard)

        def simulate(ctrl: Array) -> Rollout:
            self._rehearsed += len(steps)
            return roll_out(self._simulator, horizon, ctrl)

        keys = self._simulator.keys
        silent = horizon.start.silent
        strikes = HorizonStrikes(self._goals, steps, self._keyboard, keys, _REFINED, silent)
        refined = self._refinement.refine(
            ctrl[: len(steps)],
            simulate(ctrl[: len(steps)]),
            strikes,
            self._simulator.fingertip_jacobian,
            simulate,
            REFINEMENTS,
        )
        if (strikes.step == 1).any():
            self._refined, self._is_refined = refined.ctrl[1], True
        return np.concatenate([refined.ctrl, ctrl[len(steps) :]])

    # The nominal trajectory

    def _nominal(self, horizon: int) -> tuple[Steps, Array]:
        """Next steps (H,), and their nominal controls (H, A), the first with feedback."""
        steps, nominal = self._nominal_without_feedback(horizon)
        nominal[0] -= self._tracking.feedback(self._step, self._servo_state())
        return steps, nominal

    def _nominal_without_feedback(self, horizon: int) -> tuple[Steps, Array]:
        """Next steps (H,), and their controls (H, A) by the rehearsal, else by the plan."""
        last = len(self._tracking.ctrl) - 1
        steps = np.minimum(np.arange(self._step, self._step + horizon), last)
        ctrl, rehearsed = self._tracking.ctrl[steps], self._rehearsal.ctrl(self._step)[:horizon]
        ctrl[: len(rehearsed)] = rehearsed
        return steps, ctrl

    def _servo_state(self) -> Array:
        """Positions and speeds (A, 2) of the servos now."""
        state = self._model.state
        joints = np.stack([state.hand_qpos[0], state.hand_qvel[0]], axis=1)  # (J, 2)
        return self._servos.of_joints.T @ joints

    def _start_rollouts(self, steps: Steps) -> None:
        steps = steps[: len(self._tracking.ctrl) - self._step]  # without those after the end
        self._cost = start_rollouts(
            self._simulator, self._model, self._goals, steps, self._keyboard
        )
        self._rollouts.start(self._cost)

    # Sampling

    def _search(
        self, nominal: Array, best: Array, rollout: Rollout, steps: Steps, caught: Mask
    ) -> Array:
        """Cheapest controls (H, A) found within the budget.

        The search stops when controls make no mistakes. Iterations after the first must leave a
        budget for the first iterations of later steps, which gain the most.

        `best` (H, A) are the cheapest controls so far, with their `rollout`; `caught` (F,) are the
        caught fingers.
        """
        if self._network and not caught.any():
            ctrl, candidate = self._network_candidate(self._network, rollout.cost)
            if candidate.cost < rollout.cost:
                best, rollout = ctrl, candidate
                if not rollout.mistakes:
                    return best
        sigma = self._sigma(steps)
        for iteration in range(self._iterations):
            if self._budget <= iteration * self._num_candidates * self._horizon:
                break
            corrected = self._correct_fingertips(best, rollout)
            if iteration == 0:
                corrected = np.concatenate([corrected, self._restarts(nominal, best, caught)])
            candidates = np.concatenate([corrected, self._draw(best, sigma)])
            candidates, rollouts = self._simulate_with_crossover(candidates, best, rollout)
            cheapest = int(np.argmin([candidate.cost for candidate in rollouts]))
            if rollouts[cheapest].cost < rollout.cost:
                best, rollout = candidates[cheapest], rollouts[cheapest]
                if not rollout.mistakes:
                    return best
        return best

    def _simulate_with_crossover(
        self, candidates: Array, best: Array, rollout: Rollout
    ) -> tuple[Array, list[Rollout]]:
        """Candidates (N, H, A) with their crossover with the best, and all their rollouts."""
        rollouts = self._rollouts.simulate_all(candidates, rollout.cost)
        child = self._crossover(np.array([best, *candidates]), [rollout, *rollouts])
        cutoff = min(parent.cost for parent in (rollout, *rollouts))
        rollouts += self._rollouts.simulate_all(child, cutoff)
        return np.concatenate([candidates, child]), rollouts

    def _draw(self, best: Array, sigma: Array) -> Array:
        """(N, H, A) `best` (H, A) with noise that is linear in time and has deviations `sigma`."""
        count, servos = self._num_candidates, len(self._servos.noise)
        ends = self._rng.standard_normal((count, 2, 1, servos))
        share = np.linspace(0.0, 1.0, self._horizon)[:, None]
        noise = (1 - share) * ends[:, 0] + share * ends[:, 1]
        mask = self._rng.random((count, 1, servos)) < _SPARSITY
        mask[: count // 2] = True
        return self._servos.clip(best + sigma * noise * mask)

    def _sigma(self, steps: Steps) -> Array:
        """Standard deviation (A,) of the noise."""
        playing = self._goals.playing[np.append(steps, steps[-1] + 1)].any(axis=0)
        finger = self._servos.finger
        busy = (finger < 0) | playing[finger]
        return self._servos.noise * np.where(busy, 1.0, _IDLE_NOISE)

    # Candidates that are not random

    def _network_candidate(self, network: NetworkCandidate, cutoff: float) -> tuple[Array, Rollout]:
        """Controls (H, A) of the networks, and their rollout."""
        _, planned = self._nominal_without_feedback(self._horizon)
        controls, key_qpos = self._servos.clip(planned), self._model.state.key_qpos[0]

        def record() -> Iterator[Array]:
            outputs = network.controls(
                self._simulator, self._step, planned, self._previous, key_qpos
            )
            for k, ctrl in enumerate(outputs):
                controls[k] = ctrl
                yield ctrl

        return controls, self._rollouts.simulate(record(), cutoff)

    def _correct_fingertips(self, ctrl: Array, rollout: Rollout) -> Array:
        """Controls (C, H, A) with fingertip corrections; none if the rollout was given up.

        A control changes by a multiple of the servo motion that would correct the fingertips a step
        later: iterative learning control (Arimoto et al., 1984).
        """
        if not np.isfinite(rollout.cost):
            return ctrl[None][:0]
        error, weight = self._cost.fingertip_errors(np.array(rollout.fingertips))
        jacobian = self._simulator.fingertip_jacobian(np.array(rollout.hand_qpos))
        change = servo_corrections(error, weight, jacobian, self._servos)
        rows = np.minimum(np.arange(1, len(ctrl) + 1), len(change) - 1)
        return self._servos.clip(ctrl + _CORRECTION_GAINS[:, None, None] * change[rows])

    def _restarts(self, nominal: Array, best: Array, caught: Mask) -> Array:
        """Nominal controls, and motions that free a hand or caught fingers (N, H, A)."""
        candidates = [self._servos.clip(nominal), self._escapes.hand_lift(best, self._step)]
        if caught.any():
            posture = self._servo_state()[:, 0]
            candidates.extend(self._escapes.of_one_duration(nominal, caught, posture, self._step))
        return np.array(candidates)

    def _crossover(self, candidates: Array, rollouts: Sequence[Rollout]) -> Array:
        """Crossover (C, H, A) of candidates (N, H, A); none if the best makes no mistakes."""
        best = min(range(len(rollouts)), key=lambda i: rollouts[i].cost)
        if not rollouts[best].mistakes:
            return candidates[:0]
        costs = [
            self._cost.by_finger(
                np.array([keys.costs for _, _, keys in rollout.totals]),
                np.array(rollout.fingertips),
            )
            for rollout in rollouts
        ]
        return crossover(candidates, costs, best, self._servos.finger)

    # Fingers that are caught between keys

    def _off_target(self, fingertips: Array, state: int) -> Mask:
        """Playing fingers (F,) in a state whose tips (F, 3) [m] are far off their targets."""
        error = (fingertips - self._goals.fingertips[state])[:, :2]
        return self._goals.playing[state] & (np.linalg.norm(error, axis=1) > _CAUGHT)

    def _caught(self) -> Mask:
        """Fingers (F,) that are off their targets at the end of the last rollout."""
        end = min(self._step + self._horizon, len(self._tracking.ctrl))
        return self._off_target(self._simulator.fingertips(), end)

    def _escape(self, best: Array, fingertips: Array) -> Array:
        """`best` (H, A), or an escape motion if fingers stay caught and it pays in the long run.

        `fingertips` (F, 3) are the current ones [m].
        """
        rollout = self._rollouts.simulate(best)
        moved = np.linalg.norm(self._simulator.fingertips() - fingertips, axis=1)
        caught = self._caught()
        if not (rollout.mistakes and (caught & (moved < _STUCK)).any()):
            return best
        steps, nominal = self._nominal(self._escape_horizon)
        unchanged = self._servos.clip(nominal)
        unchanged[: len(best)] = best
        escapes = self._escapes.all(nominal, caught, self._servo_state()[:, 0])
        candidates = np.concatenate([unchanged[None], escapes])
        self._start_rollouts(steps)
        costs = [candidate.cost for candidate in self._rollouts.simulate_all(candidates)]
        return candidates[int(np.argmin(costs)), : len(best)]
