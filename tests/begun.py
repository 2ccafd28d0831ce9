"""Tasks of one environment whose episode has begun."""

import numpy as np

from cadenza.agents.agent import Agent
from cadenza.tasks.piano_task import PianoTask


def begun(task: PianoTask, *agents: Agent) -> PianoTask:
    """The task at the start of an episode, which these agents are to play."""
    task.reset([np.random.default_rng(0)], [0])
    for agent in agents:
        agent.reset([0], [np.random.default_rng(0)])
    return task
