"""Trajectories of the hands through the whole song, in the whole scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Mask
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.practice.losses import KeyEvents, KeyHistory, Losses, WrittenNotes
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State

_UNSTABLE = 1000.0  # cost of a step after which the simulation is unstable, far above all others


class Trajectory(NamedTuple):
    """Controls of H hands with A servos over T steps, and their outcome."""

    ctrl: Array  # (T, A)
    expected: Array  # (T, A, 2) position and speed of each servo before the step
    sounding: Mask  # (T, K) whether each key sounds after the step
    # (T, K) when each key last began to sound in the step [s], in 32 bits; NaN if it did not
    onset: NDArray[Any]
    offset: NDArray[Any]  # (T, K) when it last ceased to sound in it [s]
    loss: Array  # (T, H) the loss of each hand after the step, see `Losses`
    faults: NDArray[Any]  # (T, H) the missed and extra notes of each hand
    strike_loss: Array  # (T, H) the loss of each hand by its strikes in the step, see `Losses`
    cost: Array  # (T,) the cost of all hands after the step

    @classmethod
    def unplayed(cls, plan: SongPlan) -> Trajectory:
        """The planned trajectory before any of it has been played: no loss is known yet."""
        ctrl, _, expected = plan.nominal.tracking
        sounding, cost = np.zeros_like(plan.goals.keys), np.zeros(len(ctrl))
        onset, offset = (np.full(sounding.shape, np.nan, np.float32) for _ in range(2))
        loss, strike_loss = (np.zeros((len(ctrl), len(plan.scene.sides))) for _ in range(2))
        faults, ctrl, expected = loss.astype(np.intp), ctrl.copy(), expected[:-1].copy()
        return cls(ctrl, expected, sounding, onset, offset, loss, faults, strike_loss, cost)

    @property
    def all_loss(self) -> Array:
        """(T, H) the loss of each hand, with that of its strikes."""
        return self.loss + self.strike_loss

    def segment(self, first: int, last: int) -> Trajectory:
        """A copy of the steps from `first` up to, not including, `last`."""
        return Trajectory._make(values[first:last].copy() for values in self)

    def copied(self) -> Trajectory:
        """A copy of all steps."""
        return self.segment(0, len(self.ctrl))

    def overwrite(self, first: int, segment: Trajectory) -> None:
        """Replace the steps from `first` on."""
        for values, new in zip(self, segment, strict=True):
            values[first : first + len(new)] = new

    def key_history(self, step: int, notes: WrittenNotes) -> KeyHistory:
        """The keys before a step of a song with these notes."""
        return notes.history(step, self.sounding, self.onset, self.offset)


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
    """The scene with all hands and keys, in which trajectories are rolled out and evaluated.

    Attributes:
        fault: the loss of a missed or an extra note.
    """

    def __init__(self, plan: SongPlan, start: Array, goals: Sequence[HandGoals]) -> None:
        """Put hands with these goals at joint positions `start` (J,) [m, rad]."""
        scene, tracking = plan.scene, plan.nominal.tracking
        self._gain, self._after = tracking.gain, tracking.expected[-1:]
        self._servos = servos_of(scene)
        self._fingers = [each.fingers for each in goals]
        self._losses = [Losses(plan, each) for each in goals]
        self.fault = self._losses[0].fault
        self._keys = scene.keyboard.centre[:, 1]
        self._start = PlanningSimulation(scene, 1, plan.track.config.control_timestep)
        self._start.reset(None, start[None])

    def at_start(self) -> PlanningSimulation:
        """A copy of the scene before the song."""
        return copy(self._start)

    def tracking(self, trajectory: Trajectory) -> Tracking:
        """The controls of a trajectory of the whole song, with feedback that leads back to it."""
        expected = np.append(trajectory.expected, self._after, axis=0)
        return Tracking(trajectory.ctrl, self._gain, expected)

    def roll_out(
        self,
        trajectory: Trajectory,
        known_snapshots: Snapshots,
        first: int,
        last: int,
        interval: int,
        act: Callable[[int, State], Array] | None = None,
    ) -> tuple[Trajectory, Snapshots]:
        """Play the steps of a trajectory from `first` up to `last`, and evaluate them.

        Returns the steps as they were played, and new snapshots.

        Args:
            trajectory: the trajectory, with the steps before these as they were played.
            first: the first step.
            last: the step after the last one.
            known_snapshots: snapshots of its scene, one of them of the step `first` or before.
            interval: new snapshots are taken before, or after, steps that are its multiples.
            act: returns the controls (A,) of a step in a state; by default those of the trajectory,
                with feedback, are played.
        """
        simulation = scene_before(first, trajectory, known_snapshots)
        history = trajectory.key_history(first, self._losses[0].notes)
        played, snapshots = trajectory.segment(first, last), Snapshots()
        last = first + len(played.ctrl)
        tracking = Tracking(played.ctrl, self._gain[first:last], played.expected)
        for k, step in enumerate(range(first, last)):
            if step % interval == 0:
                snapshots[step] = copy(simulation)
            state = simulation.state
            servo_state = self._servos.state(state.hand_qpos[0], state.hand_qvel[0])
            ctrl = act(step, state) if act else tracking.controls(self._servos, k, servo_state)
            simulation.step(ctrl[None])
            state = simulation.state
            evaluation, history = self._evaluate(state, step, history)
            events = history.sounding[None], state.key_onset, state.key_offset
            played.overwrite(k, Trajectory(ctrl[None], servo_state[None], *events, *evaluation))
        if last % interval == 0:
            snapshots[last] = simulation
        return played, snapshots

    def _evaluate(
        self, state: State, step: int, history: KeyHistory
    ) -> tuple[tuple[Array, Array, Array, Array], KeyHistory]:
        """The evaluation of the state after a step, and the keys then.

        The evaluation is loss, faults and strike loss (1, H), and cost (1,). The hand nearer to a
        key pays if the key sounds and should not.
        """
        tips = [state.fingertip_xpos[0, fingers] for fingers in self._fingers]
        distance = [np.abs(self._keys - hand[:, 1].mean()) for hand in tips]
        nearest, cost = np.argmin(distance, axis=0), _UNSTABLE * bool(state.unstable[0])
        events, after = KeyEvents(*(values[0] for values in state.key_events)), history
        by_hand = np.zeros((3, 1, len(tips)))
        for i, (losses, hand) in enumerate(zip(self._losses, tips, strict=True)):
            near, keys = nearest == i, state.key_qpos[0]
            *by_hand[:, 0, i], hand_cost, after = losses.after(
                step, keys, events, hand, history, near=near
            )
            cost += hand_cost
        return (*by_hand, np.array([cost])), after
