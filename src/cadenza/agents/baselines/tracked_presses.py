"""Optimises the presses of a song beforehand and tracks the result by time-varying LQR.

The paper (Zakka et al., CoRL 2023) names it as an alternative to its planners.
"""

from __future__ import annotations

import math

import numpy as np
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.baselines.press_optimisation import PressOptimisation, Trajectory
from cadenza.agents.planning.config import TrackedPressesConfig
from cadenza.agents.planning.refinement import HandPart
from cadenza.agents.planning.song_plan import SongPlan, plan_song
from cadenza.errors import CadenzaError
from cadenza.fingers import Side
from cadenza.scene.scene import HandAlone, hand_alone
from cadenza.sim.threads import available_cores
from cadenza.tasks.piano_task import PianoTask


class TrackedPresses:
    """Plans everything when an episode begins; then only feedback is left.

    What is fed back are positions and speeds of a hand's own joints, not the keys'. Nothing is
    random.

    Attributes:
        plan: before it is optimised, after `reset`.
        trajectories: what each hand is to do.
        progress: is told of "fingers", "postures" and, a hand at a time, "presses".
    """

    plan: SongPlan
    progress: Progress

    def __init__(self, config: TrackedPressesConfig | None = None) -> None:
        """Raises:
        CadenzaError: an option makes no sense.
        """
        self.config = config or TrackedPressesConfig()
        if not 0 <= self.config.iterations < math.inf:
            raise CadenzaError(f"iterations {self.config.iterations}: choose 0 or more")
        self.trajectories: list[Trajectory] = []
        self.progress = silent

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        """Raises:
        CadenzaError: there are no hands in the scene.
        """
        self.plan = plan_song(task, task.sheets.songs[0].without_fingers(), self.progress)
        self._pedal = self.plan.goals.sustain.astype(np.float64)
        self._task, self._step = task, 0
        self._hands, self.trajectories = list[HandAlone](), []
        for side in task.scene.sides:
            hand = hand_alone(task.scene, side)
            with threadpool_limits(1):  # small matrices, and the same bits everywhere
                optimisation = self._optimisation(task, side, hand)
                start = task.state.hand_qpos[0, hand.joints]
                self.trajectories.append(optimisation.optimise(start, self.progress))
            self._hands.append(hand)

    def _optimisation(self, task: PianoTask, side: Side, hand: HandAlone) -> PressOptimisation:
        nominal = self.plan.nominal
        mine = [press.first - 1 for press in nominal.presses if press.side == side]
        return PressOptimisation(
            hand.scene,
            HandPart(self.plan, side),
            np.array(mine, np.intp),
            nominal.tracking.of(hand.servos),
            self.config,
            task.config.control_timestep,
            available_cores(),
        )

    def act(self) -> Array:
        task, state = self._task, self._task.state
        action = np.zeros(task.action_size)
        action[-1] = self._pedal[self._step]
        for (_, servos, joints), planned in zip(self._hands, self.trajectories, strict=True):
            here = np.concatenate([state.hand_qpos[0, joints], state.hand_qvel[0, joints]])
            deviation = here - planned.state[self._step]
            action[servos] = planned.ctrl[self._step] + planned.gain[self._step] @ deviation
        self._step += 1
        return np.clip(action, task.action_low, task.action_high)
