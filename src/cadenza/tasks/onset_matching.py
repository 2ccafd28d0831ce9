"""Match onsets of keys with the notes that are due, step by step.

The arrays are NumPy's or those of a library like it, which can compile this.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.keyboards.keyboard import Keyboard
from cadenza.sim.protocol import State
from cadenza.tasks.goal_track import UpcomingOnsets

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = (-1, 0, 1)  # the steps in which a note may be due: the last step, the one taken, the next


class OnsetErrors(NamedTuple):
    """Errors of the onsets of keys in a step, compared with the notes that they play.

    They are NaN for keys that play no note then, and for keys that sounded twice in the step.
    """

    time: Array
    """(N, K) how much later than its note the key began to sound [s]."""
    velocity: Array
    """(N, K) how much louder than its note the key sounds, in MIDI velocity."""


def no_notes_played(num_envs: int, num_keys: int) -> Mask:
    """(N, 3, K) which notes have been played when an episode begins: none."""
    return np.zeros((num_envs, len(STEPS), num_keys), bool)


def matched_onsets(
    due: UpcomingOnsets,
    played: Mask,
    state: State,
    sounded: Mask,
    keyboard: Keyboard,
    control_timestep: float,
) -> tuple[OnsetErrors, Mask]:
    """Match the onsets of a step that N environments have taken with the notes that they play.

    A note may be played in the step in which it is due, in the one before and in the one after, as
    a note that is due at the beginning of a step may well come a millisecond early. An onset plays
    the nearest note of its key that has not been played. So each note is played once, by the first
    onset near it: to strike a key again earns nothing. Returns the errors, and (N, 3, K) which
    notes have been played before the next step.

    Args:
        due: the notes as they were upcoming before the step.
        played: (N, 3, K) which of the notes in `STEPS` were played before it.
        state: the state after it.
        sounded: (N, K) the keys that sounded before it.
        keyboard: the keys, which say how loud they are.
        control_timestep: time of a control step [s].
    """
    xp, onset = played.__array_namespace__(), state.key_onset[:, None]
    steps = xp.asarray(STEPS)[:, None]
    late = onset - (due.time[:, : len(STEPS)] + steps * control_timestep)
    velocity = due.velocity[:, : len(STEPS)]
    unplayed = (velocity > 0) & ~played & ~xp.isnan(onset)
    nearest = xp.argmin(xp.where(unplayed, abs(late), xp.inf), axis=1)
    plays = unplayed & (xp.arange(len(STEPS))[:, None] == nearest[:, None])
    # The next step is the one taken next, and what is due after it has not been played.
    after = xp.concat([(played | plays)[:, 1:], xp.zeros_like(played[:, :1])], axis=1)

    # A key that was silent before the step and fell silent in it before its last onset.
    twice = ~sounded & (state.key_offset < state.key_onset)
    counts = plays.any(axis=1) & ~twice
    loudness = keyboard.velocity(xp.where(counts, state.key_speed, 0.0))
    return OnsetErrors(
        time=xp.where(counts, xp.where(plays, late, 0.0).sum(axis=1), xp.nan),
        velocity=xp.where(counts, loudness - xp.where(plays, velocity, 0).sum(axis=1), xp.nan),
    ), after
