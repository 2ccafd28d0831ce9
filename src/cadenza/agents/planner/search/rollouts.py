"""Rollouts of candidates for a hand's controls over the look-ahead horizon."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.search.horizon_cost import HorizonCost
from cadenza.keyboards.keyboard import Keyboard
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

Keys = TypeVar("Keys")

_BATCH = 4  # steps to evaluate together: one by one takes about as long as their simulation
_EXPECTED = 0.8  # expected cost-to-go, as a share of the minimum of earlier rollouts


class Rollout(NamedTuple):
    """A simulated control sequence of L steps."""

    cost: float  # the cost of all steps, infinite if the rollout was given up or diverged
    mistakes: int  # the number of wrong keys, summed over the steps
    step_costs: list[float]
    fingertips: list[Array]  # (F, 3) after each step [m]
    hand_qpos: list[Array]  # (J,) after each step [m, rad]
    key_qvel: list[Array]  # (K,) after each step [rad/s]
    key_paths: list[Array]  # (S + 1, K) before each step and after each of its physics steps [rad]
    # Cost and mistakes so far, and the state of the keys that the cost needs, after each step
    totals: list[tuple[float, int, Any]]

    @property
    def key_qpos(self) -> list[Array]:
        """(K,) after each step, of the keys that are simulated [rad]."""
        return [path[-1] for path in self.key_paths]

    def until(self, step: int) -> Rollout:
        """The steps before `step`, in lists of their own."""
        cost, mistakes, _ = self.totals[step - 1] if step else (0.0, 0, None)
        return Rollout(
            cost,
            mistakes,
            self.step_costs[:step],
            self.fingertips[:step],
            self.hand_qpos[:step],
            self.key_qvel[:step],
            self.key_paths[:step],
            self.totals[:step],
        )


class Cost(Protocol[Keys]):
    """The cost of rollouts of H steps."""

    num_steps: int  # H, the number of steps
    start: Keys  # the state of the keys before the first step that the cost needs

    def costs(
        self, first: int, key_paths: Array, fingertips: Array, before: Keys
    ) -> list[tuple[float, int, Keys]]:
        """Cost and mistakes of L steps from `first` on, each with the keys after it.

        Keys are at `key_paths` (L, S + 1, K) before each step and after each of its physics steps
        [rad], fingertips at (L, F, 3) after each step [m], and `before` is the last state of the
        keys.
        """


def start_rollouts(
    simulator: HandRollouts,
    simulation: PlanningSimulation,
    goals: HandGoals,
    steps: NDArray[np.intp],
    keyboard: Keyboard,
) -> HorizonCost:
    """Make rollouts start from the state of a hand, with all keys on its path through `steps` (H,).

    The simulation is of the hand on all keys, in its current state. Returns the cost of rollouts
    over these steps.
    """
    y_now = simulation.state.fingertip_xpos[0, goals.fingers, 1]
    y = np.append(goals.fingertips[steps + 1, :, 1], y_now)
    simulator.start_from(simulation, float(y.min()), float(y.max()))
    return cost_from(simulation.state, goals, steps, keyboard, simulator.keys)


def cost_from(
    state: State, goals: HandGoals, steps: NDArray[np.intp], keyboard: Keyboard, keys: slice
) -> HorizonCost:
    """The cost of `keys` in `steps` (H,) that begin in a state of the hand on all keys."""
    offset = state.key_events[1][0, keys]
    silent = np.where(np.isnan(offset), np.inf, goals.dt - offset)
    return HorizonCost(goals, steps, keyboard, keys, state.key_qpos[0, keys], silent)


def roll_out(
    simulator: HandRollouts,
    horizon: Cost[Keys],
    ctrl: Iterable[Array],
    *,
    cost_steps: int | None = None,
    cutoff: float = np.inf,
    cost_to_go: Array | None = None,
    previous: Rollout | None = None,
    first: int = 0,
    snapshots: Sequence[int] = (),
) -> Rollout:
    """Simulate controls (H, A), whose rows may depend on the state reached so far.

    Args:
        simulator: the simulation of a hand, in its state before the first step.
        horizon: the cost of the steps.
        ctrl: the controls, from the step `first` on.
        cost_steps: the number of steps that count in the cost and the mistakes, all by default.
        cutoff: the cost at which the rollout is given up.
        cost_to_go: (H,) expected costs after each step; without them, it is never given up.
        previous: a rollout with the same controls before the step `first`, whose steps are reused.
        first: the first step to simulate.
        snapshots: steps at which a later rollout may begin, see `HandRollouts.run`.
    """
    result = Rollout(0.0, 0, [], [], [], [], [], []) if previous is None else previous.until(first)
    cost_steps = horizon.num_steps if cost_steps is None else cost_steps
    ctrl, given_up = islice(ctrl, horizon.num_steps - first), False
    for step, (key_path, fingertips) in enumerate(simulator.run(ctrl, first, snapshots), first):
        result.fingertips.append(fingertips)
        result.hand_qpos.append(simulator.hand_joints()[0].copy())
        result.key_paths.append(key_path)
        result.key_qvel.append(simulator.key_qvel().copy())
        if cost_to_go is not None and (step + 1) % _BATCH == 0:
            _evaluate(result, horizon, cost_steps)
            if given_up := bool(result.totals[-1][0] + cost_to_go[step] >= cutoff):
                break
    _evaluate(result, horizon, cost_steps)
    cost, mistakes, _ = result.totals[-1]
    useless = given_up or simulator.unstable()
    return result._replace(cost=np.inf if useless else cost, mistakes=mistakes)


def _evaluate(rollout: Rollout, horizon: Cost[Keys], cost_steps: int) -> None:
    """Evaluate the new steps of a rollout; those before `cost_steps` count in its cost."""
    first = len(rollout.totals)
    if first == len(rollout.key_paths):
        return
    cost, mistakes, before = rollout.totals[-1] if first else (0.0, 0, horizon.start)
    paths, fingertips = np.array(rollout.key_paths[first:]), np.array(rollout.fingertips[first:])
    costs = horizon.costs(first, paths, fingertips, before)
    for step, (step_cost, step_mistakes, keys) in enumerate(costs, first):
        if step < cost_steps:
            cost, mistakes = cost + step_cost, mistakes + step_mistakes
        rollout.step_costs.append(step_cost)
        rollout.totals.append((cost, mistakes, keys))


class Rollouts:
    """Rollouts of candidates for the same steps, all from the same state.

    Attributes:
        simulated: control steps in all rollouts so far.
    """

    def __init__(self, simulator: HandRollouts) -> None:
        """Prepare rollouts; call `start` before them."""
        self._simulator, self.simulated = simulator, 0

    def start(self, horizon: Cost[Any]) -> None:
        """Begin rollouts with this cost, from the start of the simulator."""
        self._horizon = horizon
        self._min_costs = np.full(horizon.num_steps, np.inf)

    def simulate(self, ctrl: Iterable[Array], cutoff: float = np.inf) -> Rollout:
        """Simulate controls (H, A).

        The rollout is given up, at infinite cost, when it is likely to cost `cutoff` or more.
        """
        cost_to_go = None
        if cutoff < np.inf:
            cost_to_go = _EXPECTED * (self._min_costs.sum() - np.cumsum(self._min_costs))
        rollout = roll_out(
            self._simulator, self._horizon, ctrl, cutoff=cutoff, cost_to_go=cost_to_go
        )
        steps = len(rollout.step_costs)
        self.simulated += steps
        self._min_costs[:steps] = np.minimum(self._min_costs[:steps], rollout.step_costs)
        return rollout

    def simulate_all(
        self, candidates: Iterable[Iterable[Array]], cutoff: float = np.inf
    ) -> list[Rollout]:
        """Simulate candidates (N, H, A), and give up those that would cost more than the best."""
        rollouts = list[Rollout]()
        for ctrl in candidates:
            rollouts.append(self.simulate(ctrl, cutoff))
            cutoff = min(cutoff, rollouts[-1].cost)
        return rollouts
