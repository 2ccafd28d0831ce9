"""Match onsets of keys with the notes that are due, step by step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.keyboards.keyboard import Keyboard
from cadenza.sim.protocol import State
from cadenza.tasks.goal_track import UpcomingOnsets

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STEPS = np.array([-1, 0, 1])  # in which a note may be due: the last step, the one taken, the next


class OnsetErrors(NamedTuple):
    """How far the onsets of keys in a step are from those of the notes that they play.

    NaN for keys that play no note then, and for keys that sounded twice in the step.
    """

    time: Array
    """(N, K) how much later than its note the key began to sound [s]."""
    velocity: Array
    """(N, K) how much louder than its note the key sounds, in MIDI velocity."""


class OnsetMatching:
    """The search for the note that each onset of a key plays, in N environments.

    A note may be played in the step in which it is due, in the one before and in the one after:
    nobody hears where steps end, and a note that is due at the beginning of one may well come a
    millisecond early. An onset plays the nearest note of its key that has not been played. So each
    note is played once, by the first onset near it: to strike a key again earns nothing.

    Attributes:
        played: (N, 3, K) whether the notes that are due in these steps have been played.
    """

    def __init__(self, num_envs: int, keyboard: Keyboard, control_timestep: float) -> None:
        """Wait for episodes to begin in N environments, in steps of `control_timestep` [s]."""
        self._keyboard, self._control_timestep = keyboard, control_timestep
        self.played = np.zeros((num_envs, len(_STEPS), keyboard.num_keys), bool)

    def begin(self, env: int) -> None:
        """Begin an episode of environment `env`, in which no note has been played."""
        self.played[env] = False

    def match(
        self, due: UpcomingOnsets, state: State, sounded: Mask, moving: NDArray[np.intp] | slice
    ) -> OnsetErrors:
        """Match the onsets of the step that the environments `moving` have taken.

        `due` are the notes as they were upcoming before it, when the keys `sounded` (N, K), and
        `state` is that after it.
        """
        took_it = np.zeros((len(sounded), 1), bool)
        took_it[moving] = True
        env, key = np.nonzero(took_it & ~np.isnan(state.key_onset))  # M onsets
        onset = state.key_onset[env, key]
        near = due.time[env, : len(_STEPS), key] + _STEPS * self._control_timestep
        late, velocity = onset[:, None] - near, due.velocity[env, : len(_STEPS), key]
        open_notes = (velocity > 0) & ~self.played[env, :, key]
        nearest = np.where(open_notes, abs(late), np.inf).argmin(axis=1)
        plays = open_notes.any(axis=1)
        self.played[env[plays], nearest[plays], key[plays]] = True
        self.played[moving, :-1] = self.played[moving, 1:]  # the next step is the one taken next
        self.played[moving, -1] = False

        # A key that was silent before the step and fell silent in it before its last onset.
        twice = ~sounded[env, key] & (state.key_offset[env, key] < onset)
        of = np.flatnonzero(plays & ~twice)
        here = env[of], key[of]
        errors = OnsetErrors(*np.full((2, *sounded.shape), np.nan))
        errors.time[here] = late[of, nearest[of]]
        loudness = self._keyboard.velocity(state.key_speed[here])
        errors.velocity[here] = loudness - velocity[of, nearest[of]]
        return errors
