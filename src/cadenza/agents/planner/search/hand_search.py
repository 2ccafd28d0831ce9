"""Makes a nominal plan work in simulation: receding-horizon sampling around it, a hand at a time.

A hand alone, with all keys, moves just as it does beside the other as long as the two do not
touch. So does a hand with the keys near it, nearly always, and what it is to do is tried out there,
in about a third of the time that both take. The plan is rehearsed first, a second at a time.
Sampling is only done where it still fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import ABOUT_TO_PRESS, HandGoals
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.candidates import Detours, combined
from cadenza.agents.planner.search.fingertip_correction import Correction
from cadenza.agents.planner.search.hand_rehearsal import HandRehearsal
from cadenza.agents.planner.search.horizon_cost import Rollout, look_ahead
from cadenza.agents.planner.search.network_candidate import Proposal
from cadenza.agents.planner.search.rollouts import Rollouts
from cadenza.agents.planner.search.sampling import UPDATES, Around, cheapest
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_IDLE_FINGER = 0.3  # of a servo's noise, for fingers that do not play within the horizon
_SPARSE = 0.3  # half of the candidates change this share of the servos
_CAUGHT = 0.012  # [m] that a finger is astray if the next steps will not free it
_STUCK = 0.005  # [m] that it moves in them if it is there to stay
_FREED = 0.6  # [s] in which a detour pays, though in the air a hand gives up keys that it holds
_CORRECTED = np.array([1.0, 2.0])  # times the way that fingertips are off, a plan is corrected by
_HALVED = 1.0  # [s] in which half of the correction to the nominal plan fades

# Share of a full search's simulations that a hand may use at a step, or save for later ones. Keeps
# planning within the time of the music on two cores where every step fails. Rehearsals come on top.
_SUSTAINED = 0.4
_SAVED = 1.0  # [s] for which it has been saved where a hand starts over
_DRIFT = 1e-5  # [m, rad] a simulation of the hand alone that is further off is put right


class HandSearch:
    """Controls of one hand, step by step."""

    def __init__(
        self,
        scene: Scene,
        config: PlannerConfig,
        dt: float,
        rng: np.random.Generator,
        threads: Threads,
    ) -> None:
        """It has to `follow` something before it acts.

        Args:
            scene: with this hand only.
            config: how to sample.
            dt: control step [s].
            rng: what is random.
            threads: that share the search.
        """
        self._rng, self._dt = rng, dt
        self._servos, self._keyboard = servos_of(scene), scene.keyboard
        self._update = UPDATES[config.method] if config.method != "none" else None
        self._candidates, self._iterations = config.num_candidates, config.iterations
        self._horizon = max(1, round(config.horizon / dt))
        self._further = max(self._horizon, steps_in(_FREED, dt))
        self._twin = PlanningSimulation(scene, 1, dt)
        self._trials, self._toward = HandRollouts(scene, dt), Correction(scene)
        weighs_all = self._update not in (None, cheapest)
        self._tries = Rollouts(self._trials, threads, to_their_end=weighs_all)
        self._detours = Detours(self._servos, dt)
        self._rehearsal = HandRehearsal(scene, self._trials, dt)
        self._correction = np.zeros((self._horizon, len(self._servos.noise)))
        self._changed = np.zeros(len(self._servos.noise))  # of the controls of the step before
        self._kept = 0.5 ** (dt / _HALVED)
        full = self._iterations * self._candidates * self._horizon
        # Control steps to simulate in tries: whole numbers, so that sums are exact.
        self._earned, self._granted = round(_SUSTAINED * full), 0
        self._rehearsed = 0
        self._step, self._lost, self._rehearses = 0, False, self._update is not None

    def start_over(self, step: int, rng: np.random.Generator) -> None:
        """Goes on with that step as if it had not searched for a while before.

        What it follows then has been played, and need not be rehearsed.
        """
        self._step, self._lost, self._rehearses = step, True, False
        self._rehearsal.forget()
        self._correction[:] = 0.0
        self._granted = self._earned * steps_in(_SAVED, self._dt)
        self._rng, self._rehearsed, self._tries.simulated = rng, 0, 0

    @property
    def simulated(self) -> int:
        """Control steps, in tries and rehearsals, since it began or started over."""
        return self._tries.simulated + self._rehearsed

    @property
    def _savings(self) -> int:
        """Control steps that it may simulate."""
        return self._granted - self._tries.simulated

    @property
    def memory(self) -> SearchState:
        """What decides how it goes on, if `again` leads its twin to the same place."""
        return SearchState(
            self._correction.copy(), np.array(float(self._savings)), words_of(self._rng)
        )

    def remember(self, memory: SearchState) -> None:
        """Goes on as what had that memory would have."""
        self._correction = memory.correction.copy()
        self._granted = self._tries.simulated + int(memory.savings)
        self._rng = generator_of(memory.rng)

    @property
    def steps_seen(self) -> int:
        """How many steps of the plan a step looks at, and of those who press soon after."""
        rehearsed = self._rehearsal.steps_seen if self._rehearses else 0
        return max(self._further, rehearsed) + steps_in(ABOUT_TO_PRESS, self._dt)

    def follow(self, part: HandGoals, tracking: Tracking, proposal: Proposal | None = None) -> None:
        """From now on, by another plan.

        Args:
            part: what it has to do.
            tracking: the controls of the plan, of this hand's servos. Where it goes less far than a
                step looks, it is taken for the end of the song.
            proposal: what a search begins with.
        """
        self._part, self._tracking, self._proposal = part, tracking, proposal

    def act(self, hand_qpos: Array, hand_qvel: Array, key_qpos: Array) -> Array:
        """(A,) the controls of this hand from the state that it is in now.

        Args:
            hand_qpos: (J,) of this hand [m, rad].
            hand_qvel: (J,)
            key_qpos: (K,) [rad]
        """
        self._be_at(hand_qpos, hand_qvel, key_qpos)
        self._granted += self._earned
        self._rehearse()
        ctrl = self._plan()
        self._go_on(ctrl)
        return ctrl

    def again(self, hand_qpos: Array, hand_qvel: Array, key_qpos: Array, ctrl: Array) -> None:
        """Takes a step with the controls (A,) that `act` returned in that state before."""
        self._be_at(hand_qpos, hand_qvel, key_qpos)
        self._rehearse()
        self._go_on(ctrl)

    def _be_at(self, hand_qpos: Array, hand_qvel: Array, key_qpos: Array) -> None:
        if self._lost or np.abs(self._twin.state.hand_qpos[0] - hand_qpos).max() > _DRIFT:
            self._twin.place(hand_qpos, hand_qvel, key_qpos)
            self._lost = False

    def _go_on(self, ctrl: Array) -> None:
        _, nominal = self._nominal(1)
        self._changed = ctrl - self._servos.clip(nominal[0])
        self._twin.step(ctrl[None])
        self._step += 1

    def _plan(self) -> Array:
        rows, nominal = self._nominal(self._horizon)
        if self._update is None:
            return self._servos.clip(nominal[0])
        if self._rehearsal.foresaw(self._step, self._twin.state.hand_qpos[0]):
            self._correction[:] = 0.0
            return self._servos.clip(nominal[0])
        best = self._servos.clip(nominal + self._correction)
        self._begin_tries(rows)
        trial = self._tries.one(best)
        here = self._twin.state.fingertip_xpos[0, self._part.fingers]
        affordable = self._savings > 0
        if trial.mistakes and affordable:
            caught = self._caught()
            best = self._search(nominal, best, trial, rows, caught)
            if caught.any():
                best = self._free_for_good(best, here)
        # What is on its way back to the plan, or cannot be searched, goes on as it has begun.
        goes_on = self._astray(here, self._step).any() or (trial.mistakes and not affordable)
        kept = 1.0 if goes_on else self._kept
        self._correction[:-1] = kept * (best - nominal)[1:]
        self._correction[-1] = 0.0
        return best[0]

    def _nominal(self, horizon: int) -> tuple[NDArray[np.intp], Array]:
        """(H,) the steps from here on, and (H, A) the plan's controls, with feedback."""
        rows, nominal = self._planned(horizon)
        nominal[0] -= self._feedback()
        return rows, nominal

    def _planned(self, horizon: int) -> tuple[NDArray[np.intp], Array]:
        """(H,) the steps from here on, and (H, A) the plan's controls, as they were rehearsed."""
        steps = len(self._tracking.ctrl)
        rows = np.minimum(np.arange(self._step, self._step + horizon), steps - 1)
        planned, rehearsed = self._tracking.ctrl[rows], self._rehearsal.ctrl(self._step)[:horizon]
        planned[: len(rehearsed)] = rehearsed
        return rows, planned

    def _rehearse(self) -> None:
        """Rehearses what comes next, unless that has been done."""
        if not self._rehearses or self._step < self._rehearsal.ends:
            return
        last = min(self._step + self._rehearsal.steps_seen, len(self._tracking.ctrl))
        if (rows := np.arange(self._step, last)).size:
            self._begin_tries(rows)
            self._rehearsed += self._rehearsal.rehearse(self._tracking, rows, self._tries.ahead)

    def _astray(self, fingertips: Array, state: int) -> Mask:
        """(F,) which of `fingertips` (F, 3) [m] should play in a state, but not there."""
        offset = (fingertips - self._part.fingertips[state])[:, :2]
        return self._part.playing[state] & (np.linalg.norm(offset, axis=1) > _CAUGHT)

    def _caught(self) -> Mask:
        """(F,) which fingers are astray when the last trial ends."""
        last = min(self._step + self._horizon, len(self._tracking.ctrl))
        return self._astray(self._trials.fingertips(), last)

    def _free_for_good(self, best: Array, here: Array) -> Array:
        """A detour, if fingers stay where they are caught by `best` and it pays in the long run.

        `here` (F, 3) is where they are [m].
        """
        trial = self._tries.one(best)
        stays = np.linalg.norm(self._trials.fingertips() - here, axis=1) < _STUCK
        caught = self._caught()
        if not (trial.mistakes and (caught & stays).any()):
            return best
        rows, nominal = self._nominal(self._further)
        unchanged = self._servos.clip(nominal)
        unchanged[: len(best)] = best
        detours = self._detours.all(nominal, caught, self._here()[:, 0])
        candidates = np.concatenate([unchanged[None], detours])
        self._begin_tries(rows)
        costs = [trial.cost for trial in self._tries.all(candidates)]
        return candidates[int(np.argmin(costs)), : len(best)]

    def _feedback(self) -> Array:
        """(A,) what deviations from the expected positions and speeds take from the controls."""
        return self._tracking.feedback(self._step, self._here())

    def _here(self) -> Array:
        """(A, 2) positions and speeds of the servos now."""
        state = self._twin.state
        joints = np.stack([state.hand_qpos[0], state.hand_qvel[0]], axis=1)  # (J, 2)
        return self._servos.of_joints.T @ joints

    def _search(
        self, nominal: Array, best: Array, known: Rollout, rows: NDArray[np.intp], caught: Mask
    ) -> Array:
        """A cheaper plan than `best` if one is found before the savings are used up.

        Stops when a plan makes no mistakes. Another round must leave savings for the first rounds
        of later steps, which gain the most.
        """
        assert self._update is not None
        if self._proposal and not caught.any():
            proposed, trial = self._proposed(self._proposal, known)
            if trial.cost < known.cost:
                best, known = proposed, trial
                if not known.mistakes:
                    return best
        around = Around(best, np.broadcast_to(self._sigma_at(rows), best.shape))
        for iteration in range(self._iterations):
            if self._savings <= iteration * self._candidates * self._horizon:
                break
            guided = self._corrected(best, known)
            if iteration == 0:
                guided = np.concatenate([guided, self._fresh(nominal, best, caught)])
            candidates = np.concatenate([guided, self._draw(around)])
            trials = self._tries.all(candidates, known.cost)
            more = self._combined(np.array([best, *candidates]), [known, *trials])
            candidates = np.concatenate([candidates, more])
            least = min(trial.cost for trial in (known, *trials))
            trials += self._tries.all(more, least)
            costs = np.array([trial.cost for trial in trials])
            around = self._update(candidates, costs, around)
            first = int(np.argmin(costs))
            if costs[first] < known.cost:
                best, known = candidates[first], trials[first]
                if not known.mistakes:
                    return best
        mean = self._servos.clip(around.mean)
        if not (mean == best).all():
            trial = self._tries.one(mean, known.cost)
            if trial.cost < known.cost:
                return mean
        return best

    def _proposed(self, proposal: Proposal, known: Rollout) -> tuple[Array, Rollout]:
        """(H, A) what networks would do, and what comes of it."""
        _, planned = self._planned(self._horizon)
        controls = self._servos.clip(planned)

        def noted() -> Iterator[Array]:
            now = self._twin.state.key_qpos[0]
            proposed = proposal.controls(self._trials, self._step, planned, self._changed, now)
            for k, ctrl in enumerate(proposed):
                controls[k] = ctrl
                yield ctrl

        return controls, self._tries.one(noted(), known.cost)

    def _combined(self, plans: Array, trials: Sequence[Rollout]) -> Array:
        """(C, H, A) what can be made of plans (N, H, A) that were tried, see `combined`."""
        best = min(range(len(trials)), key=lambda i: trials[i].cost)
        if not trials[best].mistakes:
            return plans[:0]
        costs = [self._tries.ahead.by_finger(trial) for trial in trials]
        return combined(plans, costs, best, self._servos.finger)

    def _fresh(self, nominal: Array, best: Array, caught: Mask) -> Array:
        """(N, H, A) the plan without a correction, and ways to free fingers that are `caught`."""
        candidates = [self._servos.clip(nominal), self._detours.lifted(best, self._step)]
        if caught.any():
            here = self._here()[:, 0]
            candidates.extend(self._detours.some(nominal, caught, here, self._step))
        return np.array(candidates)

    def _corrected(self, plan: Array, trial: Rollout) -> Array:
        """(C, H, A) the plan, changed so that fingertips go where they should.

        A control changes by what would take fingertips there, in least squares, from where the
        trial of the plan has them a step later: iterative learning control (Arimoto et al., 1984).
        There are none if the trial was given up.
        """
        if not np.isfinite(trial.cost):
            return plan[None][:0]
        off, weight = self._tries.ahead.astray(np.array(trial.fingertips))
        change = self._toward.of(self._trials, np.array(trial.hand_qpos), off, weight)
        rows = np.minimum(np.arange(1, len(plan) + 1), len(change) - 1)
        return self._servos.clip(plan + _CORRECTED[:, None, None] * change[rows])

    def _draw(self, around: Around) -> Array:
        """(N, H, A) candidates: noise that changes evenly from the first step to the last."""
        servos = len(self._servos.noise)
        ends = self._rng.standard_normal((self._candidates, 2, 1, servos))
        late = np.linspace(0.0, 1.0, self._horizon)[:, None]
        noise = (1 - late) * ends[:, 0] + late * ends[:, 1]
        sparse = self._rng.random((self._candidates, 1, servos)) < _SPARSE
        sparse[: self._candidates // 2] = True
        return self._servos.clip(around.mean + around.sigma * noise * sparse)

    def _sigma_at(self, rows: NDArray[np.intp]) -> Array:
        playing = self._part.playing[np.append(rows, rows[-1] + 1)].any(axis=0)
        finger = self._servos.finger
        busy = (finger < 0) | playing[finger]
        return self._servos.noise * np.where(busy, 1.0, _IDLE_FINGER)

    def _begin_tries(self, rows: NDArray[np.intp]) -> None:
        """From where the hand is, over all keys on its way through the steps `rows`."""
        inside = rows[: len(self._tracking.ctrl) - self._step]  # after those, nothing matters
        ahead = look_ahead(self._part, inside, self._keyboard, self._trials, self._twin)
        self._tries.begin(ahead)


class SearchState(NamedTuple):
    """What decides how a hand goes on, beside where it is."""

    correction: Array
    """(H, A) to the plan, of the steps that are looked ahead."""
    savings: Array
    """() control steps that it may simulate."""
    rng: NDArray[np.uint64]
    """(6,) where its generator of random numbers is."""


def words_of(rng: np.random.Generator) -> NDArray[np.uint64]:
    """(6,) the state of a default generator, in words of 64 bits."""
    state: Any = rng.bit_generator.state
    numbers = [state["state"]["state"], state["state"]["inc"]]
    halves = [half for number in numbers for half in divmod(number, 2**64)]
    return np.array([*halves, state["has_uint32"], state["uinteger"]], np.uint64)


def generator_of(words: NDArray[np.uint64]) -> np.random.Generator:
    """The generator whose state that is."""
    state, more, inc, less, has, left = words.tolist()
    rng = np.random.default_rng(0)
    numbers = {"state": state * 2**64 + more, "inc": inc * 2**64 + less}
    known: Any = rng.bit_generator.state
    rng.bit_generator.state = known | {"state": numbers, "has_uint32": has, "uinteger": left}
    return rng
