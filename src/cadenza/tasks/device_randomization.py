"""Domain randomization as pure functions of JAX's arrays, for `FunctionalPianoTask`."""

from typing import Any, NamedTuple

from cadenza.errors import extra_packages
from cadenza.scene.randomization import scaled_fields
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import HeldControls
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.draw_ranges import LATENCY, DrawRanges

with extra_packages("gpu", "the engine warp"):
    import jax
    import jax.numpy as jnp

Array = Any  # of JAX

VARIANTS = 4096
"""How many seeds episodes draw from, with 12 kB each for a model. MuJoCo computes models on the
host, in 0.6 ms, so that they are there before the first step."""


class Draws(NamedTuple):
    """What is random in the episodes of N environments."""

    seed: Array  # (N,) int32, the seed from which models and latencies follow, as in `DrawRanges`
    sent: Array  # (N, L, A + 1) the last actions in actuator units, the newest first
    offset: Array  # (N, J + K + F) noise on observed joints [m, rad], key states and, none, touch


class DeviceRandomization:
    """The randomization of the physics, actions and observations of N environments.

    The same seed draws the same models and latencies as in `Randomization`; noise has other bits.
    """

    def __init__(
        self, config: DomainRandomization, scene: Scene, control_timestep: float, num_envs: int
    ) -> None:
        """Compute the models that episodes of N environments draw from.

        Raises CadenzaError if a range makes no sense, or the engine warp does not have it.
        """
        self._ranges = ranges = DrawRanges(config, scene, control_timestep)
        ranges.refuse_on_device()
        self._num_envs, self.scaled = num_envs, ranges.of_model
        self._first, count = (0, VARIANTS) if config.seed is None else (config.seed, 1)
        self._count = count if self.scaled or ranges.has_latency else 1
        seeds = range(self._first, self._first + self._count)
        models = scaled_fields(scene, map(ranges.factors, seeds)) if self.scaled else {}
        self._models: dict[str, Any] = {n: jnp.asarray(values) for n, values in models.items()}
        late = [ranges.steps_of(ranges.draws(s)[LATENCY]) for s in seeds if ranges.has_latency]
        self._latency_steps: Any = jnp.asarray(late, jnp.int32)

    def begin(self, key: Array, start: Array) -> Draws:
        """Draw for episodes in which the hands start at joint positions (N, J) [m, rad]."""
        of_seed, of_noise = jax.random.split(key)
        seed = self._first + jax.random.randint(of_seed, (self._num_envs,), 0, self._count)
        num_sent = self._ranges.num_sent if self._ranges.has_latency else 0
        rest = jnp.pad(self._ranges.resting_ctrl(start), ((0, 0), (0, 1)))  # the pedal is up
        sent = jnp.tile(rest[:, None], (1, num_sent, 1))
        return Draws(seed, sent, self._offset(of_noise))

    def _offset(self, key: Array) -> Array:
        noise = jnp.asarray(self._ranges.observation_noise)
        return noise * jax.random.normal(key, (self._num_envs, len(noise)))

    def send(self, draws: Draws, ctrl: Array, key: Array) -> tuple[Draws, Array, dict[str, Any]]:
        """Send actions (N, A + 1) at the beginning of a control step, see `Randomization.step`.

        Returns the draws, the actions (N, A + 1) that hold at the end of the step, and what else
        the physics takes, see `cadenza.sim.warp.WarpPhysics.step`.
        """
        of_control, of_observation = jax.random.split(key)
        draws = draws._replace(offset=self._offset(of_observation))
        ranges, others = self._ranges, dict[str, Any]()
        variant = draws.seed - self._first
        if ranges.config.control_noise:
            noise = ranges.control_noise * jax.random.normal(of_control, ctrl[:, :-1].shape)
            noisy = (ctrl[:, :-1] + noise).clip(ranges.low, ranges.high)
            ctrl = jnp.concatenate([noisy, ctrl[:, -1:]], axis=1)
        if ranges.has_latency:
            sent: Any = jnp.concatenate([ctrl[:, None], draws.sent[:, :-1]], axis=1)
            draws = draws._replace(sent=sent)
            steps, substeps = divmod(self._latency_steps[variant], ranges.substeps)
            envs = jnp.arange(self._num_envs)
            ctrl = sent[envs, steps]
            others["held"] = HeldControls(sent[envs, steps + 1, :-1], substeps)
        if self._models:
            others["models"] = {name: values[variant] for name, values in self._models.items()}
        return draws, ctrl, others

    def observed_joints(self, draws: Draws, hand_qpos: Array) -> Array:
        """(N, J) joint positions with noise."""
        return hand_qpos + draws.offset[:, : hand_qpos.shape[1]]

    def observed_keys(self, draws: Draws, key_state: Array) -> Array:
        """(N, K) key states with noise, 0 to 1."""
        joints, keys = len(self._ranges.scene.hand_joint_names), key_state.shape[1]
        return (key_state + draws.offset[:, joints : joints + keys]).clip(0.0, 1.0)
