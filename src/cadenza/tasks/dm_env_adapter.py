"""The task as a `dm_env.Environment`, for which the package has the extra `dm-env`."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import dm_env
import gymnasium
import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, quoted
from cadenza.tasks.env import PianoEnv
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.published import DEFAULTS, translated

_STATISTICS = "return", "length"
_NOT_INCLUDED = "Rousseau"  # two published pieces are arrangements by him
_NAME = re.compile(r"RoboPianist-(debug|etude-12|repertoire-150)-(\w+)-v0")


def load(
    environment_name: str = "",
    midi_file: str | Path | None = None,
    seed: int | None = None,
    stretch: float = 1.0,
    shift: int = 0,
    recompile_physics: bool = False,  # noqa: ARG001
    legacy_step: bool = True,  # noqa: ARG001
    task_kwargs: Mapping[str, Any] | None = None,
    deque_size: int = 1,
) -> DmEnvAdapter:
    """Make an environment with the arguments and defaults of RoboPianist's `suite.load`.

    Actions are in actuator units, as there. Pieces of RoboPianist-repertoire-150 and -etude-12 are
    there once the PIG dataset has been imported (`cadenza import pig`). Raises CadenzaError if
    there is no such environment, song or option.

    Args:
        environment_name: a published name, such as "RoboPianist-debug-CMajorScaleOneHand-v0".
        midi_file: the path of a music file to play instead.
        seed: the seed of the first episode; the following ones continue its random numbers.
        stretch: the factor of all times.
        shift: semitones to transpose by.
        recompile_physics, legacy_step: have no effect; the model is always as after compiling.
        task_kwargs: published options of the task, or fields of `TaskConfig` and `SceneConfig`.
        deque_size: over how many episodes metrics and statistics are means.
    """
    named = _NAME.fullmatch(environment_name)
    if midi_file is None and named is None:
        raise CadenzaError(
            f"no environment {quoted(environment_name)}: give the name of a published one, such as "
            "RoboPianist-debug-CMajorScaleOneHand-v0, or a midi_file"
        )
    library, piece = named.groups() if named else ("", "")
    if midi_file is None and piece.endswith(_NOT_INCLUDED):
        raise CadenzaError(
            f"{environment_name}: this arrangement does not come with Cadenza; give its file as "
            "midi_file"
        )
    song = midi_file or (piece if library == "debug" else f"{library}/{piece}")
    options = {**DEFAULTS, "stretch": stretch, "transpose": shift, **translated(task_kwargs or {})}
    return DmEnvAdapter(PianoEnv(song, **options), seed, deque_size, actuator_units=True)


class DmEnvAdapter(dm_env.Environment):
    """A wrapper of a `PianoEnv`, or of what `gymnasium.make` makes of it.

    Observations are dictionaries of the parts of `observation_layout`.

    The last step of a score has discount 1, as in the published environment; one that ends on a
    wrong key or an unstable simulation has discount 0.

    Attributes:
        task: goals, states and metrics of the episode, in batches of one.
        random_state: a generator for random actions, which follows from the seed.
    """

    task: PianoTask

    def __init__(
        self,
        env: gymnasium.Env,
        seed: int | None = None,
        deque_size: int = 1,
        actuator_units: bool = False,
    ) -> None:
        """Adapt an environment of Gymnasium, without pixels or wrappers that change observations.

        `seed` seeds the first episode, and metrics are means over `deque_size` episodes. With
        `actuator_units`, actions are in actuator units instead of [-1, 1].

        Raises CadenzaError if observations are not those of a `PianoEnv`.
        """
        piano = env.unwrapped
        if not isinstance(piano, PianoEnv):
            raise CadenzaError(f"the dm_env adapter takes a PianoEnv, not {type(piano).__name__}")
        if piano.observation_space.shape is None:
            raise CadenzaError(
                "the dm_env adapter does not support pixels: make the environment without them"
            )
        if env.observation_space.shape != piano.observation_space.shape:
            raise CadenzaError(
                f"observations of shape {env.observation_space.shape}: leave out the wrapper that "
                "changes them; the dm_env adapter splits those of the environment into their parts"
            )
        self._env, self.task = env, piano.task
        self.random_state = np.random.default_rng(seed)
        self._actuator_units = actuator_units
        self._layout = piano.observation_layout
        self._seed = seed
        self._ended, self._return = True, 0.0
        self._episodes: deque[dict[str, float]] = deque(maxlen=deque_size)

    def reset(self) -> dm_env.TimeStep:
        """Start a new episode."""
        observation, _ = self._env.reset(seed=self._seed)
        self._seed, self._ended, self._return = None, False, 0.0
        return dm_env.restart(self._parts(observation))

    def step(self, action: NDArray[Any]) -> dm_env.TimeStep:
        """Take a control step, or after the end of an episode a reset, as dm_env demands."""
        if self._ended:
            return self.reset()
        action = np.asarray(action)
        if self._actuator_units and action.shape == self._env.action_space.shape:
            action = self.task.spec.unscale_action(action)
        observation, reward, terminated, truncated, _ = self._env.step(action)
        parts, self._return = self._parts(observation), self._return + float(reward)
        self._ended = terminated or truncated
        if self._ended:
            goals = self.task.goals
            length = float(goals.steps_done[0] - goals.first_step[0])
            statistics = {"return": self._return, "length": length}
            self._episodes.append(statistics | self.task.episode_metrics(0))
        if terminated:
            return dm_env.termination(reward, parts)
        if truncated:
            return dm_env.truncation(reward, parts, discount=1.0)
        return dm_env.transition(reward, parts)

    def _parts(self, observation: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
        return {name: observation[part] for name, part in self._layout.items()}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Name -> shape of each part of an observation."""
        return {
            name: specs.Array((part.stop - part.start,), np.float32, name)
            for name, part in self._layout.items()
        }

    def action_spec(self) -> specs.BoundedArray:
        """The bounds of actions (A,), with the names of the actuators, the pedal last."""
        spec = self.task.spec
        name = "\t".join([*spec.scene.actuator_names, "sustain"])  # as dm_control joins them
        if not self._actuator_units:
            return specs.BoundedArray((spec.action_size,), np.float32, -1.0, 1.0, name)
        low, high = spec.action_low, spec.action_high
        return specs.BoundedArray((spec.action_size,), np.float64, low, high, name)

    def control_timestep(self) -> float:
        """The time between two actions [s]."""
        return self.task.config.control_timestep

    def get_statistics(self) -> dict[str, float]:
        """The mean return and length [steps] of the last `deque_size` episodes.

        Raises CadenzaError if no episode has ended.
        """
        means = self._means()
        return {name: means[name] for name in _STATISTICS}

    def get_musical_metrics(self) -> dict[str, float]:
        """The means of the metrics of the last `deque_size` episodes, where they have a value.

        They are those of RoboPianist's `MidiEvaluationWrapper`, and of whole notes, see
        `cadenza.music.metrics.playing_metrics`. Raises CadenzaError if no episode has ended.
        """
        return {name: mean for name, mean in self._means().items() if name not in _STATISTICS}

    def _means(self) -> dict[str, float]:
        if not self._episodes:
            raise CadenzaError("no episode has ended: step until timestep.last()")
        values = {n: [each[n] for each in self._episodes] for n in self._episodes[0]}
        numbers = {n: [v for v in each if not np.isnan(v)] for n, each in values.items()}
        return {name: float(np.mean(each)) for name, each in numbers.items() if each}

    @property
    def physics(self) -> Any:
        """Raise a CadenzaError that says what to use instead of dm_control's physics."""
        raise CadenzaError(
            "there is no physics of dm_control: task.state has positions, speeds and forces, "
            "task.scene.model the MjModel, and pixels=True of the environment or render() pictures"
        )

    def close(self) -> None:
        """Free graphics."""
        self._env.close()
