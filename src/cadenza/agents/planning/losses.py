"""What each step of a hand's playing loses: of F1, of note onsets, and what is not yet lost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planning.refinement import HandPart
from cadenza.agents.planning.song_plan import SongPlan
from cadenza.sim.protocol import State
from cadenza.tasks import reward

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ONSETS = 0.5  # what all note onsets together are worth, where F1 is worth 1
_UNSTABLE = 1000.0
_DEPTH = 0.06  # of a key's travel that lacks to the stop, or is too much, squared
_NO_HARM = 0.3  # of its travel that a key may be down
_ASTRAY = 0.02  # of what fingertips astray cost in the search
_FURTHEST = 0.03  # [m] further away does not count more


class Losses:
    """Judges states of a hand, all alone, after each step of a song.

    A step loses 1 - F1 as if the other hand played all its keys. A note loses more if its key does
    not begin to sound on its first step or the next, as `cadenza.music.metrics` counts onsets, and
    half as much is lost if one begins to sound at any other time.
    """

    def __init__(self, plan: SongPlan, part: HandPart) -> None:
        """Args:
        plan: of the whole song.
        part: of the hand.
        """
        keys = plan.goals.keys
        self._part, self._keyboard = part, plan.scene.keyboard
        self._keys, self._wanted = keys, keys.sum(axis=1)
        first = part.mine & ~_late(part.mine, 1)
        # A key that is struck again is wanted a step after its note begins.
        again = first & _late(keys, 2)
        self._now, self._now_or_before = again, _late(first & ~again, 1)
        self._welcome = first | _late(first, 1)
        notes = int((keys & ~_late(keys, 1)).sum())
        self._onset = ONSETS * len(keys) / max(notes, 1)

    def __call__(
        self, state: State, row: int, before: Mask, begun: Mask
    ) -> tuple[Array, Array, Mask, Mask]:
        """What states (N, ...) after step `row` lose.

        Args:
            state: of the hand.
            row: of the song.
            before: (N, K) keys that sounded a step before.
            begun: (N, K) those of them that had just begun to.

        Returns:
            (N,) the loss; (N,) the cost, which is the
            loss and a little for what is nearly lost; (N, K) the keys that sound, and those of them
            that have just begun to.
        """
        sounding = reward.key_activation(state.key_qpos, self._keyboard.sounds_from)
        begins = sounding & ~before
        missing = (self._part.mine[row] & ~sounding).sum(axis=1)
        wrong = (sounding & ~self._keys[row]).sum(axis=1)
        loss = (missing + wrong) / np.maximum(2 * self._wanted[row] - missing + wrong, 1)
        late = (self._now[row] & ~begins) | (self._now_or_before[row] & ~(begins | begun))
        extra = begins & ~self._welcome[row]
        loss = loss + self._onset * (late.sum(axis=1) + 0.5 * extra.sum(axis=1))
        loss = np.where(state.unstable, _UNSTABLE, loss)
        return loss, loss + self._nearly(state, row), sounding, begins

    def _nearly(self, state: State, row: int) -> Array:
        """(N,) what is nearly lost: how far keys and fingertips are from where they should be."""
        part = self._part
        depth = reward.key_state(state.key_qpos, self._keyboard.travel)
        lacking = part.mine[row] * (1.0 - depth)
        too_far = ~self._keys[row] * np.maximum(depth - _NO_HARM, 0.0)
        offset = state.fingertip_xpos[:, part.fingers] - part.fingertips[row + 1]
        astray = np.minimum((offset**2).sum(axis=2), _FURTHEST**2) @ part.weight[row + 1]
        return np.asarray(_DEPTH * (lacking**2 + too_far**2).sum(axis=1) + _ASTRAY * astray)


def _late(keys: Mask, steps: int) -> Mask:
    """(T, K) `steps` later."""
    return np.pad(keys, ((steps, 0), (0, 0)))[: len(keys)]
