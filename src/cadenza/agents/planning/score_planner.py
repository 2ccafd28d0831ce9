"""Plays any score by planning alone: fingering, inverse kinematics of the song, refinement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Array
from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.nominal import Nominal, nominal_plan
from cadenza.agents.planning.refinement import HandPart, HandRefinement
from cadenza.errors import CadenzaError
from cadenza.model.scene import build_scene
from cadenza.music.fingering import Dropped, find_fingering
from cadenza.music.goals import Goals
from cadenza.music.score import Score
from cadenza.sim.simulation import available_cores
from cadenza.tasks.music import goals_of
from cadenza.tasks.piano_task import PianoTask


class ScorePlanner:
    """Plans the whole song when an episode begins, and refines the plan as it goes.

    It plans with the scene that the task's configuration describes: where the task's own scene
    was changed, it does not know.

    Attributes:
        score: the song with the fingers that are to play it, after `reset`.
        dropped: notes that no finger is there for.
        goals: that song per control step.
        nominal: the plan before refinement.
    """

    def __init__(self, config: ScorePlannerConfig | None = None) -> None:
        """Raises:
        CadenzaError: an option makes no sense.
        """
        self.config = config or ScorePlannerConfig()
        _check(self.config)
        self.score = Score(())
        self.dropped: tuple[Dropped, ...] = ()
        self.goals: Goals
        self.nominal: Nominal

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        """Raises:
        CadenzaError: there are no hands in the scene.
        """
        if not task.scene.sides:
            raise CadenzaError("the planner plans for hands, and this scene has none")
        self._task, self._step = task, 0
        self.score, self.dropped = self._fingered(task)
        self.goals = goals = goals_of(self.score, task.config)
        dt = task.config.control_timestep
        scene = build_scene(task.scene.config)
        # BLAS shares small products among threads, which takes longer, and other bits come out.
        with threadpool_limits(1):
            start = task.state.hand_qpos[0]
            self.nominal = nominal_plan(scene, goals.keys, goals.fingers, start, dt)
        self._pedal = goals.sustain.astype(np.float64)
        self._hands = []
        for side, hand_rng in zip(scene.sides, rng.spawn(len(scene.sides)), strict=True):
            alone = build_scene(replace(scene.config, hands=side))
            servos = _ids(alone.actuator_names, scene.actuator_names)
            joints = _ids(alone.hand_joint_names, scene.hand_joint_names)
            part = HandPart(goals.keys, goals.fingers, self.nominal, int(side == "left"))
            threads = available_cores()
            hand = HandRefinement(
                alone, part, self.nominal, servos, self.config, dt, threads, hand_rng
            )
            self._hands.append((hand, servos, joints))

    def _fingered(self, task: PianoTask) -> tuple[Score, tuple[Dropped, ...]]:
        score, sides = task.sheets.songs[0], task.scene.sides
        if self.config.fingering == "found":
            score = score.without_fingers()
        return find_fingering(score, "both" if len(sides) == 2 else sides[0])

    def act(self) -> Array:
        state = self._task.state
        action = np.zeros(self._task.action_size)
        action[-1] = self._pedal[self._step]
        for hand, servos, joints in self._hands:
            action[servos] = hand.act(
                state.hand_qpos[0, joints], state.hand_qvel[0, joints], state.key_qpos[0]
            )
        self._step += 1
        return action


def _ids(names: tuple[str, ...], among: tuple[str, ...]) -> np.ndarray:
    return np.array([among.index(name) for name in names], np.intp)


def _check(config: ScorePlannerConfig) -> None:
    for name, least in (("num_candidates", 4), ("iterations", 1), ("horizon", 0)):
        if not least <= getattr(config, name) < float("inf"):
            raise CadenzaError(f"{name} {getattr(config, name)}: choose {least} or more")
