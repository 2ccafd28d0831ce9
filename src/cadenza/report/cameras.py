"""The cameras of pages and films."""

VIEWS = {
    "player": (0.5, 0.0, 0.87),
    "close": (0.45, 0.0, 0.9),
    "top": (0.005, 0.0, 1.0),
    "audience": (-0.8, 0.0, 0.62),
    "side": (-0.5, -0.8, 0.5),
}
"""Name of each -> the direction that it looks from, of any length (x towards the player, y to the
player's right, z up). It comes as near as keeps what it looks at in the picture."""
