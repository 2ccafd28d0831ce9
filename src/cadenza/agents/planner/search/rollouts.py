"""Simulates plans of a hand's next steps in simulation, and tells what they cost."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.search.horizon_cost import HorizonCost, Rollout
from cadenza.sim.hand_rollouts import PLACES, HandRollouts
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]

EXPECTED = 0.8  # of the least that a step has cost in other plans, it will cost in this one


class Rollouts:
    """Plans of the same steps, all from where trials of a hand begin.

    Attributes:
        ahead: what the steps ask of the hand.
        simulated: control steps, in all trials of plans so far.
    """

    ahead: HorizonCost

    def __init__(self, trials: HandRollouts, threads: Threads, *, to_their_end: bool) -> None:
        """Args:
        trials: of the hand.
        threads: that share them.
        to_their_end: whether, of many plans, the costs of those count that are no better than
            others. Otherwise they are given up.
        """
        self._trials, self._threads, self._to_their_end = trials, threads, to_their_end
        self.simulated = 0

    def begin(self, ahead: HorizonCost) -> None:
        """Plans are of the steps that are `ahead` from here on, where trials begin now."""
        self.ahead = ahead
        self._least = np.full(ahead.num_steps, np.inf)

    def one(self, ctrl: Iterable[Array], most: float = np.inf) -> Rollout:
        """Simulates a plan (H, A).

        One that will hardly cost less than `most` is given up before its end, at infinite cost: its
        remaining steps are expected to cost most of the least that they cost any plan so far.
        """
        trial = self._run(ctrl, most)
        self._note(trial)
        return trial

    def all(self, candidates: Array, most: float = np.inf) -> list[Rollout]:
        """Simulates plans (N, H, A); those that cost more than `most` or another one are of no use.

        They are tried in pairs, so that an idle thread can take one of each: what is known of the
        pairs before decides what is given up, however many threads there are.
        """
        trials = list[Rollout]()
        for i in range(0, len(candidates), PLACES):
            useful = np.inf if self._to_their_end else most
            runs = [
                partial(self._run, ctrl, useful, place)
                for place, ctrl in enumerate(candidates[i : i + PLACES])
            ]
            for trial in self._threads.together(runs):
                self._note(trial)
                trials.append(trial)
                most = min(most, trial.cost)
        return trials

    def _run(self, ctrl: Iterable[Array], most: float, place: int = 0) -> Rollout:
        rest = self._least.sum() - np.cumsum(self._least) if most < np.inf else None
        cost, mistakes, steps = 0.0, 0, list[float]()
        tips, qpos, keys = list[Array](), list[Array](), list[Array]()
        given_up, sounding = False, self.ahead.sounding
        inside = islice(ctrl, len(self._least))
        for k, (key_qpos, fingertips) in enumerate(self._trials.run(inside, place)):
            more, wrong, sounding = self.ahead.cost(k, key_qpos, fingertips, sounding)
            cost, mistakes = cost + more, mistakes + wrong
            steps.append(more)
            tips.append(fingertips)
            qpos.append(self._trials.hand_joints(place)[0].copy())
            keys.append(key_qpos.copy())
            given_up = rest is not None and cost + EXPECTED * rest[k] >= most
            if given_up:
                break
        no_use = given_up or self._trials.unstable(place)
        return Rollout(np.inf if no_use else cost, mistakes, steps, tips, qpos, keys)

    def _note(self, trial: Rollout) -> None:
        """Reckons with a trial."""
        taken = len(trial.steps)
        self.simulated += taken
        self._least[:taken] = np.minimum(self._least[:taken], trial.steps)
