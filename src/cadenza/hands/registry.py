"""Hands by name."""

from cadenza.errors import CadenzaError, quoted
from cadenza.hands.hand import Hand
from cadenza.hands.mjcf import HOW_TO, TOML, from_mjcf
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
_MODELS = ".xml", ".mjcf", ".urdf"  # endings


def hand_named(name: str) -> Hand:
    """The hand called `name`, or of a TOML file; raises CadenzaError if there is none, or wrong."""
    if name.endswith(TOML):
        return from_mjcf(name)
    if name.endswith(_MODELS):
        raise CadenzaError(f"hand {quoted(name)}: give a TOML that describes it; {HOW_TO}")
    return HANDS.load(name, Hand)
