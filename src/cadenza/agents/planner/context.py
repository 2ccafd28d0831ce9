"""Options and resources that planning and practice of a song share."""

from typing import NamedTuple

from cadenza.agents.agent import Progress, silent
from cadenza.agents.planner.config import PlannerConfig
from cadenza.sim.threads import Threads


class PlanningContext(NamedTuple):
    """The options of planning, and the resources that it uses."""

    config: PlannerConfig
    threads: Threads  # the threads that plan ahead, and in which hands practise
    progress: Progress = silent  # the receiver of progress: the stages "fingers" and "postures"
