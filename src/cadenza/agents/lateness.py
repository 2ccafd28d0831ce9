"""Compensate known delays and noise: act early, for the state in which an action arrives."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from cadenza.agents.agent import Array, EpisodePlanner
from cadenza.errors import CadenzaError
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import HeldControls, State
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.view import View

_AGREES = 1e-5  # [m, rad] between sensors and model, below which the model needs no correction
# Error of the model after a control step, if the robot differs: of joints [rad], of slides [m], and
# of keys as a fraction of their travel. Sensors count the less, the noisier they are beside this.
_MODEL_ERROR = np.array([0.01, 0.001, 0.1])


@dataclass(frozen=True)
class Lateness:
    """The delays and the noise of a robot, as an agent knows them."""

    actions: float  # the time that actions take to arrive [s]
    observations: float  # the time that observations take to arrive [s]
    # Standard deviations of sensors of hinges [rad], of slides [m], and of keys
    noise: tuple[float, float, float]

    @classmethod
    def expected(cls, config: DomainRandomization) -> Lateness | None:
        """The middle of each range from which robots are drawn; None without delays and noise."""
        late = cls(
            sum(config.latency) / 2,
            sum(config.observation_latency) / 2,
            (config.joint_noise, config.slide_noise, config.key_noise),
        )
        return late if late.actions or late.observations or any(late.noise) else None


def earlier(track: GoalTrack, seconds: float) -> GoalTrack:
    """The track with the same fingers, `seconds` earlier.

    Raises CadenzaError if its initial silence is shorter.
    """
    config, dt = track.config, track.config.control_timestep
    steps = math.ceil(round(seconds / dt, 9))
    if steps > track.silent_steps:
        raise CadenzaError(
            f"actions arrive {seconds:g} s late, and the song begins after "
            f"{config.initial_buffer_time:g} s: give it an initial_buffer_time of {steps * dt:g}"
        )
    silence = (track.silent_steps - steps) * dt
    rest = steps * dt - seconds
    score = track.score.with_initial_silence(rest) if rest > 1e-9 else track.score
    return replace(track, config=replace(config, initial_buffer_time=silence), score=score)


class StateEstimator:
    """An estimate of the state of a robot when the next action arrives.

    The nominal model runs with the actions that were sent, as late as the sensors are, is corrected
    by their measurements, and is rolled out from there: a Smith predictor with the gain of a
    steady-state Kalman filter.
    """

    def __init__(self, scene: Scene, control_timestep: float, late: Lateness, start: State) -> None:
        """Begin at rest, in the state of one simulation."""
        step = scene.model.opt.timestep
        self._substeps = round(control_timestep / step)
        delay = round(late.actions / step) + round(late.observations / step)
        self._whole_steps, self._rest_substeps = divmod(delay, self._substeps)
        self._scene, self._keys = scene, scene.key_qpos
        self._model, self._ahead, *self._part = (
            PlanningSimulation(scene, 1, seconds)
            for seconds in (control_timestep, control_timestep, self._rest_substeps * step)
            if seconds
        )
        hinges, slides, keys = _gain(np.array(late.noise), _MODEL_ERROR)
        self._joint_gain = np.full(start.hand_qpos.shape[1], hinges)
        self._joint_gain[scene.slide_joints] = slides
        self._key_gain = keys
        self._model.set_joints(start.hand_qpos[0], start.hand_qvel[0], start.key_qpos[0])
        servos = servos_of(scene)
        at_rest = servos.clip(start.hand_qpos[0] @ servos.of_joints)
        self._sent = [at_rest] * (self._whole_steps + 2)
        self._has_begun = False

    def estimate(self, measured: State) -> State:
        """The state in which the next action arrives, from the measured state of one robot."""
        if self._has_begun:
            self._step(self._model, 0)
        self._has_begun = True
        self._correct(measured)
        self._ahead.copy_from(self._model, 0)
        for k in range(self._whole_steps):
            self._step(self._ahead, k + 1)
        if not self._part:
            return self._ahead.state
        (part,) = self._part
        part.copy_from(self._ahead, 0)
        part.step(self._sent[-1][None])
        return part.state

    def send(self, ctrl: Array) -> None:
        """Record the action (A,) that is sent now."""
        self._sent = [*self._sent[1:], ctrl]

    def _step(self, model: PlanningSimulation, k: int) -> None:
        """Take a control step, in which the action before k + 1 is held until that one arrives."""
        previous, action = self._sent[k][None], self._sent[k + 1][None]
        model.step(action, None, HeldControls(previous, np.array([self._rest_substeps])))

    def _correct(self, measured: State) -> None:
        """Correct the model by the measured state, unless they agree."""
        model = self._model.state
        position_error = measured.hand_qpos[0] - model.hand_qpos[0]
        key_error = np.nan_to_num(measured.key_qpos[0] - model.key_qpos[0])  # NaN: not measured
        if max(abs(position_error).max(), abs(key_error).max()) < _AGREES:
            return
        qvel = self._model.coordinates()[0, self._scene.model.nq :]
        speed_error = np.nan_to_num(measured.hand_qvel[0] - model.hand_qvel[0])
        self._model.set_joints(
            model.hand_qpos[0] + self._joint_gain * position_error,
            model.hand_qvel[0] + self._joint_gain * speed_error,
            model.key_qpos[0] + self._key_gain * key_error,
            qvel[self._keys],
        )


def _gain(noise: Array, error: Array) -> Array:
    """Kalman gain for a random walk with a standard deviation `error` a step, seen with `noise`."""
    variance = (error**2 + error * np.sqrt(error**2 + 4 * noise**2)) / 2
    return variance / (variance + noise**2)


P = TypeVar("P", bound=EpisodePlanner)


class EarlyPlanner(EpisodePlanner, Generic[P]):
    """A planner that plays its song ahead of time, by the delay of its actions.

    Attributes:
        planner: the planner of the earlier song, for which nothing is late.
    """

    def __init__(self, view: View, late: Lateness, begin: Callable[[View], P]) -> None:
        """Begin at the view before the first step of one environment.

        Raises CadenzaError if the song begins before an action can arrive.
        """
        (track,) = view.tracks
        dt = track.config.control_timestep
        self._track = earlier(track, late.actions)
        self._estimator = StateEstimator(track.scene, dt, late, view.state)
        self._num_steps = np.array([self._track.goals.num_steps])
        self._action = np.zeros(view.task.action_size)
        self.planner = begin(self._early(view, view.state))

    def act(self, view: View) -> Array:
        state = self._estimator.estimate(view.state)
        if view.steps[0] < self._num_steps[0]:  # later actions arrive after the end
            self._action = self.planner.act(self._early(view, state))
        self._estimator.send(self._action[:-1])
        return self._action

    def _early(self, view: View, state: State) -> View:
        """The view of the earlier song, on a robot that is in a state and not late."""
        return replace(view, tracks=(self._track,), num_steps=self._num_steps, state=state)

    @property
    def plan(self) -> Any:
        """The plan of the earlier song."""
        return self.planner.plan


def early(view: View, begin: Callable[[View], P]) -> P | EarlyPlanner[P]:
    """Begin a planner at a view: an `EarlyPlanner` if the task's robots are late or noisy.

    Hands at pianos of their own are not compensated. Raises CadenzaError if the song begins before
    an action can arrive.
    """
    late = Lateness.expected(view.task.config.randomization)
    if late is None or view.task.scene.config.hands in ("apart", "none"):
        return begin(view)
    return EarlyPlanner(view, late, begin)
