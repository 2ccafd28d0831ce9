"""Hands by name."""

from cadenza.hands.hand import Hand
from cadenza.hands.mjcf import TOML, from_mjcf
from cadenza.registry import Entry, Registry

HANDS = Registry(
    "hand",
    "cadenza.hands",
    {
        "shadow": Entry("cadenza.hands.shadow:SHADOW", "the Shadow Dexterous Hand"),
        "allegro": Entry("cadenza.hands.allegro:ALLEGRO", "the Allegro Hand, four fingers"),
        "allegro-narrow": Entry(
            "cadenza.hands.allegro:ALLEGRO_NARROW", "the Allegro Hand with tips half as wide"
        ),
        "arm-allegro": Entry(
            "cadenza.hands.arm_allegro:ARM_ALLEGRO", "the Allegro Hand on a seven-joint arm"
        ),
    },
    otherwise=f"module:Name or NAME{TOML}",
)


def hand_named(name: str) -> Hand:
    """The hand called `name`, or of a TOML file; raises CadenzaError if there is none, or wrong."""
    if name.endswith(TOML):
        return from_mjcf(name)
    return HANDS.load(name, Hand)
