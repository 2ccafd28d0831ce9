"""A song with its fingers, and the hands that play and practise it so."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.hand_part import HandPart
from cadenza.agents.planning.hand_practice import HandPractice
from cadenza.agents.planning.searching import SearchingHands
from cadenza.agents.planning.song_plan import plan_song
from cadenza.agents.planning.takes import Stage, Take
from cadenza.sim.threads import Threads
from cadenza.tasks.goal_track import GoalTrack


class Version:
    """A song as it is played with certain fingers.

    Attributes:
        plan: of the whole song, before practice.
        parts: of the hands.
        searching: what plays at sight.
        hands: that practise.
        stage: where takes are played.
    """

    def __init__(
        self,
        track: GoalTrack,
        start: Array,
        config: ScorePlannerConfig,
        rng: np.random.Generator,
        threads: Threads,
        progress: Progress = silent,
    ) -> None:
        """Args:
            track: the song.
            start: (J,) joint positions of the hands where it begins [m, rad].
            config: how to plan.
            rng: what is random in it.
            threads: that share the work.
            progress: is told of "fingers" and "postures".

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        plan = self.plan = plan_song(track, start, progress)
        self.parts = [HandPart(plan, side) for side in plan.scene.sides]
        self.searching = SearchingHands(plan, config, rng, threads)
        self.hands = [
            HandPractice(plan, side, part, threads)
            for side, part in zip(plan.scene.sides, self.parts, strict=True)
        ]
        self.stage = Stage(plan, start, self.parts)

    @property
    def take_to_come(self) -> Take:
        """Of which nothing has been played."""
        plan = self.plan
        return Take.to_come(
            plan.nominal.tracking, plan.scene.keyboard.num_keys, len(plan.scene.sides)
        )
