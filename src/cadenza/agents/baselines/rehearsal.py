"""Plays a plan through in simulation before the performance, and keeps what mended it."""

from __future__ import annotations

import numpy as np

from cadenza.agents.agent import Array, Progress
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Follower, Tracking
from cadenza.agents.planner.search.hands_in_scene import HandInScene
from cadenza.scene.scene import hand_alone
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.threads import Threads

# The hand looks for longer than while it plays, and not as far ahead.
_SEARCH = PlannerConfig(num_candidates=16, iterations=8, horizon=0.3, proposals="none")


def rehearsed(
    plan: SongPlan, start: Array, rng: np.random.Generator, num_threads: int, progress: Progress
) -> Tracking:
    """Controls of a rehearsal in which the planner's sampling refined the plan, and its states.

    Each hand rehearses by itself. What disturbs it only in the performance, such as another arm,
    is left to feedback.

    Args:
        plan: of the whole song.
        start: (J,) where the joints of the hands begin [m, rad].
        rng: what is random.
        num_threads: that share the search.
        progress: is told of "rehearsing".
    """
    tracking = plan.nominal.tracking
    ctrl, expected = tracking.ctrl.copy(), tracking.expected.copy()
    sides, dt = plan.scene.sides, plan.track.config.control_timestep
    threads, steps = Threads(num_threads), len(ctrl)
    try:
        for i, side in enumerate(sides):
            hand = HandInScene(plan, side, _SEARCH, rng, threads)
            scene, mine, joints = hand_alone(plan.scene, side)
            follower = Follower(scene, tracking.of(mine))
            simulation = MujocoSimulation(scene, 1, dt)
            simulation.reset([0], start[None, joints])
            for step in range(steps):
                state = simulation.state
                qpos, qvel, keys = state.hand_qpos[0], state.hand_qvel[0], state.key_qpos[0]
                ctrl[step, mine] = hand.search.act(qpos, qvel, keys)
                simulation.step(ctrl[step : step + 1, mine])
                state = simulation.state
                expected[step + 1, mine] = follower.posture(state.hand_qpos, state.hand_qvel)[0]
                progress("rehearsing", i * steps + step + 1, len(sides) * steps)
    finally:
        threads.close()
    return tracking._replace(ctrl=ctrl, expected=expected)
