"""Agents that crash, wait or play; runs import them by name."""

import os
import time

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


class Vanishes(Still):
    def at_step(self):
        os._exit(0)


class Raises(Still):
    def at_step(self):
        raise ValueError("not\ntoday")


class Slow(Still):
    def at_step(self):
        time.sleep(0.05)


class AbortsUnlessAllowed(Still):
    def at_step(self):
        if not os.path.exists(os.environ["ALLOWED"]):
            os.abort()
