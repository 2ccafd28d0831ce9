"""One hand that rehearses its plan, half a second at a time, and plays it as it went best."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.plan.hand_goals import ABOUT_TO_PRESS, HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Follower
from cadenza.agents.planner.search.hand_rehearsal import HandRehearsal, RehearsalConfig
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

_REHEARSAL = RehearsalConfig(window=0.5, judged_after=0.5, corrected_after=0.7, max_mistakes=1.0)
_AS_FORESEEN = 1e-3  # [rad] that a key may be off where the rehearsal had it, to be as fast


class RehearsedHand:
    """One hand that plays a plan.

    It rehearses by itself, from the state that it is in when the half second begins. What it does
    not foresee, such as that it touches the other hand, is left to feedback until then.

    Attributes:
        servos: the hand's servos among all of the scene.
        steps_seen: number of steps ahead that it needs a plan of.
    """

    def __init__(self, plan: SongPlan, side: Side, rehearsals: int) -> None:
        """Args:
        plan: of the song, as far as it goes.
        side: of the hand.
        rehearsals: most changes of each half second.
        """
        dt = plan.track.config.control_timestep
        self._side = side
        self._alone, self.servos, self._joints = hand_alone(plan.scene, side)
        self._simulation = PlanningSimulation(self._alone, 1, dt)
        config = _REHEARSAL._replace(iterations=rehearsals + 1)
        self._rehearsal = HandRehearsal(self._alone, HandRollouts(self._alone, dt), dt, config)
        self.steps_seen = self._rehearsal.steps_seen + steps_in(ABOUT_TO_PRESS, dt)
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Plays on from a step by a plan that goes further than the one before."""
        self._goals = HandGoals(plan, self._side)
        tracking = plan.nominal.tracking.of(self.servos)
        self._tracking = tracking._replace(ctrl=tracking.ctrl.copy())
        self._follower = Follower(self._alone, self._tracking)

    def act(self, step: int, state: State) -> Array:
        """(A,) the next controls."""
        qpos, qvel = state.hand_qpos[0, self._joints], state.hand_qvel[0, self._joints]
        if step >= self._rehearsal.end:
            key_qpos = state.key_qpos[0]
            self._simulation.set_joints(qpos, qvel, key_qpos, self._key_qvel(key_qpos))
            self._rehearse(step)
        back = self._tracking.feedback(step, self._follower.posture(qpos, qvel))
        return self._follower.clip(self._rehearsal.ctrl(step)[0] - back)

    def _rehearse(self, step: int) -> None:
        """Rehearses the steps from one on."""
        last = min(step + self._rehearsal.steps_seen, len(self._tracking.ctrl))
        rows = np.arange(step, last)
        if step == self._rehearsal.end:  # the one before has found how to begin
            known = self._rehearsal.tail
            self._tracking.ctrl[step : step + len(known)] = known
        self._rehearsal.rehearse(self._goals, self._tracking, rows, self._simulation)

    def _key_qvel(self, key_qpos: Array) -> Array:
        """(K,) speeds of keys at (K,), as far as they were foreseen: no state says them."""
        speeds, keys = np.zeros_like(key_qpos), self._rehearsal.keys
        there, speed = self._rehearsal.keys_at_end
        speeds[keys] = np.where(np.abs(key_qpos[keys] - there) < _AS_FORESEEN, speed, 0.0)
        return speeds
