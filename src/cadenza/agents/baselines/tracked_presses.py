"""Optimises the presses of a song beforehand and tracks the result by time-varying LQR.

The paper (Zakka et al., CoRL 2023) names it as an alternative to its planners.
"""

from __future__ import annotations

import math

import numpy as np
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv, Progress
from cadenza.agents.baselines.press_optimisation import PressOptimisation, Trajectory
from cadenza.agents.planner.config import TrackedPressesConfig
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.errors import CadenzaError
from cadenza.fingers import Side
from cadenza.scene.scene import HandAlone, hand_alone
from cadenza.tasks.view import View


class TrackedPresses(PlannerPerEnv["TrackingPlanner"]):
    """Plans everything when an episode begins, and then plays it with feedback.

    The feedback is of positions and speeds of a hand's own joints, not of the keys. Nothing is
    random. Its progress is that of "fingers", "postures" and, a hand at a time, "presses".
    """

    def __init__(self, config: TrackedPressesConfig | None = None) -> None:
        """Raises:
        CadenzaError: an option makes no sense.
        """
        super().__init__()
        self.config = config or TrackedPressesConfig()
        if not 0 <= self.config.iterations < math.inf:
            raise CadenzaError(f"iterations {self.config.iterations}: choose 0 or more")

    def begin(self, view: View, rng: np.random.Generator) -> TrackingPlanner:
        """Raises:
        CadenzaError: there are no hands in the scene.
        """
        return TrackingPlanner(view, self.config, self.threads, self.progress)


class TrackingPlanner(EpisodePlanner):
    """Plays one song.

    Attributes:
        plan: the nominal plan.
        trajectories: optimised, of each hand.
    """

    def __init__(
        self, view: View, config: TrackedPressesConfig, num_threads: int, progress: Progress
    ) -> None:
        """Args:
            view: of the first step, of one environment.
            config: how to plan.
            num_threads: that share the rollouts.
            progress: is told of "fingers", "postures" and "presses".

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        task, start = view.task, view.state.hand_qpos[0]
        self._config, self._num_threads = config, num_threads
        (track,) = view.tracks
        self.plan = plan_song(track.with_found_fingers(), start, progress)
        self._pedal = self.plan.goals.sustain.astype(np.float64)
        self._hands: list[HandAlone] = []
        self.trajectories: list[Trajectory] = []
        for side in task.scene.sides:
            hand = hand_alone(task.scene, side)
            with threadpool_limits(1):  # small matrices, and the same bits everywhere
                optimisation = self._optimisation(side, hand, task.config.control_timestep)
                trajectory = optimisation.optimise(start[hand.joints], progress)
                self.trajectories.append(trajectory)
            self._hands.append(hand)

    def _optimisation(self, side: Side, hand: HandAlone, dt: float) -> PressOptimisation:
        nominal = self.plan.nominal
        mine = [press.first - 1 for press in nominal.presses if press.side == side]
        return PressOptimisation(
            hand.scene,
            HandGoals(self.plan, side),
            np.array(mine, np.intp),
            nominal.tracking.of(hand.servos),
            self._config,
            dt,
            self._num_threads,
        )

    def act(self, view: View) -> Array:
        task, state, step = view.task, view.state, int(view.steps[0])
        action = np.zeros(task.action_size)
        action[-1] = self._pedal[step]
        for (_, servos, joints), planned in zip(self._hands, self.trajectories, strict=True):
            here = np.concatenate([state.hand_qpos[0, joints], state.hand_qvel[0, joints]])
            deviation = here - planned.state[step]
            action[servos] = planned.ctrl[step] + planned.gain[step] @ deviation
        return np.clip(action, task.action_low, task.action_high)
