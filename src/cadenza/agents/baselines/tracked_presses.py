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
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.errors import CadenzaError
from cadenza.tasks.view import View


class TrackedPresses(PlannerPerEnv["TrackingPlanner"]):
    """Plans everything when an episode begins, and then plays it with feedback.

    The feedback is of positions and speeds of a hand's own joints, not of the keys. Nothing is
    random. It reports the progress of "fingers", "postures" and, a hand at a time, "presses".
    """

    def __init__(self, config: TrackedPressesConfig | None = None) -> None:
        """Checks the options.

        Raises:
            CadenzaError: an option makes no sense.
        """
        super().__init__()
        self.config = config or TrackedPressesConfig()
        if not 0 <= self.config.iterations < math.inf:
            raise CadenzaError(f"iterations {self.config.iterations}: choose 0 or more")

    def begin(self, view: View, rng: np.random.Generator) -> TrackingPlanner:
        return TrackingPlanner(view, self.config, self.threads, self.progress)


class TrackingPlanner(EpisodePlanner):
    """Plays one song.

    Attributes:
        plan: the nominal plan.
        trajectories: the optimised trajectory of each hand.
    """

    plan: SongPlan

    def __init__(
        self, view: View, config: TrackedPressesConfig, num_threads: int, progress: Progress
    ) -> None:
        """Plans and optimises, from the view of the first step of one environment.

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        (track,), start = view.tracks, view.state.hand_qpos[0]
        self.plan = plan_song(track.with_found_fingers(), start, progress)
        scene = self.plan.scene
        self.trajectories: list[Trajectory] = []
        with threadpool_limits(1):  # small matrices, and the same bits everywhere
            for side in scene.sides:
                hand = PressOptimisation(self.plan, side, config.iterations, num_threads)
                self.trajectories.append(hand.optimise(start[scene.joints_on(side)], progress))

    def act(self, view: View) -> Array:
        task, state, step = view.task, view.state, int(view.steps[0])
        action = np.zeros(task.action_size)
        action[-1] = self.plan.goals.sustain[step]
        for side, planned in zip(task.scene.sides, self.trajectories, strict=True):
            joints = task.scene.joints_on(side)
            here = np.concatenate([state.hand_qpos[0, joints], state.hand_qvel[0, joints]])
            deviation = here - planned.state[step]
            ctrl = planned.ctrl[step] + planned.gain[step] @ deviation
            action[task.scene.servos_on(side)] = ctrl
        return np.clip(action, task.action_low, task.action_high)
