"""Agents that crash, wait or play; runs import them by name."""

import os
import signal
import time
from pathlib import Path

import numpy as np

import cadenza


class Still(cadenza.Agent):
    def act(self, view):
        self.at_step()
        return np.zeros((1, view.task.action_size))

    def at_step(self):
        pass


class Aborts(Still):
    def at_step(self):
        os.abort()


class IsToldToEnd(Still):
    """An agent whose process is terminated, as by a system that is short of memory."""

    def at_step(self):
        os.kill(os.getpid(), signal.SIGTERM)


class Raises(Still):
    def at_step(self):
        raise ValueError("not\ntoday")


class Slow(Still):
    def at_step(self):
        time.sleep(0.1)


class Counted(Slow):
    """Leaves a file for each time that it begins."""

    def reset(self, env_ids, rngs):
        Path(f"begun-{os.getpid()}").touch()
