"""Estimates how long planning and playing will take, before it begins."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from cadenza.cli.progress import QUIET

if TYPE_CHECKING:
    from cadenza.performing.setup import Setup
    from cadenza.scene.scene import Scene

_WORTH_TELLING = 30.0  # [s]
# On two cores the planner takes as long for a control step as for this many plain ones: so many,
# and more for every note a second. By the times in docs/planners.md, from which pieces differ.
_STEPS, _STEPS_PER_DENSITY = 8, 5
_STEPS_OF_PRACTICE = 1.5  # as many for one of a hand that practises, by docs/practice.md
_LEAST, _MOST = 0.6, 1.8


def print_estimate(setup: Setup) -> None:
    """Prints on stderr about how long the planner will take, if that is long."""
    from cadenza.agents.planner.planner import Planner
    from cadenza.agents.planner.practice.practice import EFFORT

    agent, config, score = setup.agent, setup.task.config, setup.task.scores[0]
    if QUIET.get() or not isinstance(agent, Planner) or agent.config.method == "none":
        return
    seconds = score.total_time + config.initial_buffer_time
    steps = seconds / config.control_timestep
    plain_steps = _STEPS + _STEPS_PER_DENSITY * len(score.notes) / seconds
    plain_steps += _STEPS_OF_PRACTICE * EFFORT * agent.config.effort
    plain_steps *= 2 / min(agent.threads, 2)
    about = steps * plain_steps * seconds_of_a_step(setup.task.scene, config.control_timestep)
    if about > _WORTH_TELLING:
        music = f"{seconds // 60:.0f}:{seconds % 60:02.0f} of music"
        duration = _range_text(_LEAST * about, _MOST * about)
        print(f"planning and playing {music} takes about {duration}", file=sys.stderr)


def seconds_of_a_step(scene: Scene, control_timestep: float) -> float:
    """Measures how long a control step of resting hands takes on this machine now [s]."""
    import numpy as np

    from cadenza.sim.mujoco_simulation import MujocoSimulation

    simulation = MujocoSimulation(scene, 1, control_timestep)
    still = np.zeros((1, scene.model.nu))
    simulation.step(still)
    began, steps = time.perf_counter(), 40
    for _ in range(steps):
        simulation.step(still)
    return (time.perf_counter() - began) / steps


def _range_text(least: float, most: float) -> str:
    """Returns a range of seconds as text, such as "40 to 120 s" or "6 to 18 min"."""
    if most < 180:
        return f"{round(least, -1):.0f} to {round(most, -1):.0f} s"
    return f"{max(least / 60, 1):.0f} to {most / 60:.0f} min"
