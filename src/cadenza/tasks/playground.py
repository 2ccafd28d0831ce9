"""The task on the device as MuJoCo Playground and brax know environments: a world at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cadenza.errors import CadenzaError, extra_packages
from cadenza.music.metrics import STEP_METRICS
from cadenza.sim.render import Picture, Renderer
from cadenza.tasks.env import scores_of
from cadenza.tasks.functional import FunctionalPianoTask, PianoState
from cadenza.tasks.reward import RewardTerm, key_activation
from cadenza.tasks.setups import configure

with extra_packages("gpu", "the engine warp"):
    import jax
    import jax.numpy as jnp
    from jax.custom_batching import custom_vmap

Array = Any  # of JAX


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WorldState:
    """A world after a step, or under `jax.vmap` a batch of them, with the fields of Playground."""

    data: Any  # the physics and the episode: what an automatic reset puts back
    obs: Array  # (D,) float32
    reward: Array  # () of the step
    done: Array  # () float32, 1 if the episode ended with the step
    # Name -> (): the terms of the reward; and at the end of an episode its precision, recall and
    # f1, 0 before, so that the sum over the steps is that of the episode
    metrics: dict[str, Array]
    # Name -> (): "key", the random key; "song", the index of the song; and what wrappers add
    info: dict[str, Array]

    @property
    def pipeline_state(self) -> Any:
        """The name of `data` in brax."""
        return self.data

    def replace(self, **changes: Any) -> WorldState:
        """A state with other values in some fields."""
        if "pipeline_state" in changes:
            changes["data"] = changes.pop("pipeline_state")
        return replace(self, **changes)


class PlaygroundPiano:
    """An environment with `reset(key)` and `step(state, action)` of one world, for `jax.vmap`.

    Wherever `jax.vmap` maps `step`, all worlds are stepped together by a `FunctionalPianoTask`. An
    episode ends with its song; brax's wrapper then puts the world back to where it began, so that
    each world keeps the song that it drew. `episode_length` is that of the longest song.
    """

    def __init__(
        self,
        song: Any,
        make_physics: Any = None,
        reward_terms: Mapping[str, RewardTerm] | None = None,
        **options: Any,
    ) -> None:
        """Make the environment of a song, or of several, which worlds draw from.

        The arguments are those of `PianoVectorEnv` and `FunctionalPianoTask`. Raises CadenzaError
        if a song cannot be played, or an option makes no sense or is missing here.
        """
        how = configure(options)
        self.task = FunctionalPianoTask(
            scores_of(song), *how, make_physics=make_physics, reward_terms=reward_terms
        )
        self._tasks = {1: self.task}  # number of worlds -> task
        self.action_size = self.task.spec.action_size
        self.observation_size = self.task.spec.observation_size
        self.dt, self.mj_model = self.task.config.control_timestep, self.task.scene.model
        self.episode_length = int(self.task.songs.num_steps.max())
        self.step, self.unwrapped = self._mapped_step(), self

    def reset(self, key: Array) -> WorldState:
        """Begin an episode in a world."""
        state = _worlds(self.task.reset(_typed(key)), 1)
        return jax.tree.map(lambda values: values[0], state)

    def _mapped_step(self) -> Callable[[WorldState, Array], WorldState]:
        @custom_vmap
        def step(state: WorldState, action: Array) -> WorldState:
            batch = jax.tree.map(lambda values: values[None], (state, action))
            return jax.tree.map(lambda values: values[0], self._step(1, *batch))

        @step.def_vmap
        def steps(num_worlds: int, mapped: Any, *given: Any) -> tuple[WorldState, WorldState]:
            def worlds(values: Array, is_mapped: bool) -> Array:
                return values if is_mapped else jnp.stack([values] * num_worlds)

            after = self._step(num_worlds, *jax.tree.map(worlds, given, tuple(mapped)))
            return after, jax.tree.map(lambda _: True, after)

        return step

    def _step(self, num_worlds: int, state: WorldState, action: Array) -> WorldState:
        """Step a batch of worlds with actions (N, A) in [-1, 1], the pedal last."""
        if num_worlds not in self._tasks:
            with jax.ensure_compile_time_eval():  # its constants outlive what is being traced
                self._tasks[num_worlds] = self.task.resized(num_worlds)
        key, done = _typed(state.info["key"][0]), state.done > 0
        data, episodes = state.data
        counts = dict.fromkeys(("unstable_count", "overflow_count"), jnp.zeros((), jnp.int32))
        before = PianoState(data, episodes, key, state.obs, state.reward, done, {}, counts)
        after = _worlds(self._tasks[num_worlds].step(before, action), num_worlds)
        # Wrappers add to both.
        return after.replace(metrics=state.metrics | after.metrics, info=state.info | after.info)

    def render(
        self,
        trajectory: Sequence[WorldState],
        height: int = 240,
        width: int = 320,
        camera: str | None = None,
    ) -> list[Any]:
        """Draw states of one world, as pictures (height, width, 3).

        Raises CadenzaError if this machine cannot draw, there is no such camera, or states are
        batches.
        """
        scene, pictures = self.task.scene, []
        with closing(Renderer(scene, Picture(width, height, camera or "back"))) as renderer:
            for state in trajectory:
                qpos = np.asarray(state.data[0].qpos, float)
                if qpos.ndim > 1:
                    raise CadenzaError(f"states of {len(qpos)} worlds: render those of one")
                keys = qpos[scene.key_qpos]
                sounding = key_activation(keys, scene.keyboard.sounds_from)
                hands = qpos[scene.hand_qpos]
                pictures.append(renderer.frame(hands, keys, sounding, sounding))
        return pictures


def _worlds(state: PianoState, num_worlds: int) -> WorldState:
    """Worlds (N,) of a batch, each with a random key of its own."""
    ends = {name: jnp.where(state.done, state.metrics[name], 0.0) for name in STEP_METRICS}
    keys = jax.random.key_data(jax.random.split(state.key, num_worlds))
    info, done = {"key": keys, "song": state.info["song"]}, state.done.astype(jnp.float32)
    data, reward = (state.data, state.episodes), state.reward.astype(jnp.float32)
    return WorldState(data, state.obs, reward, done, state.metrics | ends, info)


def _typed(key: Array) -> Array:
    """A key of `jax.random.key`, also of one that `jax.random.PRNGKey` made, as brax does."""
    is_typed = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
    return key if is_typed else jax.random.wrap_key_data(key)
