"""Domain randomization: draws at each reset, and their effect on actions and observations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.configs import MOST_COUNT, check_ranges
from cadenza.errors import CadenzaError
from cadenza.scene.randomization import Factors, shapes, sliding
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.protocol import Held, RandomizableSimulation, Simulation
from cadenza.tasks.config import SAME, DomainRandomization

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

_LEAST_FACTOR = {"mass": 0.01}  # MuJoCo refuses bodies without mass; 0 for all others
_MOST_FACTOR = 100.0
_MOST_LATENCY = 1.0  # [s]
_MOST_NOISE = {
    "joint_noise": math.pi,  # [rad], half a turn
    "slide_noise": 1.0,  # [m], nearly the keyboard
    "key_noise": 1.0,  # all the way down
    "control_noise": 1.0,  # half the range
}
_LATENCY, _SEED = "latency", "seed"
_PREFIX = "randomization."  # the field of `TaskConfig`
_CONTROL, _OBSERVATION = "control", "observation"
_OTHERS = (_LATENCY, _CONTROL, _OBSERVATION)  # draws, beside the factors, with own generators


class Randomization:
    """The randomization of the physics, actions and observations of N environments.

    At each reset an environment draws a seed. All that is random in its episode follows from that,
    by a generator for each field, so that a field does not depend on what else is on.

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
        """Prepares draws for N environments, the first of which are made at a reset.

        Args:
            config: the ranges and standard deviations.
            scene: the nominal scene.
            control_timestep: time between two actions [s].
            num_envs: N.
            simulation: the physics of all environments.

        Raises:
            CadenzaError: a range makes no sense, or the simulation cannot be randomized.
        """
        known = shapes(scene)
        _check(config, list(known))
        self._config, self._scene, self._simulation = config, scene, simulation
        self._physics_timestep = scene.model.opt.timestep
        self._substeps = round(control_timestep / self._physics_timestep)
        self._env_ids = np.arange(num_envs)
        self._shapes = {n: shape for n, shape in known.items() if getattr(config, n) != SAME}
        self._streams = {name: stream for stream, name in enumerate([*known, *_OTHERS])}
        self.drawn: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {}
        if config.is_on:
            self.drawn = {name: np.ones((num_envs, *s)) for name, s in self._shapes.items()}
            self.drawn[_SEED] = np.zeros(num_envs, np.int64)
        # Actions
        self._low, self._high = scene.action_low[:-1], scene.action_high[:-1]
        self._control_noise = config.control_noise * (self._high - self._low) / 2
        self._control_rngs: dict[int, np.random.Generator] = {}
        self._late = np.zeros(num_envs, np.intp)  # in physics steps
        if config.latency[1]:
            self.drawn[_LATENCY] = np.zeros(num_envs)
            most = self._steps_of(config.latency[1]) // self._substeps
            self._sent = np.zeros((num_envs, most + 2, len(scene.action_low)))
        # Observations: joints, then keys
        joints = np.where(sliding(scene), config.slide_noise, config.joint_noise)
        keys = np.full(scene.keyboard.num_keys, config.key_noise)
        self._noise = np.concatenate([joints, keys])
        self._offset = np.zeros((num_envs, len(self._noise)))
        self._observation_rngs: dict[int, np.random.Generator] = {}
        asked = [*self._shapes, *({_LATENCY} & self.drawn.keys())]
        if asked and not isinstance(simulation, RandomizableSimulation):
            kind = type(simulation).__name__
            raise CadenzaError(f"{_PREFIX}{asked[0]}: a {kind} cannot be randomized; leave it out")

    # At the beginning of episodes

    def begin(
        self,
        env_ids: Sequence[int],
        rngs: Sequence[np.random.Generator],
        start: Array,
        seeds: Sequence[int | None],
    ) -> None:
        """Draws for episodes that begin, before their simulations are reset.

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
                seed = self._config.seed
            factors = self._draw(env, int(rng.integers(MOST_COUNT)) if seed is None else seed)
            if factors and isinstance(self._simulation, RandomizableSimulation):
                self._simulation.randomize(env, factors)
        if _LATENCY in self.drawn:
            self._sent[list(env_ids), :, :-1] = self._resting_ctrl(start)[:, None]
            self._sent[list(env_ids), :, -1] = 0.0  # the pedal is up
        self._draw_noise(np.asarray(env_ids, np.intp))

    def _draw(self, env: int, seed: int) -> Factors:
        config = self._config

        def generator(name: str) -> np.random.Generator:
            return np.random.default_rng([seed, self._streams[name]])

        factors: dict[str, Array] = {}
        for name, shape in self._shapes.items():
            low, high = getattr(config, name)
            factors[name] = np.asarray(generator(name).uniform(low, high, shape))
            self.drawn[name][env] = factors[name]
        self.drawn[_SEED][env] = seed
        if _LATENCY in self.drawn:
            latency = generator(_LATENCY).uniform(*config.latency)
            self._late[env] = self._steps_of(latency)
            self.drawn[_LATENCY][env] = self._late[env] * self._physics_timestep
        self._control_rngs[env] = generator(_CONTROL)
        self._observation_rngs[env] = generator(_OBSERVATION)
        return factors

    def _steps_of(self, latency: float) -> int:
        """The physics steps of a latency, rounded half to even."""
        return round(latency / self._physics_timestep)

    def _resting_ctrl(self, start: Array) -> Array:
        """(N, A) the controls that keep the joints at their start."""
        if not self._scene.sides:  # keys, which are up
            return np.tile(np.clip(0.0, self._low, self._high), (len(start), 1))
        servos = servos_of(self._scene)
        return np.asarray(servos.clip(start @ servos.of_joints))

    # In each step

    def step(self, ctrl: Array, moving: slice | Ids) -> Array:
        """Steps the simulation with noisy and delayed actions.

        Action k is sent at the beginning of control step k. With n physics steps a control step and
        a latency of d of them, it arrives at physics step k n + d.

        Args:
            ctrl: (N, A + 1) the actions of the agent, in actuator units, the pedal last.
            moving: the environments that take the step.

        Returns:
            (N, A + 1) the actions that hold at the end of the step.
        """
        env_ids = None if isinstance(moving, slice) else moving.tolist()
        if self._config.control_noise:
            ctrl = self._with_noise(ctrl, moving)
        if _LATENCY in self.drawn and isinstance(self._simulation, RandomizableSimulation):
            ctrl, held = self._arriving(ctrl, moving)
            self._simulation.step(ctrl[:, :-1], env_ids, held)
        else:
            self._simulation.step(ctrl[:, :-1], env_ids)
        self._draw_noise(moving)
        return ctrl

    def _arriving(self, ctrl: Array, moving: slice | Ids) -> tuple[Array, Held]:
        """(N, A + 1) the actions that hold at the end of the step, and those held before."""
        sent = self._sent
        sent[moving, 1:] = sent[moving, :-1]
        sent[moving, 0] = ctrl[moving]
        steps, substeps = np.divmod(self._late, self._substeps)
        before = sent[self._env_ids, steps + 1]
        return sent[self._env_ids, steps], Held(before[:, :-1], substeps)

    def _with_noise(self, ctrl: Array, moving: slice | Ids) -> Array:
        noisy = ctrl.copy()
        for env in self._env_ids[moving].tolist():
            noise = self._control_rngs[env].standard_normal(len(self._control_noise))
            noisy[env, :-1] += self._control_noise * noise
        noisy[:, :-1] = np.clip(noisy[:, :-1], self._low, self._high)
        return noisy

    def _draw_noise(self, moving: slice | Ids) -> None:
        """Draws the noise of the next observations."""
        if not self._noise.any():
            return
        for env in self._env_ids[moving].tolist():
            normal = self._observation_rngs[env].standard_normal(len(self._noise))
            self._offset[env] = self._noise * normal

    def observed_joints(self, hand_qpos: Array) -> Array:
        """(N, J) joint positions with noise."""
        joints = slice(0, hand_qpos.shape[1])
        return hand_qpos + self._offset[:, joints] if self._noise[joints].any() else hand_qpos

    def observed_keys(self, key_state: Array) -> Array:
        """(N, K) key states with noise, 0 to 1."""
        if not self._config.key_noise:
            return key_state
        return np.clip(key_state + self._offset[:, -key_state.shape[1] :], 0.0, 1.0)


def _check(config: DomainRandomization, factors: Sequence[str]) -> None:
    limits = {name: (_LEAST_FACTOR.get(name, 0.0), _MOST_FACTOR) for name in factors}
    for name, (least, most) in (limits | {_LATENCY: (0.0, _MOST_LATENCY)}).items():
        low, high = getattr(config, name)
        if not least <= low <= high <= most:
            raise CadenzaError(
                f"{_PREFIX}{name} {low} {high}: give the least and the greatest, both from "
                f"{least:g} to {most:g}"
            )
    numbers = {name: (0.0, most) for name, most in _MOST_NOISE.items()}
    if config.seed is not None:
        numbers[_SEED] = (0, MOST_COUNT)
    check_ranges(config, numbers, _PREFIX)
