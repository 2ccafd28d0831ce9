"""A song that is practised in a folder, in one go or in several."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planning.practice import Practice
from cadenza.agents.planning.practised_planner import PractisedHands
from cadenza.agents.planning.score_planner import ScorePlanner
from cadenza.files import read_arrays, write_atomically
from cadenza.performing.performance import perform
from cadenza.performing.planning import Plan, plan_of
from cadenza.performing.setup import Setup

STATE = "practice.npz"
_MOST = 2**32  # bytes: hours of music


class Practising:
    """Practises what was set up, from where the folder says that it was left.

    Attributes:
        practice: how far it has got.
    """

    def __init__(self, setup: Setup, folder: Path, progress: Progress = silent) -> None:
        """Args:
            setup: of the planner.
            folder: where practice is kept.
            progress: is told of "fingers" and "postures".

        Raises:
            CadenzaError: the folder holds practice of something else, or it cannot be read.
        """
        assert isinstance(setup.agent, ScorePlanner)
        self._setup, self._agent, self._path = setup, setup.agent, folder / STATE
        task_rng, rng = np.random.default_rng(setup.seed).spawn(2)
        setup.task.reset([task_rng], [0])
        config, threads = replace(setup.agent.config, effort=0.0), setup.agent.threads
        self.practice = Practice(setup.task.view(), rng, config, threads, progress)
        if self._path.exists():
            arrays = read_arrays(self._path, self.practice.expected(), _MOST)
            self.practice.restore(arrays, self._path)

    def save(self) -> None:
        """Keeps in the folder how far practice has got."""
        with write_atomically(self._path) as file:
            np.savez_compressed(file, allow_pickle=False, **self.practice.state())

    def plan(self, progress: Progress = silent) -> Plan:
        """What is played best so far."""
        practised = self.practice.best().practised
        hands = PractisedHands(practised, self._agent.config, self.practice.plan)
        hands.num_threads = self._agent.num_threads
        setup = replace(self._setup, agent=hands)
        return replace(plan_of(setup, perform(setup, progress)), practised=practised)
