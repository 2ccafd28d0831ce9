"""The hands that come with Cadenza, by name."""

from __future__ import annotations

from cadenza.hands.hand import Hand
from cadenza.hands.shadow.hand import SHADOW

HANDS: dict[str, Hand] = {hand.name: hand for hand in (SHADOW,)}
