"""The task as rsl_rl's `VecEnv`, for which the package has the extra `rsl-rl`."""

from __future__ import annotations

from typing import Any

from gymnasium.vector import AutoresetMode, VectorEnv

from cadenza.errors import CadenzaError, extra_packages
from cadenza.music.metrics import STEP_METRICS

with extra_packages("rsl-rl", "an environment of rsl_rl"):
    import torch
    from rsl_rl.env import VecEnv
    from tensordict import TensorDict

_METRIC = "metrics/"  # before the names of metrics in infos of the CPU


class RslRlPiano(VecEnv):
    """A wrapper of "cadenza/Piano-v0" of `gymnasium.make_vec`, with `AutoresetMode.SAME_STEP`.

    With `engine="warp"` nothing leaves the device. Observations have the group "policy", and with
    `privileged=True` also "privileged", for critics. Actions are clipped to [-1, 1]. Episodes begin
    with their songs, so that `init_at_random_ep_len` of a runner only changes its statistics.
    """

    def __init__(self, envs: VectorEnv, seed: int | None = 0) -> None:
        """Begin episodes in all environments.

        Raises CadenzaError if they do not begin new episodes in the step that ends the last.
        """
        if envs.metadata["autoreset_mode"] != AutoresetMode.SAME_STEP:
            raise CadenzaError("autoreset_mode: give gymnasium.vector.AutoresetMode.SAME_STEP")
        self._envs, self.unwrapped = envs, envs.unwrapped
        self._observation = self._groups(*envs.reset(seed=seed))
        task: Any = self.unwrapped.task  # type: ignore[attr-defined]
        self.num_envs, self.num_actions = envs.num_envs, task.spec.action_size
        self.device = self._observation.device
        self.max_episode_length = max(track.goals.num_steps for track in task.tracks)
        self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.long, device=self.device)
        self.cfg = {"task": task.config, "scene": task.scene.config}

    def get_observations(self) -> TensorDict:
        return self._observation

    def step(
        self, actions: torch.Tensor
    ) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Take a control step in every environment with actions (N, A)."""
        clipped = actions.detach().clamp(-1.0, 1.0)
        is_host = self.device.type == "cpu"
        observation, reward, *ends, infos = self._envs.step(clipped.numpy() if is_host else clipped)
        terminated, truncated = map(torch.from_dlpack, ends)
        ended = terminated | truncated
        self.episode_length_buf = torch.where(ended, 0, self.episode_length_buf + 1)
        self._observation = self._groups(observation, infos)
        extras = {"time_outs": truncated, "log": self._log(ended, infos)}
        return self._observation, torch.from_dlpack(reward).float(), ended, extras

    def _groups(self, observation: Any, infos: dict[str, Any]) -> TensorDict:
        groups = {"policy": observation}
        if "privileged" in infos:
            groups["privileged"] = infos["privileged"]
        tensors = {name: torch.from_dlpack(values) for name, values in groups.items()}
        policy = tensors["policy"]
        return TensorDict(tensors, batch_size=policy.shape[:1], device=policy.device)

    def _log(self, ended: torch.Tensor, infos: dict[str, Any]) -> dict[str, torch.Tensor]:
        """The metrics of the episodes that have ended, if any have."""
        if not ended.any():
            return {}
        if "final_info" not in infos:
            return {f"/{name}": torch.from_dlpack(infos[name])[ended] for name in STEP_METRICS}
        last = infos["final_info"]
        return {
            f"/{name.removeprefix(_METRIC)}": torch.from_dlpack(values[last[f"_{name}"]])
            for name, values in last.items()
            if name.startswith(_METRIC)
        }
