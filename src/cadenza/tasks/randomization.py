"""Domain randomization: draws at each reset, and their effect on actions and observations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.configs import MAX_COUNT, check_ranges
from cadenza.errors import CadenzaError
from cadenza.scene.randomization import SCALED_FIELDS, Factors, shapes, sliding
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import HeldControls, Simulation
from cadenza.tasks.config import SAME, DomainRandomization

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

_MIN_FACTOR = {"mass": 0.01}  # MuJoCo refuses bodies without mass; 0 for all others
_MAX_FACTOR = 100.0
_MAX_LATENCY = 1.0  # [s]
_MAX_NOISE = {
    "joint_noise": math.pi,  # [rad], half a turn
    "slide_noise": 1.0,  # [m], nearly the keyboard
    "key_noise": 1.0,  # all the way down
    "control_noise": 1.0,  # half the range
}
LATENCY, SEED = "latency", "seed"
_PREFIX = "randomization."  # the field of `TaskConfig`
_CONTROL, _OBSERVATION = "control", "observation"
_OTHERS = (LATENCY, _CONTROL, _OBSERVATION)  # draws, beside the factors, with own generators


class DrawRanges:
    """The ranges of a task in its scene. All draws of an episode follow from them and from a seed.

    Each field has a generator of its own, so that it does not depend on what else is on.

    Attributes:
        config: the ranges and standard deviations.
        shapes: name -> shape of the factors of all that is scaled.
        control_noise: (A,) standard deviations of noise on controls, in actuator units.
        observation_noise: (J + K,) standard deviations of noise on observed joints [m, rad], then
            on key states.
        has_latency: whether actions may be late.
        num_sent: how many actions are kept, so that even the latest arrives, and one before it.
    """

    def __init__(self, config: DomainRandomization, scene: Scene, control_timestep: float) -> None:
        """Take the nominal scene and the time between two actions [s].

        Raises:
            CadenzaError: a range makes no sense.
        """
        _check(config)
        self.config, self._scene = config, scene
        self.physics_timestep = scene.model.opt.timestep
        self.substeps = round(control_timestep / self.physics_timestep)
        known = shapes(scene)
        self.shapes = {n: shape for n, shape in known.items() if getattr(config, n) != SAME}
        self._streams = {name: stream for stream, name in enumerate([*known, *_OTHERS])}
        self.low, self.high = scene.action_low[:-1], scene.action_high[:-1]
        self.control_noise = config.control_noise * (self.high - self.low) / 2
        joints = np.where(sliding(scene), config.slide_noise, config.joint_noise)
        keys = np.full(scene.keyboard.num_keys, config.key_noise)
        self.observation_noise = np.concatenate([joints, keys])
        self.has_latency = bool(config.latency[1])
        self.num_sent = self._steps_of(config.latency[1]) // self.substeps + 2

    def generator(self, seed: int, name: str) -> np.random.Generator:
        """The generator of a field, or of noise, in an episode with this seed."""
        return np.random.default_rng([seed, self._streams[name]])

    def factors(self, seed: int) -> dict[str, Array]:
        """The factors of all that is scaled."""
        drawn: dict[str, Array] = {}
        for name, shape in self.shapes.items():
            low, high = getattr(self.config, name)
            drawn[name] = np.asarray(self.generator(seed, name).uniform(low, high, shape))
        return drawn

    def latency_steps(self, seed: int) -> int:
        """After how many physics steps actions arrive."""
        return self._steps_of(self.generator(seed, LATENCY).uniform(*self.config.latency))

    def _steps_of(self, latency: float) -> int:
        """The physics steps of a latency, rounded half to even."""
        return round(latency / self.physics_timestep)

    def resting_ctrl(self, start: Any) -> Any:
        """(N, A) the controls that keep the joints (N, J) at their start, of NumPy or JAX."""
        if not self._scene.sides:  # keys, which are up
            start, of_joints = start[:, :0], np.zeros((0, len(self.low)))
        else:
            of_joints = servos_of(self._scene).of_joints
        return (start @ of_joints).clip(self.low, self.high)


class Randomization:
    """The randomization of the physics, actions and observations of N environments.

    At each reset an environment draws a seed, from which all that is random in its episode follows,
    see `DrawRanges`.

    Attributes:
        drawn: name -> (N, ...) draws for the episode of each environment: "seed"; "latency" [s];
            and the factors of all that is scaled, see `cadenza.scene.randomization.shapes`. Empty
            if nothing is on.
    """

    def __init__(
        self,
        config: DomainRandomization,
        scene: Scene,
        control_timestep: float,
        num_envs: int,
        simulation: Simulation,
    ) -> None:
        """Prepare draws for N environments, which resets make.

        Args:
            config: the ranges and standard deviations.
            scene: the nominal scene.
            control_timestep: time between two actions [s].
            num_envs: N.
            simulation: the physics of all environments.

        Raises:
            CadenzaError: a range makes no sense.
        """
        self._ranges = ranges = DrawRanges(config, scene, control_timestep)
        self._simulation = simulation
        self._env_ids = np.arange(num_envs)
        self.drawn: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {}
        if config.is_on:
            self.drawn = {name: np.ones((num_envs, *s)) for name, s in ranges.shapes.items()}
            self.drawn[SEED] = np.zeros(num_envs, np.int64)
        self._control_rngs = [np.random.default_rng(0)] * num_envs  # until episodes begin
        self._latency_steps = np.zeros(num_envs, np.intp)  # in physics steps
        if ranges.has_latency:
            self.drawn[LATENCY] = np.zeros(num_envs)
            self._sent = np.zeros((num_envs, ranges.num_sent, len(scene.action_low)))
        self._offset = np.zeros((num_envs, len(ranges.observation_noise)))
        self._observation_rngs = [np.random.default_rng(0)] * num_envs

    # At the beginning of episodes

    def begin(
        self,
        env_ids: Sequence[int],
        rngs: Sequence[np.random.Generator],
        start: Array,
        seeds: Sequence[int | None],
    ) -> None:
        """Draw for episodes that begin, before their simulations are reset.

        Args:
            env_ids: the environments in which they begin.
            rngs: a generator for each of `env_ids`.
            start: (len(env_ids), J) joint positions of the hands after the reset [m, rad].
            seeds: the seed of each episode, None where it is drawn.
        """
        if not self.drawn:
            return
        for env, rng, seed in zip(env_ids, rngs, seeds, strict=True):
            if seed is None:
                seed = self._ranges.config.seed
            factors = self._draw(env, int(rng.integers(MAX_COUNT)) if seed is None else seed)
            if factors:
                self._simulation.randomize(env, factors)
        if LATENCY in self.drawn:
            self._sent[list(env_ids), :, :-1] = self._ranges.resting_ctrl(start)[:, None]
            self._sent[list(env_ids), :, -1] = 0.0  # the pedal is up
        self._draw_noise(np.asarray(env_ids, np.intp))

    def _draw(self, env: int, seed: int) -> Factors:
        factors = self._ranges.factors(seed)
        for name, values in factors.items():
            self.drawn[name][env] = values
        self.drawn[SEED][env] = seed
        if LATENCY in self.drawn:
            self._latency_steps[env] = self._ranges.latency_steps(seed)
            self.drawn[LATENCY][env] = self._latency_steps[env] * self._ranges.physics_timestep
        self._control_rngs[env] = self._ranges.generator(seed, _CONTROL)
        self._observation_rngs[env] = self._ranges.generator(seed, _OBSERVATION)
        return factors

    @property
    def per_env(self) -> list[Any]:
        """Arrays and lists of what each environment has of its own, without its simulation."""
        late = [self._sent] if LATENCY in self.drawn else []
        rngs = [self._control_rngs, self._observation_rngs]
        return [*self.drawn.values(), *late, *rngs, self._latency_steps, self._offset]

    # In each step

    def step(self, ctrl: Array, moving: slice | Ids) -> Array:
        """Step the simulation with noisy and delayed actions.

        Action k is sent at the beginning of control step k. With n physics steps a control step and
        a latency of d of them, it arrives at physics step k n + d.

        Args:
            ctrl: (N, A + 1) the actions of the agent, in actuator units, the pedal last.
            moving: the environments that take the step.

        Returns:
            (N, A + 1) the actions that hold at the end of the step.
        """
        env_ids = None if isinstance(moving, slice) else moving.tolist()
        if self._ranges.config.control_noise:
            ctrl = self._with_noise(ctrl, moving)
        if LATENCY in self.drawn:
            ctrl, held = self._arriving(ctrl, moving)
            self._simulation.step(ctrl[:, :-1], env_ids, held)
        else:
            self._simulation.step(ctrl[:, :-1], env_ids)
        self._draw_noise(moving)
        return ctrl

    def _arriving(self, ctrl: Array, moving: slice | Ids) -> tuple[Array, HeldControls]:
        """(N, A + 1) the actions that hold at the end of the step, and those held before."""
        sent = self._sent
        sent[moving, 1:] = sent[moving, :-1]
        sent[moving, 0] = ctrl[moving]
        steps, substeps = np.divmod(self._latency_steps, self._ranges.substeps)
        before = sent[self._env_ids, steps + 1]
        return sent[self._env_ids, steps], HeldControls(before[:, :-1], substeps)

    def _with_noise(self, ctrl: Array, moving: slice | Ids) -> Array:
        noisy, ranges = ctrl.copy(), self._ranges
        for env in self._env_ids[moving].tolist():
            noise = self._control_rngs[env].standard_normal(len(ranges.control_noise))
            noisy[env, :-1] += ranges.control_noise * noise
        noisy[:, :-1] = np.clip(noisy[:, :-1], ranges.low, ranges.high)
        return noisy

    def _draw_noise(self, moving: slice | Ids) -> None:
        """Draw the noise of the next observations."""
        noise = self._ranges.observation_noise
        if not noise.any():
            return
        for env in self._env_ids[moving].tolist():
            normal = self._observation_rngs[env].standard_normal(len(noise))
            self._offset[env] = noise * normal

    def observed_joints(self, hand_qpos: Array) -> Array:
        """(N, J) joint positions with noise."""
        joints = slice(0, hand_qpos.shape[1])
        noisy = self._ranges.observation_noise[joints].any()
        return hand_qpos + self._offset[:, joints] if noisy else hand_qpos

    def observed_keys(self, key_state: Array) -> Array:
        """(N, K) key states with noise, 0 to 1."""
        if not self._ranges.config.key_noise:
            return key_state
        return np.clip(key_state + self._offset[:, -key_state.shape[1] :], 0.0, 1.0)


def _check(config: DomainRandomization) -> None:
    limits = {name: (_MIN_FACTOR.get(name, 0.0), _MAX_FACTOR) for name in SCALED_FIELDS}
    for name, (least, most) in (limits | {LATENCY: (0.0, _MAX_LATENCY)}).items():
        low, high = getattr(config, name)
        if not least <= low <= high <= most:
            raise CadenzaError(
                f"{_PREFIX}{name} {low} {high}: give the least and the greatest, both from "
                f"{least:g} to {most:g}"
            )
    numbers = {name: (0.0, most) for name, most in _MAX_NOISE.items()}
    if config.seed is not None:
        numbers[SEED] = (0, MAX_COUNT)
    check_ranges(config, numbers, _PREFIX)
