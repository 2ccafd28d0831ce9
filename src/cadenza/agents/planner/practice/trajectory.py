"""Takes: how hands have played a song in the whole scene, step by step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Follower, Tracking
from cadenza.agents.planner.practice.losses import KeyHistory, Losses
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RECENT = 16  # steps in which a note may begin and be in time, and more: 50 ms have 10 at most
_UNSTABLE = 1000.0  # what a step costs after which the simulation is of no more use


class Trajectory(NamedTuple):
    """What H hands with A servos have played over T steps."""

    ctrl: Array
    """(T, A)"""
    expected: Array
    """(T, A, 2) position and speed of each servo before the step."""
    sounding: Mask
    """(T, K) after it, as all that follows."""
    loss: Array
    """(T, H) of each hand, see `Losses`."""
    cost: Array
    """(T,)"""

    @classmethod
    def to_come(cls, tracking: Tracking, num_keys: int, num_hands: int) -> Trajectory:
        """Of which nothing has been played yet; what is to be is expected."""
        steps = len(tracking.ctrl)
        return cls(
            tracking.ctrl.copy(),
            tracking.expected[:-1].copy(),
            np.zeros((steps, num_keys), bool),
            np.zeros((steps, num_hands)),
            np.zeros(steps),
        )

    def part(self, first: int, last: int) -> Trajectory:
        """A copy of the steps from `first` up to, not including, `last`."""
        return Trajectory._make(values[first:last].copy() for values in self)

    def put(self, first: int, part: Trajectory) -> None:
        """Replaces the steps from `first` on."""
        for values, new in zip(self, part, strict=True):
            values[first : first + len(new)] = new

    def heard(self, step: int) -> KeyHistory:
        """Keys before a step."""
        return KeyHistory.of_steps(self.sounding[max(step - _RECENT, 0) : step])


Snapshots = dict[int, PlanningSimulation]
"""The whole scene before some steps of a take, to the bit."""


def scene_before(step: int, take: Trajectory, moments: Snapshots) -> PlanningSimulation:
    """The whole scene before a step of a take, from the last of the moments up to there."""
    begin = max(moment for moment in moments if moment <= step)
    simulation = copy(moments[begin])
    for ctrl in take.ctrl[begin:step]:
        simulation.step(ctrl[None])
    return simulation


class Stage:
    """The whole scene, in which takes are played and judged.

    Attributes:
        gain: (T, A, 2) of the feedback that leads back to a take.
    """

    def __init__(self, plan: SongPlan, start: Array, parts: Sequence[HandGoals]) -> None:
        """Args:
        plan: of the whole song.
        start: (J,) joint positions of the hands where the song begins [m, rad].
        parts: of the hands.
        """
        scene, tracking = plan.scene, plan.nominal.tracking
        self.gain, self._after = tracking.gain, tracking.expected[-1:]
        self._follower = Follower(scene, tracking)
        self._fingers = [part.fingers for part in parts]
        self._losses = [Losses(plan, part) for part in parts]
        self._keys = scene.keyboard.centre[:, 1]
        self._beginning = PlanningSimulation(scene, 1, plan.track.config.control_timestep)
        self._beginning.reset(None, start[None])

    def beginning(self) -> PlanningSimulation:
        """The scene where the song begins."""
        return copy(self._beginning)

    def posture(self, simulation: PlanningSimulation) -> Array:
        """(A, 2) position and speed of each servo."""
        return self._follower.posture(simulation.state.hand_qpos[0], simulation.state.hand_qvel[0])

    def tracking(self, take: Trajectory) -> Tracking:
        """What leads back to a take of the whole song."""
        return Tracking(take.ctrl, self.gain, np.append(take.expected, self._after, axis=0))

    def play(
        self,
        simulation: PlanningSimulation,
        first: int,
        take: Trajectory,
        heard: KeyHistory,
        every: int,
        act: Callable[[State], Array] | None = None,
    ) -> tuple[Trajectory, Snapshots]:
        """What comes of a part of a take if it is played from a simulation on.

        Args:
            simulation: before the step `first`; it is played in.
            first: where the part begins.
            take: the part.
            heard: before it.
            every: so many steps there is a moment to keep, at the end too if it is one of them.
            act: the controls (A,) of the next step in a state; by default those of the take, with
                feedback.
        """
        played, moments, last = take.part(0, len(take.ctrl)), {}, first + len(take.ctrl)
        for k, row in enumerate(range(first, last)):
            if row % every == 0:
                moments[row] = copy(simulation)
            here = self.posture(simulation)
            if act:
                ctrl = act(simulation.state)
            else:
                back = (self.gain[row] * (here - take.expected[k])).sum(axis=1)
                ctrl = self._follower.clip(take.ctrl[k] - back)
            simulation.step(ctrl[None])
            step, heard = self.judged(simulation, row, heard)
            played.put(k, Trajectory(ctrl[None], here[None], *step))
        if last % every == 0:
            moments[last] = simulation
        return played, moments

    def judged(
        self, simulation: PlanningSimulation, row: int, heard: KeyHistory
    ) -> tuple[tuple[Mask, Array, Array], KeyHistory]:
        """What sounds, is lost and costs after a step, as a row of a take, and what is heard.

        The hand that is nearer to a key is to blame if that sounds and should not.
        """
        state = simulation.state
        tips = [state.fingertip_xpos[0, fingers] for fingers in self._fingers]
        away = [np.abs(self._keys - hand[:, 1].mean()) for hand in tips]
        nearest, loss, cost = np.argmin(away, axis=0), [], _UNSTABLE * bool(state.unstable[0])
        now = heard
        for i, (losses, hand) in enumerate(zip(self._losses, tips, strict=True)):
            judged = losses.after(row, state.key_qpos[0], hand, heard, near=nearest == i)
            loss.append(judged[0])
            cost, now = cost + judged[1], judged[2]
        return (now.sounding[None], np.array([loss]), np.array([cost])), now
