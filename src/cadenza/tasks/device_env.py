"""The task as Gymnasium's `VectorEnv`, whose arrays stay on the device."""

import logging
from collections.abc import Mapping
from functools import partial
from inspect import signature
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cadenza.errors import CadenzaError, extra_packages, quoted
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.env import PianoVectorEnv, checked_seed, scores_of, state_space
from cadenza.tasks.functional import FunctionalPianoTask, PianoState
from cadenza.tasks.reward import RewardTerm
from cadenza.tasks.setups import configure

with extra_packages("gpu", "the engine warp"):
    import jax
    import jax.numpy as jnp

_LOG = logging.getLogger(__name__)


class DevicePianoVectorEnv(VectorEnv):
    """N environments of the task on JAX's device.

    Observations, rewards, ends and infos are arrays of JAX, which other libraries take over without
    a copy by DLPack: `torch.from_dlpack(observation)`. Actions are arrays of any library that has
    DLPack, or of NumPy.

    An environment whose episode has ended is reset in the same step, as in
    `gymnasium.vector.AutoresetMode.SAME_STEP`. `infos` holds what `PianoState` has as `metrics` and
    as `info`; "final_obs" (N, D) are the observations after the step, of all environments. Unlike
    Gymnasium's own, infos have no masks: which environments have ended is only known on the device.
    The first environment that becomes unstable after a reset is logged; infos count them all.
    """

    def __init__(
        self,
        song: Any = None,
        num_envs: int = 1,
        task: TaskConfig | None = None,
        scene: SceneConfig | None = None,
        make_physics: Any = None,
        reward_terms: Mapping[str, RewardTerm] | None = None,
        **options: Any,
    ) -> None:
        """Make N environments of a song, or of songs that episodes are drawn from.

        The options are fields of `TaskConfig` and `SceneConfig`; see `PianoVectorEnv`, and
        `FunctionalPianoTask` on `make_physics` and `reward_terms`. Raises CadenzaError if a song
        cannot be played, or an option makes no sense or is missing here.
        """
        if options.get("autoreset_mode") == AutoresetMode.SAME_STEP:
            del options["autoreset_mode"]
        if missing := sorted(options.keys() & signature(PianoVectorEnv).parameters.keys()):
            raise CadenzaError(f"the engine warp has no {', '.join(missing)}: choose the engine c")
        config, scene = configure(options, task, scene)
        self.task = FunctionalPianoTask(
            scores_of(song), config, scene, num_envs, make_physics, reward_terms
        )
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.render_mode = None
        self.single_action_space = spaces.Box(-1.0, 1.0, (self.task.spec.action_size,), np.float32)
        self.single_observation_space = state_space(self.task.spec)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._state: PianoState | None = None
        self._step = jax.jit(self._logged_step)

    @property
    def observation_layout(self) -> dict[str, slice]:
        """Name -> slice of an observation (see `PianoTask.observation`)."""
        return self.task.spec.observation_layout

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes in all environments; without a seed, the random numbers go on.

        Raises CadenzaError if there is an option.
        """
        if options:
            raise CadenzaError(
                f"reset: the engine warp has no option {quoted(next(iter(options)))}"
            )
        seed = checked_seed(seed)
        if seed is None and self._state is not None:
            key = self._state.key
        else:
            key = jax.random.key(int(self.np_random.integers(2**31)) if seed is None else seed)
        self._state = self.task.reset(key)
        return self._state.obs, dict(self._state.info)

    def _logged_step(self, state: PianoState, action: Any) -> PianoState:
        """A step of the task, which calls the host only when the first simulation fails."""
        after = self.task.step(state, action)
        counts = [each.info["unstable_count"] for each in (state, after)]
        lost = after.info["unstable_count"], after.info["overflow_count"]
        log = partial(jax.debug.callback, _log_unstable)
        jax.lax.cond((counts[0] == 0) & (counts[1] > 0), log, lambda *_: None, *lost)
        return after

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take a control step with actions (N, A) in every environment.

        Raises CadenzaError if no episode has started, or the actions have another shape.
        """
        if self._state is None:
            raise CadenzaError("no episode has started: call reset() before step()")
        if tuple(actions.shape) != self.action_space.shape:
            raise CadenzaError(
                f"actions of shape {tuple(actions.shape)}: give {self.action_space.shape}"
            )
        on_device = actions if isinstance(actions, np.ndarray) else jnp.from_dlpack(actions)
        self._state = state = self._step(self._state, jnp.asarray(on_device, jnp.float32))
        truncated = state.info["truncation"]
        infos = state.metrics | state.info
        return state.obs, state.reward, state.done & ~truncated, truncated, infos


def _log_unstable(unstable: Any, overflow: Any) -> None:
    why = f", {overflow} of them without room for contacts (Buffers)" if overflow else ""
    _LOG.warning(
        "simulations became unstable: %d in this step%s; their episodes have ended. "
        "infos count all from now on: unstable_count, overflow_count",
        unstable,
        why,
    )
