"""A follower of a finished plan."""

import numpy as np

from cadenza.agents.agent import Array, EpisodePlanner
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.scene.servos import servos_of
from cadenza.tasks.view import View


class PlanFollower(EpisodePlanner):
    """A player of the controls of a plan, with feedback of the positions and speeds of servos.

    Attributes:
        plan: the plan of the whole song.
        tracking: the controls, and the gains of the feedback.
    """

    def __init__(self, plan: SongPlan, tracking: Tracking) -> None:
        self.plan, self.tracking, self._servos = plan, tracking, servos_of(plan.scene)

    def act(self, view: View) -> Array:
        servo_state = self._servos.state(view.state.hand_qpos, view.state.hand_qvel)
        ctrl = self.tracking.controls(self._servos, view.steps, servo_state)
        return np.append(ctrl[0], self.plan.goals.sustain[view.steps])
