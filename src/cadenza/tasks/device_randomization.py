"""Domain randomization as pure functions of JAX's arrays, for `FunctionalPianoTask`."""

from typing import Any, NamedTuple

import numpy as np

from cadenza.errors import extra_packages
from cadenza.scene.randomization import KEY_SOUNDING, scaled_fields
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import HeldControls, Path, State
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.draw_ranges import (
    BIAS,
    GRAVITY_TILT,
    LATENCY,
    MINUTE,
    OBSERVATION_LATENCY,
    PUSHES,
    SERVO_RANGES,
    DrawRanges,
    moved_setpoints,
)
from cadenza.tasks.senses import sensed_state

with extra_packages("gpu", "the engine warp"):
    import jax
    import jax.numpy as jnp

Array = Any  # of JAX

VARIANTS = 4096
"""Number of seeds that episodes draw from; the model of each takes 12 kB. MuJoCo computes them on
the host, in 0.6 ms each, before the first step."""


class Draws(NamedTuple):
    """What is random in the episodes of N environments."""

    seed: Array  # (N,) int32, the seed of everything but noise, pushes and drift
    sent: Array  # (N, L, A + 1) the last actions in actuator units, the newest first
    setpoint: Array  # (N, 2, A) setpoints of each servo's motor and of its load
    wandered: Array  # (N, J + K + F) drift of the biases of sensors
    offset: Array  # (N, J + K + F) errors of observed joints [m, rad], key states and touch [N]
    past: Any  # the last states, a `Path` (N, H, ...), the newest last; None if nothing is late
    late_events: Any  # (N, W, 3, K) onsets, offsets, speeds of keys that the next W steps observe


class DeviceRandomization:
    """The randomization of the physics, actions and observations of N environments.

    The same seed draws the same as in `Randomization`; noise, pushes and drift have other bits.

    Attributes:
        physics: arguments for `cadenza.sim.warp.WarpPhysics`.
    """

    def __init__(
        self, config: DomainRandomization, scene: Scene, control_timestep: float, num_envs: int
    ) -> None:
        """Compute the models that episodes of N environments draw from.

        Raises CadenzaError if a range makes no sense.
        """
        self._ranges = ranges = DrawRanges(config, scene, control_timestep)
        self._num_envs = num_envs
        fixed = config.seed if config.robot is None else config.robot
        self._first, count = (0, VARIANTS) if fixed is None else (fixed, 1)
        self._count = count if ranges.shapes else 1
        drawn = [ranges.draws(seed) for seed in range(self._first, self._first + self._count)]
        factors = ({name: draws[name] for name in ranges.of_model} for draws in drawn)
        models = scaled_fields(scene, factors) if ranges.of_model else {}
        self._models: dict[str, Any] = {n: jnp.asarray(values) for n, values in models.items()}
        names = (*SERVO_RANGES, BIAS, GRAVITY_TILT, KEY_SOUNDING)
        self._drawn: dict[str, Any] = {
            name: jnp.asarray(np.stack([draws[name] for draws in drawn]), jnp.float32)
            for name in names
            if name in ranges.shapes
        }
        for name in (LATENCY, OBSERVATION_LATENCY):
            steps = [ranges.steps_of(draws.get(name, 0.0)) for draws in drawn]
            self._drawn[name] = jnp.asarray(steps, jnp.int32)
        self._pushed = bool(config.gravity_tilt or config.push)
        self._max_late = ranges.steps_of(config.observation_latency[1])
        self.physics = {"scaled": ranges.of_model, "pushed": self._pushed}
        self.physics["keeps_path"] = bool(self._max_late)

    def _of(self, draws: Draws, name: str) -> Array:
        """(N, ...) what was drawn for each environment."""
        return self._drawn[name][draws.seed - self._first]

    def begin(self, key: Array, state: State) -> Draws:
        """Draw for episodes whose simulations have been reset to a state."""
        of_seed, of_sensors = jax.random.split(key)
        seed = self._first + jax.random.randint(of_seed, (self._num_envs,), 0, self._count)
        num_sent = self._ranges.num_sent if self._ranges.has_latency else 0
        rest = self._ranges.resting_ctrl(state.hand_qpos)
        sent = jnp.pad(rest, ((0, 0), (0, 1)))[:, None]  # the pedal is up
        past = events = None
        if self._max_late:
            past = Path.still(state, self._max_late + 1)
            slots = self._max_late // self._ranges.substeps + 2
            events = jnp.full((self._num_envs, slots, 3, state.key_qpos.shape[1]), jnp.nan)
        nothing = jnp.zeros((self._num_envs, len(self._ranges.bias)))
        setpoint = jnp.repeat(rest[:, None], 2, axis=1)
        late = jnp.repeat(sent, num_sent, axis=1)
        draws = Draws(seed, late, setpoint, nothing, nothing, past, events)
        return self._with_offset(draws, of_sensors)

    def send(self, draws: Draws, ctrl: Array, key: Array) -> tuple[Draws, Array, dict[str, Any]]:
        """Send actions (N, A + 1) at the beginning of a control step, see `Randomization.step`.

        Returns the draws, the actions (N, A + 1) that hold at the end of the step, and other
        arguments of `cadenza.sim.warp.WarpPhysics.step`.
        """
        of_control, of_push = jax.random.split(key)
        ranges, others = self._ranges, dict[str, Any]()
        if ranges.control_noise.any():
            noise = ranges.control_noise * jax.random.normal(of_control, ctrl[:, :-1].shape)
            noisy = (ctrl[:, :-1] + noise).clip(ranges.low, ranges.high)
            ctrl = jnp.concatenate([noisy, ctrl[:, -1:]], axis=1)
        if not self._drawn.keys().isdisjoint(SERVO_RANGES):
            limits = {n: self._of(draws, n) for n in SERVO_RANGES if n in self._drawn}
            setpoint = moved_setpoints(ranges, draws.setpoint, ctrl[:, :-1], limits)
            draws = draws._replace(setpoint=setpoint)
            ctrl = jnp.concatenate([setpoint[:, 1], ctrl[:, -1:]], axis=1)
        if self._pushed:
            others["force"] = self._force(draws, of_push)
        if ranges.has_latency:
            sent: Any = jnp.concatenate([ctrl[:, None], draws.sent[:, :-1]], axis=1)
            draws = draws._replace(sent=sent)
            steps, substeps = divmod(self._of(draws, LATENCY), ranges.substeps)
            envs = jnp.arange(self._num_envs)
            ctrl = sent[envs, steps]
            others["held"] = HeldControls(sent[envs, steps + 1, :-1], substeps)
        if self._models:
            variant = draws.seed - self._first
            others["models"] = {name: values[variant] for name, values in self._models.items()}
        if KEY_SOUNDING in self._drawn:
            others["depth"] = self.sounding_depth(draws)
        return draws, ctrl, others

    def _force(self, draws: Draws, key: Array) -> Array:
        """(N, bodies, 3) uncompensated gravity, and now and then a push [N]."""
        ranges, scene, envs = self._ranges, self._ranges.scene, jnp.arange(self._num_envs)
        force: Any = jnp.zeros((self._num_envs, scene.model.nbody, 3))
        if ranges.config.gravity_tilt:
            x, y = self._of(draws, GRAVITY_TILT).T
            off = jnp.stack([jnp.sin(y), -jnp.sin(x), jnp.cos(x) * jnp.cos(y) - 1], axis=1)
            force += jnp.asarray(ranges.weight)[:, None] * off[:, None]
        if ranges.config.push:
            of_time, of_palm, of_direction, of_size = jax.random.split(key, 4)
            chance = PUSHES * ranges.control_timestep
            size = jax.random.uniform(of_size, envs.shape, maxval=ranges.config.push)
            size *= jax.random.bernoulli(of_time, chance, envs.shape)
            direction = jax.random.normal(of_direction, (len(envs), 3))
            direction /= jnp.linalg.norm(direction, axis=1, keepdims=True)
            palm = jax.random.choice(of_palm, jnp.asarray(scene.palm_bodies), envs.shape)
            force = force.at[envs, palm].add(size[:, None] * direction)
        return force

    def sounding_depth(self, draws: Draws) -> Array:
        """(N, K) the part of the nominal way after which each key sounds; 1 if none differs."""
        return self._of(draws, KEY_SOUNDING) if KEY_SOUNDING in self._drawn else jnp.ones(())

    def sense(self, draws: Draws, state: State, path: Path | None, key: Array) -> Draws:
        """Sense simulations that have taken a step to a state, by a `path` without the one before.

        See `cadenza.tasks.senses.Senses.step`.
        """
        if path is not None:
            length = self._max_late + 1
            past = jax.tree.map(
                lambda past, way: jnp.concatenate([past, way], axis=1)[:, -length:],
                draws.past,
                path,
            )
            draws = draws._replace(past=past, late_events=self._late_events(draws, state))
        return self._with_offset(draws, key)

    def _late_events(self, draws: Draws, state: State) -> Array:
        """(N, W, 3, K) events of keys up to the last step, by the steps that observe them."""
        ranges, onset = self._ranges, state.key_onset
        late = self._of(draws, OBSERVATION_LATENCY)[:, None] * ranges.physics_timestep
        events = jnp.roll(draws.late_events, -1, axis=1).at[:, -1].set(jnp.nan)
        steps = jnp.arange(events.shape[1])[:, None]
        for row, (times, speeds) in enumerate(((onset, state.key_speed), (state.key_offset, None))):
            step, within = jnp.divmod(times + late, ranges.control_timestep)
            now = step[:, None] == steps  # never where nothing has happened, which is NaN
            events = events.at[:, :, row].set(jnp.where(now, within[:, None], events[:, :, row]))
            if speeds is not None:
                events = events.at[:, :, 2].set(jnp.where(now, speeds[:, None], events[:, :, 2]))
        return events

    def _with_offset(self, draws: Draws, key: Array) -> Draws:
        """Draw the errors of the next observations."""
        ranges, (of_noise, of_drift) = self._ranges, jax.random.split(key)
        size = self._num_envs, len(ranges.bias)
        offset = jnp.asarray(ranges.observation_noise) * jax.random.normal(of_noise, size)
        if BIAS not in self._drawn:
            return draws._replace(offset=offset)
        wander = ranges.config.drift * ranges.bias * (ranges.control_timestep / MINUTE) ** 0.5
        wandered = draws.wandered + wander * jax.random.normal(of_drift, size)
        return draws._replace(wandered=wandered, offset=offset + self._of(draws, BIAS) + wandered)

    def sensed(self, draws: Draws, state: State) -> State:
        """The state as sensors measure it; fingertips, which are not observed, are true."""
        late = None
        if draws.past is not None:
            late = self._of(draws, OBSERVATION_LATENCY), draws.past, draws.late_events
        return sensed_state(self._ranges, state, draws.offset, late)
