"""Trajectories: what the hands have played over the whole song in the whole scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array, Mask
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.practice.losses import KeyEvents, KeyHistory, Losses
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

_RECENT = 16  # steps in which a note may begin and be in time, and more: 50 ms have 10 at most
_UNSTABLE = 1000.0  # cost of a step that leaves the simulation unusable; no other comes near it


class Trajectory(NamedTuple):
    """Controls of H hands with A servos over T steps, and what came of them."""

    ctrl: Array
    """(T, A)"""
    expected: Array
    """(T, A, 2) position and speed of each servo before the step."""
    sounding: Mask
    """(T, K) whether each key sounds after the step."""
    loss: Array
    """(T, H) the loss of each hand after the step, see `Losses`."""
    strike_loss: Array
    """(T, H) the loss of each hand by its strikes in the step, see `Losses`."""
    cost: Array
    """(T,) the cost of all hands after the step."""

    @classmethod
    def unplayed(cls, plan: SongPlan) -> Trajectory:
        """The planned trajectory before any of it has been played: no loss is known yet."""
        ctrl, _, expected = plan.nominal.tracking
        sounding, loss = (
            np.zeros_like(plan.goals.keys),
            np.zeros((len(ctrl), len(plan.scene.sides))),
        )
        cost = np.zeros(len(ctrl))
        return cls(ctrl.copy(), expected[:-1].copy(), sounding, loss, loss.copy(), cost)

    @property
    def all_loss(self) -> Array:
        """(T, H) the loss of each hand, with that by its strikes."""
        return self.loss + self.strike_loss

    def segment(self, first: int, last: int) -> Trajectory:
        """A copy of the steps from `first` up to, not including, `last`."""
        return Trajectory._make(values[first:last].copy() for values in self)

    def copied(self) -> Trajectory:
        """A copy of all steps."""
        return self.segment(0, len(self.ctrl))

    def overwrite(self, first: int, segment: Trajectory) -> None:
        """Replaces the steps from `first` on."""
        for values, new in zip(self, segment, strict=True):
            values[first : first + len(new)] = new

    def key_history(self, step: int) -> KeyHistory:
        """The keys before a step."""
        return KeyHistory.of_steps(self.sounding[max(step - _RECENT, 0) : step])


Snapshots = dict[int, PlanningSimulation]
"""The whole scene before some steps of a trajectory, to the bit."""


def scene_before(step: int, trajectory: Trajectory, snapshots: Snapshots) -> PlanningSimulation:
    """The whole scene before a step of a trajectory, simulated from the last snapshot up to it."""
    begin = max(snapshot for snapshot in snapshots if snapshot <= step)
    simulation = copy(snapshots[begin])
    for ctrl in trajectory.ctrl[begin:step]:
        simulation.step(ctrl[None])
    return simulation


class WholeScene:
    """The scene with all hands and keys, in which trajectories are rolled out and evaluated."""

    def __init__(self, plan: SongPlan, start: Array, goals: Sequence[HandGoals]) -> None:
        """Puts hands with these goals where the song begins, at joint positions (J,) [m, rad]."""
        scene, tracking = plan.scene, plan.nominal.tracking
        self._gain, self._after = tracking.gain, tracking.expected[-1:]
        self._servos = servos_of(scene)
        self._fingers = [each.fingers for each in goals]
        self._losses = [Losses(plan, each) for each in goals]
        self._keys = scene.keyboard.centre[:, 1]
        self._start = PlanningSimulation(scene, 1, plan.track.config.control_timestep)
        self._start.reset(None, start[None])

    def at_start(self) -> PlanningSimulation:
        """A copy of the scene where the song begins."""
        return copy(self._start)

    def tracking(self, trajectory: Trajectory) -> Tracking:
        """The controls of a trajectory of the whole song, with feedback that leads back to it."""
        expected = np.append(trajectory.expected, self._after, axis=0)
        return Tracking(trajectory.ctrl, self._gain, expected)

    def roll_out(
        self,
        trajectory: Trajectory,
        known: Snapshots,
        first: int,
        last: int,
        every: int,
        act: Callable[[int, State], Array] | None = None,
    ) -> tuple[Trajectory, Snapshots]:
        """Plays the steps of a trajectory from `first` up to `last`, and evaluates them.

        Args:
            trajectory: the trajectory, with what was played before these steps.
            known: the snapshots of its scene, one of them of the step `first` or before.
            every: steps between new snapshots; there is one at the end too if it falls there.
            act: returns the controls (A,) of a step in a state; by default those of the trajectory,
                with feedback, are played.

        Returns:
            What was played, and the snapshots.
        """
        simulation, history = scene_before(first, trajectory, known), trajectory.key_history(first)
        played, snapshots = trajectory.segment(first, last), Snapshots()
        last = first + len(played.ctrl)
        tracking = Tracking(played.ctrl, self._gain[first:last], played.expected)
        for k, step in enumerate(range(first, last)):
            if step % every == 0:
                snapshots[step] = copy(simulation)
            state = simulation.state
            here = self._servos.state(state.hand_qpos[0], state.hand_qvel[0])
            ctrl = act(step, state) if act else tracking.controls(self._servos, k, here)
            simulation.step(ctrl[None])
            (loss, strikes), cost, history = self._evaluated(simulation.state, step, history)
            sounding = history.sounding[None]
            played.overwrite(k, Trajectory(ctrl[None], here[None], sounding, loss, strikes, cost))
        if last % every == 0:
            snapshots[last] = simulation
        return played, snapshots

    def _evaluated(
        self, state: State, step: int, history: KeyHistory
    ) -> tuple[Array, Array, KeyHistory]:
        """Both losses (2, 1, H) and the cost (1,) of the state after a step, and the keys then.

        A key that sounds and should not is charged to the hand that is nearer to it.
        """
        tips = [state.fingertip_xpos[0, fingers] for fingers in self._fingers]
        distance = [np.abs(self._keys - hand[:, 1].mean()) for hand in tips]
        nearest, cost = np.argmin(distance, axis=0), _UNSTABLE * bool(state.unstable[0])
        events, now = KeyEvents(state.key_onset[0], state.key_speed[0]), history
        lost = np.zeros((2, 1, len(tips)))
        for i, (losses, hand) in enumerate(zip(self._losses, tips, strict=True)):
            near, keys = nearest == i, state.key_qpos[0]
            *lost[:, 0, i], more, now = losses.after(step, keys, events, hand, history, near=near)
            cost += more
        return lost, np.array([cost]), now
