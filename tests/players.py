"""Hands for whom tests find fingers."""

from collections.abc import Collection
from dataclasses import replace

from cadenza.fingering import search
from cadenza.fingering.players import Players, players_at
from cadenza.fingering.search import Dropped, Solution
from cadenza.fingers import SIDES, Side
from cadenza.hands.reach import Reach
from cadenza.hands.shadow import SHADOW
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import Score

_REACH = SHADOW.reach
FOUR_FINGERS = Reach(
    rest=_REACH.rest[:4],
    least=_REACH.least[:4, :4],
    most=_REACH.most[:4, :4],
    outward=_REACH.outward[:4],
    inward=_REACH.inward[:4],
    forearm_width=_REACH.forearm_width,
    effort=_REACH.effort[:4],
    effort_on_black=_REACH.effort_on_black[:4],
)
"""Of a Shadow Hand without its little finger."""

TWO_OCTAVES = replace(PIANO, lowest_pitch=48, num_keys=25)


def shadow_hands(
    sides: Collection[Side] = SIDES, hand_spacing: float = 0.3, slides: bool = True
) -> Players:
    """Shadow Hands at a piano."""
    return players_at(SHADOW.reach, PIANO, sides, hand_spacing, slides)


def find_fingering(
    score: Score, sides: Collection[Side] = SIDES, as_written: bool = False
) -> tuple[Score, tuple[Dropped, ...]]:
    """As in `cadenza.fingering.search`, for them."""
    return search.find_fingering(score, shadow_hands(sides), as_written=as_written)


def solve(score: Score, sides: Collection[Side] = SIDES) -> Solution:
    """The same."""
    return search.solve(score, shadow_hands(sides))
