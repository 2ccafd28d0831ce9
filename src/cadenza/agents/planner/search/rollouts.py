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

_EVALUATED = 4  # steps at a time, as one by one it takes about as long as to simulate them
_EXPECTED = 0.8  # share of the least cost-to-go that was seen, which a rollout is expected to have


class Rollout(NamedTuple):
    """A simulated control sequence, of the L steps that were simulated."""

    cost: float  # the cost of all steps, infinite if the rollout was given up or diverged
    mistakes: int  # the number of wrong keys, summed over the steps
    step_costs: list[float]
    fingertips: list[Array]  # (F, 3) after each step [m]
    hand_qpos: list[Array]  # (J,) after each step [m, rad]
    key_qvel: list[Array]  # (K,) after each step [rad/s]
    key_paths: list[Array]  # (S + 1, K) before each step and after each of its physics steps [rad]
    # Cost and mistakes so far, and the keys as far as they matter to the cost, after each step
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
    start: Keys  # the state of the keys before the first step, as far as it matters to the cost

    def costs(
        self, first: int, key_paths: Array, fingertips: Array, before: Keys
    ) -> list[tuple[float, int, Keys]]:
        """Cost and mistakes of L steps, from the `first` on, each with the keys after it.

        Keys are at `key_paths` (L, S + 1, K) before each step and after each of its physics steps
        [rad], and fingertips (L, F, 3) after each [m].
        """


def start_rollouts(
    simulator: HandRollouts,
    simulation: PlanningSimulation,
    goals: HandGoals,
    steps: NDArray[np.intp],
    keyboard: Keyboard,
) -> HorizonCost:
    """Make rollouts start where a hand is, on all keys on its path through `steps` (H,).

    The simulation is of the hand on all keys, in its present state. Returns the cost of rollouts
    over these steps.
    """
    y_now = simulation.state.fingertip_xpos[0, goals.fingers, 1]
    y = np.append(goals.fingertips[steps + 1, :, 1], y_now)
    simulator.start_from(simulation, float(y.min()), float(y.max()))
    return cost_from(simulation.state, goals, steps, keyboard, simulator.keys)


def cost_from(
    state: State, goals: HandGoals, steps: NDArray[np.intp], keyboard: Keyboard, keys: slice
) -> HorizonCost:
    """The cost of these keys in `steps` (H,) that begin in a state of the hand on all keys."""
    ceased = state.key_events[1][0, keys]
    silent = np.where(np.isnan(ceased), np.inf, goals.dt - ceased)
    return HorizonCost(goals, steps, keyboard, keys, state.key_qpos[0, keys], silent)


def roll_out(
    simulator: HandRollouts,
    horizon: Cost[Keys],
    ctrl: Iterable[Array],
    *,
    cost_steps: int | None = None,
    cutoff: float = np.inf,
    cost_to_go: Array | None = None,
    begun: Rollout | None = None,
    first: int = 0,
    kept: Sequence[int] = (),
) -> Rollout:
    """Simulate controls (H, A), whose rows may depend on the state that was reached.

    The first `cost_steps` count in the cost and the mistakes, all by default. With `cost_to_go`
    (H,), which is expected after each step, a rollout that is to cost `cutoff` is given up, as soon
    as it is evaluated. A rollout that has `begun` as another one takes over its steps before the
    `first` of its own, to which `ctrl` then belongs; see `HandRollouts.run`.
    """
    so_far = Rollout(0.0, 0, [], [], [], [], [], []) if begun is None else begun.until(first)
    cost_steps = horizon.num_steps if cost_steps is None else cost_steps
    ctrl, given_up = islice(ctrl, horizon.num_steps - first), False
    for step, (key_path, fingertips) in enumerate(simulator.run(ctrl, first, kept), first):
        so_far.fingertips.append(fingertips)
        so_far.hand_qpos.append(simulator.hand_joints()[0].copy())
        so_far.key_paths.append(key_path)
        so_far.key_qvel.append(simulator.key_qvel().copy())
        if cost_to_go is not None and (step + 1) % _EVALUATED == 0:
            _evaluate(so_far, horizon, cost_steps)
            if given_up := bool(so_far.totals[-1][0] + cost_to_go[step] >= cutoff):
                break
    _evaluate(so_far, horizon, cost_steps)
    cost, mistakes, _ = so_far.totals[-1]
    useless = given_up or simulator.unstable()
    return so_far._replace(cost=np.inf if useless else cost, mistakes=mistakes)


def _evaluate(rollout: Rollout, horizon: Cost[Keys], cost_steps: int) -> None:
    """Add what the last steps of a rollout cost, as far as they are among its `cost_steps`."""
    first = len(rollout.totals)
    if first == len(rollout.key_paths):
        return
    cost, mistakes, before = rollout.totals[-1] if first else (0.0, 0, horizon.start)
    paths, fingertips = np.array(rollout.key_paths[first:]), np.array(rollout.fingertips[first:])
    costs = horizon.costs(first, paths, fingertips, before)
    for step, (more, wrong, keys) in enumerate(costs, first):
        if step < cost_steps:
            cost, mistakes = cost + more, mistakes + wrong
        rollout.step_costs.append(more)
        rollout.totals.append((cost, mistakes, keys))


class Rollouts:
    """Rollouts of candidates for the same steps, all from the same state.

    Attributes:
        simulated: control steps in all rollouts so far.
    """

    def __init__(self, simulator: HandRollouts) -> None:
        """Prepare rollouts, which begin with `start`."""
        self._simulator, self.simulated = simulator, 0

    def start(self, horizon: Cost[Any]) -> None:
        """Begin rollouts with this cost from the state that the simulator starts from."""
        self._horizon = horizon
        self._min_costs = np.full(horizon.num_steps, np.inf)

    def simulate(self, ctrl: Iterable[Array], cutoff: float = np.inf) -> Rollout:
        """Simulate controls (H, A), unless they are likely to cost `cutoff` or more.

        The rollout is then given up before its end, at infinite cost.
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
        """Simulate candidates (N, H, A), and give up any that would cost more than the best."""
        rollouts = list[Rollout]()
        for ctrl in candidates:
            rollouts.append(self.simulate(ctrl, cutoff))
            cutoff = min(cutoff, rollouts[-1].cost)
        return rollouts
