"""The environment of an unknown robot: ten plays to learn it, and one that is scored."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.configs import MAX_COUNT, whole_number
from cadenza.errors import CadenzaError
from cadenza.tasks.env import Observation, PianoEnv, Song
from cadenza.tasks.robots import PROFILES, Profile

PLAYS = 10  # how often a song may be played before the play that is scored
_OWN = (
    *("randomization", "privileged", "task", "pixels"),
    *("reward_terms", "wrong_press_termination"),  # they see true joints and keys
)


class UnknownRobotEnv(PianoEnv):
    """A song, and a robot and a piano that are drawn from a profile and hidden.

    Observations come from sensors: joints are late, biased and noisy; which keys sound, when they
    began to and how loud is observed late. `key_state` is 1 for a key that sounds, else 0. In the
    first ten plays, rewards are 0 and `info` has only "song" and "play"; in the eleventh they are
    those of `PianoEnv`, without the draws of the robot.
    """

    def __init__(
        self,
        song: Song | None = None,
        robot: int = 0,
        profile: Profile = "realistic",
        **options: Any,
    ) -> None:
        """Draw the robot of this seed.

        Raises CadenzaError if an option would show or change the robot, or makes no sense.
        """
        if known := [name for name in _OWN if options.get(name) not in (None, False)]:
            raise CadenzaError(f"{known[0]}: an unknown robot has no such option; leave it out")
        seed = whole_number(robot, "robot", 0, MAX_COUNT)
        if profile not in PROFILES:
            raise CadenzaError(f"profile {profile!r}: choose from {', '.join(PROFILES)}")
        others = {name: value for name, value in options.items() if name not in _OWN}
        super().__init__(song, randomization=replace(PROFILES[profile], robot=seed), **others)
        self._play = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next play of the song.

        Raises CadenzaError if the song has been played as often as it may.
        """
        if self._play > PLAYS:
            raise CadenzaError(
                f"the robot has played {PLAYS} times and once more: make another environment"
            )
        if options:
            raise CadenzaError(f"no option {sorted(options)[0]!r} of reset: all plays are alike")
        self._play += 1
        observation, info = super().reset(seed=seed)
        return self._shown(observation), self._shown_info(info)

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take a control step, as `gymnasium.Env.step`."""
        observation, reward, terminated, truncated, info = super().step(action)
        scored = self._play > PLAYS
        result = (terminated, truncated, self._shown_info(info))
        return self._shown(observation), reward if scored else 0.0, *result

    def get_state(self) -> Any:
        """Raise a CadenzaError: a real robot cannot go back to where it was."""
        raise CadenzaError("an unknown robot cannot go back to where it was: reset() it")

    def _shown(self, observation: Observation) -> NDArray[np.float32]:
        """The observation with keys that sound or do not, instead of how far they are down."""
        observation, task = np.array(observation), self.task
        depth = task.scene.keyboard.sounds_from * task.drawn["key_sounding"][0]
        observation[task.spec.observation_layout["key_state"]] = task.sensed.key_qpos[0] >= depth
        return observation

    def _shown_info(self, info: dict[str, Any]) -> dict[str, Any]:
        scored = self._play > PLAYS
        public = {n: v for n, v in info.items() if not n.startswith("randomization/")}
        return {**(public if scored else {"song": info["song"]}), "play": self._play}
