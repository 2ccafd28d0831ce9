"""Domain randomization: its effect on simulations, actions and observations."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.configs import MAX_COUNT
from cadenza.scene.randomization import Factors
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import HeldControls, Simulation, State
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.draw_ranges import (
    CONTROL,
    GRAVITY_TILT,
    LATENCY,
    PUSH,
    PUSHES,
    SEED,
    SERVO_RANGES,
    DrawRanges,
    moved_setpoints,
)
from cadenza.tasks.senses import Senses

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


class Randomization:
    """The randomization of the physics, actions and observations of N environments.

    At each reset an environment draws a seed, from which all that is random in its episode follows,
    see `DrawRanges`.

    Attributes:
        drawn: name -> (N, ...) draws for the episode of each environment, see `DrawRanges.draws`,
            and "seed". Empty if nothing is on.
    """

    def __init__(
        self,
        config: DomainRandomization,
        scene: Scene,
        control_timestep: float,
        num_envs: int,
        simulation: Simulation,
    ) -> None:
        """Prepare to draw at resets of N environments of a simulation.

        Raises CadenzaError if a range makes no sense.
        """
        self._ranges = ranges = DrawRanges(config, scene, control_timestep)
        self._simulation = simulation
        self._env_ids = np.arange(num_envs)
        self.drawn: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
            name: np.ones((num_envs, *shape)) for name, shape in ranges.shapes.items()
        }
        if config.is_on:
            self.drawn[SEED] = np.zeros(num_envs, np.int64)
        self._moves_setpoints = not self.drawn.keys().isdisjoint(SERVO_RANGES)
        self._control_rngs = [np.random.default_rng(0)] * num_envs  # until episodes begin
        self._push_rngs = list(self._control_rngs)
        self._latency_steps = np.zeros(num_envs, np.intp)  # in physics steps
        if LATENCY in self.drawn:
            self._sent = np.zeros((num_envs, ranges.num_sent, len(scene.action_low)))
        # Setpoints of each servo's motor and of its load.
        self._setpoint = np.zeros((num_envs, 2, len(ranges.low)))
        self._senses = Senses(ranges, num_envs)

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
        rest = self._ranges.resting_ctrl(start)[:, None]
        self._setpoint[list(env_ids)] = rest
        if LATENCY in self.drawn:
            self._sent[list(env_ids), :, :-1] = rest
            self._sent[list(env_ids), :, -1] = 0.0  # the pedal is up

    def _draw(self, env: int, seed: int) -> Factors:
        ranges, robot = self._ranges, self._ranges.config.robot
        drawn = ranges.draws(seed if robot is None else robot)
        for name, values in drawn.items():
            self.drawn[name][env] = values
        self.drawn[SEED][env] = seed
        self._latency_steps[env] = ranges.steps_of(drawn.get(LATENCY, 0.0))
        self._control_rngs[env] = ranges.generator(seed, CONTROL)
        self._push_rngs[env] = ranges.generator(seed, PUSH)
        self._senses.begin(env, seed, drawn)
        return {name: drawn[name] for name in ranges.of_model}

    def start_sensing(self, env_ids: Sequence[int], state: State) -> None:
        """Sense the beginnings of episodes, whose simulations have been reset."""
        if self.drawn:
            self._senses.start(np.asarray(env_ids, np.intp), state)

    @property
    def per_env(self) -> list[Any]:
        """Arrays and lists of what each environment has of its own, without its simulation."""
        late = [self._sent] if LATENCY in self.drawn else []
        arrays = [self._control_rngs, self._push_rngs, self._latency_steps, self._setpoint]
        return [*self.drawn.values(), *late, *arrays, *self._senses.per_env]

    # In each step

    def step(self, ctrl: Array, moving: slice | Ids) -> Array:
        """Step the simulation with noisy and delayed actions; returns the actions at its end.

        Actions (N, A + 1) are in actuator units, the pedal last. Action k is sent at the beginning
        of control step k. With n physics steps a control step and a latency of d of them, it
        arrives at physics step k n + d.
        """
        env_ids = None if isinstance(moving, slice) else moving.tolist()
        config, path = self._ranges.config, self._senses.path
        if self._ranges.control_noise.any():
            ctrl = self._with_noise(ctrl, moving)
        if self._moves_setpoints:
            ctrl = self._moved(ctrl, moving)
        if config.gravity_tilt or config.push:
            self._push(moving)
        options: dict[str, Any] = {} if path is None else {"path": path}
        if LATENCY in self.drawn:
            ctrl, held = self._arriving(ctrl, moving)
            options["held"] = held
        self._simulation.step(ctrl[:, :-1], env_ids, **options)
        if self.drawn:
            self._senses.step(self._simulation.state, moving)
        return ctrl

    def _moved(self, ctrl: Array, moving: slice | Ids) -> Array:
        """(N, A + 1) setpoints of servos with their speed limits, dead bands and backlash."""
        drawn = {name: self.drawn[name][moving] for name in SERVO_RANGES if name in self.drawn}
        setpoint = moved_setpoints(self._ranges, self._setpoint[moving], ctrl[moving, :-1], drawn)
        self._setpoint[moving], ctrl = setpoint, ctrl.copy()
        ctrl[moving, :-1] = setpoint[:, 1]
        return ctrl

    def _push(self, moving: slice | Ids) -> None:
        """Push hands: by uncompensated gravity, and now and then by a random force."""
        ranges, scene = self._ranges, self._ranges.scene
        for env in self._env_ids[moving].tolist():
            force = np.zeros((scene.model.nbody, 3))
            if ranges.config.gravity_tilt:
                x, y = self.drawn[GRAVITY_TILT][env]
                off = math.sin(y), -math.sin(x), math.cos(x) * math.cos(y) - 1
                force += ranges.weight[:, None] * np.array(off)
            rng = self._push_rngs[env]
            if ranges.config.push and rng.random() < PUSHES * ranges.control_timestep:
                direction = rng.standard_normal(3)
                direction /= np.linalg.norm(direction)
                force[rng.choice(scene.palm_bodies)] += (
                    rng.uniform(0, ranges.config.push) * direction
                )
            self._simulation.push(env, force)

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

    def sensed(self, state: State) -> State:
        """The state as sensors measure it, see `Senses.sensed`."""
        return self._senses.sensed(state)
