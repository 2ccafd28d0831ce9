"""The map from a policy's actions in [-1, 1] to controls: scaled, or added to a plan.

A residual policy corrects a reference: what the planner plays, tracked with feedback.
"""

from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from cadenza.agents.agent import Progress, silent
from cadenza.agents.lateness import Lateness, earlier
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError
from cadenza.learning.observation import Floats
from cadenza.learning.ranges import Ranges
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import State
from cadenza.sim.threads import available_cores
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import TaskSpec

Array = NDArray[np.float64]


_REACH = 0.1
"""Largest corrections, as a share of those of the generalist's networks (`Servo.correction`).

What the planner plays is nearly right. With corrections that are 2.5 times as large, learning loses
notes before it wins any.
"""


class Reference(NamedTuple):
    """A performance of T steps with A servos, and how far it may be corrected.

    Arrays are in double precision, so that the same controls play the same notes.
    """

    ctrl: Array  # (T, A) [m, rad]
    gain: Array  # (T, A, 2) feedback gains of the deviations of position and speed
    expected: Array  # (T + 1, A, 2) position and speed of each servo
    pedal: Array  # (T,)
    reach: Array  # (A,) largest corrections [m, rad]


def reference_of(
    task: PianoTask, seed: int = 0, effort: float = 0.0, progress: Progress = silent
) -> Reference:
    """Have the planner play the only score of a task, where nothing is random.

    It practises with an `effort`, see `PlannerConfig`. Where the task's robots are late, it plays
    as much earlier, and expects what late sensors measure.

    Raises CadenzaError if the task has several scores, changes one or the start at random, or has
    no hands.
    """
    check_one_score(task.config)
    if len(task.tracks) > 1:
        raise CadenzaError(
            "a residual policy corrects the plan of one song: give one, or learn several from "
            "nothing (--no-residual)"
        )
    (track,), config = task.tracks, replace(task.config, randomization=DomainRandomization())
    if late := Lateness.expected(task.config.randomization):
        track = earlier(track, late.actions)
        config = replace(config, initial_buffer_time=track.config.initial_buffer_time)
    planner = Planner(PlannerConfig(effort=effort))
    planner.num_threads, planner.progress = available_cores(), progress
    with closing(PianoTask([track], config, task.scene.config)) as undisturbed:
        played = play_episode(undisturbed, planner, seed)
    servos = servos_of(task.scene)
    arrays, plan = played.episode.arrays, played.plan
    assert plan is not None
    qpos = np.concatenate([arrays["hand_qpos0"][None], arrays["hand_qpos"]])
    qvel = np.concatenate([np.zeros_like(arrays["hand_qvel"][:1]), arrays["hand_qvel"]])
    reference = Reference(
        ctrl=arrays["action"][:, :-1],
        gain=plan.nominal.tracking.gain,
        expected=servos.state(qpos, qvel),
        pedal=arrays["action"][:, -1],
        reach=_REACH * servos.correction,
    )
    return reference if late is None else _measured_late(reference, late, task)


def _measured_late(reference: Reference, late: Lateness, task: PianoTask) -> Reference:
    """A reference over all steps of a task, whose expected states are as late as those measured."""
    steps, last = task.tracks[0].goals.num_steps, len(reference.ctrl) - 1
    row = np.minimum(np.arange(steps), last)  # the hands stay where the earlier song ends
    delay = (late.actions + late.observations) / task.config.control_timestep
    measured = np.clip(np.arange(steps + 1) - delay, 0, last + 1)
    return reference._replace(
        ctrl=reference.ctrl[row],
        gain=reference.gain[row],
        expected=make_interp_spline(np.arange(last + 2), reference.expected, k=1)(measured),
        pedal=reference.pedal[row],
    )


def check_one_score(config: TaskConfig) -> None:
    """Raise a CadenzaError if the task changes the score or the start at random."""
    names = ("random_hand_position", "random_stretch", "random_pitch_shift", "random_octave_shift")
    if random := [name for name in names if getattr(config, name)]:
        raise CadenzaError(
            f"a residual policy corrects one plan of one score: leave out {', '.join(random)}, or "
            "learn from nothing (--no-residual)"
        )


class ActionMapping:
    """Map a policy's actions in [-1, 1] to controls of a task.

    The pedal is played as written, not by the policy, unless the task rewards it
    (`TaskConfig.sustain_term`) and no plan plays it.

    Attributes:
        reference: The actions (T, A + 1) of the reference with the pedal, in [-1, 1]; None without
            a reference.
    """

    def __init__(
        self, task: TaskSpec, reference: Reference | None = None, ranges: Ranges | None = None
    ) -> None:
        """Correct a reference if there is one, or else scale to `ranges` or those of the task."""
        self._reference, self.reference = reference, None
        self._pedal_as_written = not task.config.sustain_term
        self._scaled = ranges.ctrl if ranges else task.scale_action
        if reference is not None:
            self._servos = servos_of(task.scene)
            self._low, self._high = task.action_low, task.action_high
            action = np.concatenate([reference.ctrl, reference.pedal[:, None]], axis=1)
            self.reference = task.unscale_action(action).astype(np.float32)

    def ctrl(
        self, action: Floats, steps: NDArray[np.intp], state: State, pedal: NDArray[np.bool_]
    ) -> Array:
        """Controls (N, A + 1) in actuator units, the pedal last.

        Args:
            action: The policy's actions (N, A + 1) in [-1, 1].
            steps: The steps (N,) of the song that are played next.
            state: The state of the N simulations.
            pedal: Whether the score has the pedal down in these steps (N,).
        """
        reference = self._reference
        if reference is None:
            ctrl = self._scaled(action)
            if self._pedal_as_written:
                ctrl[:, -1] = pedal
            return ctrl
        measured = self._servos.state(state.hand_qpos, state.hand_qvel)
        feedback = (reference.gain[steps] * (measured - reference.expected[steps])).sum(axis=-1)
        hands = reference.ctrl[steps] - feedback + reference.reach * action[:, :-1]
        ctrl = np.concatenate([hands, pedal[:, None]], axis=1)
        return np.clip(ctrl, self._low, self._high)
