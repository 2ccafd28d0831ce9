"""Plays any score by planning alone: fingering, inverse kinematics of the song, refinement."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.refinement import HandPart, HandRefinement
from cadenza.agents.planning.song_plan import SongPlan, song_plans
from cadenza.configs import check_ranges
from cadenza.scene.scene import hand_alone
from cadenza.sim.threads import available_cores
from cadenza.tasks.piano_task import PianoTask


class ScorePlanner:
    """Plans a song a window ahead of where it plays, and refines the plan as it goes.

    Attributes:
        plan: before refinement, as far as it goes; all of it when the song is over.
        progress: is told of "fingers" and "postures".
    """

    plan: SongPlan
    progress: Progress

    def __init__(self, config: ScorePlannerConfig | None = None) -> None:
        """Raises:
        CadenzaError: an option makes no sense.
        """
        self.config = config or ScorePlannerConfig()
        self.progress = silent
        _check(self.config)

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        """Raises:
        CadenzaError: there are no hands in the scene.
        """
        self._task, self._step = task, 0
        score = task.sheets.songs[0]
        found = self.config.fingering == "found"
        score = score.without_fingers() if found else score
        self._plans = song_plans(task, score, self.progress)
        self.plan = next(self._plans)
        scene, dt = task.scene, task.config.control_timestep
        self._pedal = self.plan.goals.sustain.astype(np.float64)
        self._hands = []
        for side, hand_rng in zip(scene.sides, rng.spawn(len(scene.sides)), strict=True):
            alone, servos, joints = hand_alone(scene, side)
            part, tracking = HandPart(self.plan, side), self.plan.nominal.tracking.of(servos)
            threads = available_cores()
            hand = HandRefinement(alone, part, tracking, self.config, dt, threads, hand_rng)
            self._hands.append((hand, servos, joints))

    def act(self) -> Array:
        self._plan_ahead()
        state = self._task.state
        action = np.zeros(self._task.action_size)
        action[-1] = self._pedal[self._step]
        for hand, servos, joints in self._hands:
            action[servos] = hand.act(
                state.hand_qpos[0, joints], state.hand_qvel[0, joints], state.key_qpos[0]
            )
        self._step += 1
        return action

    def _plan_ahead(self) -> None:
        """Plans another window before what a hand looks at from here ends."""
        seen = self._step + max(hand.steps_seen for hand, _, _ in self._hands)
        while not self.plan.complete and self.plan.nominal.num_steps < seen:
            self.plan = next(self._plans)
            for (hand, servos, _), side in zip(self._hands, self._task.scene.sides, strict=True):
                hand.follow(HandPart(self.plan, side), self.plan.nominal.tracking.of(servos))


def _check(config: ScorePlannerConfig) -> None:
    check_ranges(
        config, {"num_candidates": (4, 10_000), "iterations": (1, 10_000), "horizon": (0, 60)}
    )
