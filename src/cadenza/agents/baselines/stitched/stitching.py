"""Stitches motions of one hand together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.agents.baselines.stitched.motions import Change, Held, Motions
from cadenza.agents.planner.plan.presses import Press

_Down = set[tuple[int, int]]
"""Pairs of finger and key, of each finger that is down."""


def stitched(presses: Sequence[Press], motions: Motions, start: Array, num_states: int) -> Array:
    """(S, A) postures of a hand that begins at `start` (A,), with these presses.

    Between two changes, the end of one motion is blended with the beginning of the next.
    """
    postures = np.empty((num_states, len(start)))
    ending, since = start[None], 0
    for leaves, change in changes_of(presses, num_states, motions.longest_gap):
        motion = motions.of(change)
        states = np.arange(since, leaves)
        blended = max(leaves - motions.before, min(since + motions.after, leaves - 1))
        share = np.minimum((states - since) / max(blended - since, 1), 1.0)[:, None]
        coming = motion[np.maximum(states - leaves + motions.before, 0)]
        postures[states] = (1 - share) * _row(ending, states - since) + share * coming
        since = leaves + change.gap
        postures[leaves:since] = motion[motions.before :][: change.gap]
        ending = motion[motions.before + change.gap :]
    postures[since:] = _row(ending, np.arange(num_states - since))
    return postures


def _row(motion: Array, states: NDArray[np.intp]) -> Array:
    """Postures of a motion in `states`; after its end, the last one."""
    return motion[np.minimum(states, len(motion) - 1)]


def changes_of(
    presses: Sequence[Press], num_states: int, longest_gap: int
) -> Iterator[tuple[int, Change]]:
    """The changes of what one hand holds, and the states in which they begin, by time.

    Releasing, and striking at most `longest_gap` states later, are one change.
    """
    held = list(_held(presses, num_states))
    before: Held = ()
    while held:
        state, then = held.pop(0)
        later, after = state, then
        if set(then) < set(before) and held and held[0][0] - state <= longest_gap:
            later, after = held.pop(0)
        kept = tuple(one for one in before if one in then)
        yield state, Change(before, kept, after, later - state)
        before = after


def _held(presses: Sequence[Press], num_states: int) -> Iterator[tuple[int, Held]]:
    """Each state in which one hand begins to hold other keys, by time, and these keys."""
    struck, left = defaultdict[int, _Down](set), defaultdict[int, _Down](set)
    for press in presses:
        if press.first < press.last:
            struck[press.first].add((press.finger, press.key))
            left[press.last].add((press.finger, press.key))
    down: _Down = set()
    before: Held = ()
    for state in sorted(struck.keys() | left.keys()):
        down = (down - left[state]) | struck[state]
        held = tuple(sorted(down))
        if held != before and state < num_states:
            yield state, held
        before = held
