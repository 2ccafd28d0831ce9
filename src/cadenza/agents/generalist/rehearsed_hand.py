"""A hand that rehearses each half second of a plan before it plays it."""

import numpy as np

from cadenza.agents.agent import Array, steps_in
from cadenza.agents.planner.plan.hand_goals import ABOUT_TO_PRESS, HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.hand_rehearsal import HandRehearsal, RehearsalConfig
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

_REHEARSAL = RehearsalConfig(
    window=0.5, cost_after=0.5, updated_after=0.7, max_mistakes=1.0, refinements=3
)
_AS_FORESEEN = 1e-3  # [rad] from the key's angle in the rehearsal, within which its speed is known


class RehearsedHand:
    """A hand that plays a plan.

    It rehearses each half second by itself, from its state when the half second begins. Within it,
    feedback makes up for what the rehearsal does not foresee, such as contact with the other hand.

    Attributes:
        servos: the hand's servos among those of the scene.
        joints: the hand's joints among those of the scene.
        rehearsal: the rehearsal of the current half second.
        lookahead: the number of steps of the plan that are needed.
    """

    def __init__(self, plan: SongPlan, side: Side, rehearsals: int) -> None:
        """Follow a plan, and change each half second of it at most `rehearsals` times."""
        dt = plan.track.config.control_timestep
        self._side = side
        alone, self.servos, self.joints = hand_alone(plan.scene, side)
        self._servos, self._simulation = servos_of(alone), PlanningSimulation(alone, 1, dt)
        config = _REHEARSAL._replace(iterations=rehearsals + 1)
        self.rehearsal = HandRehearsal(alone, HandRollouts(alone, dt), dt, config)
        self.lookahead = self.rehearsal.lookahead + steps_in(ABOUT_TO_PRESS, dt)
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a longer plan."""
        self._goals = HandGoals(plan, self._side)
        tracking = plan.nominal.tracking.of(self.servos)
        self._tracking = tracking._replace(ctrl=tracking.ctrl.copy())

    def act(self, step: int, state: State) -> Array:
        """Next controls (A,)."""
        qpos, qvel = state.hand_qpos[0, self.joints], state.hand_qvel[0, self.joints]
        if step >= self.rehearsal.end:
            key_qpos = state.key_qpos[0]
            self._simulation.set_joints(qpos, qvel, key_qpos, self._key_qvel(key_qpos))
            self._rehearse(step)
        feedback = self._tracking.feedback(step, self._servos.state(qpos, qvel))
        return self._servos.clip(self.rehearsal.ctrl(step)[0] - feedback)

    def _rehearse(self, step: int) -> None:
        """Rehearse the steps from `step` on."""
        last = min(step + self.rehearsal.lookahead, len(self._tracking.ctrl))
        rows = np.arange(step, last)
        if step == self.rehearsal.end:  # the last rehearsal has changed the first of these steps
            tail = self.rehearsal.tail
            self._tracking.ctrl[step : step + len(tail)] = tail
        self.rehearsal.rehearse(self._goals, self._tracking, rows, self._simulation)

    def _key_qvel(self, key_qpos: Array) -> Array:
        """Speeds (K,) of keys, unmeasured: as rehearsed where they are as rehearsed, else 0."""
        speeds, keys = np.zeros_like(key_qpos), self.rehearsal.keys
        qpos, qvel = self.rehearsal.keys_at_end
        speeds[keys] = np.where(np.abs(key_qpos[keys] - qpos) < _AS_FORESEEN, qvel, 0.0)
        return speeds
