"""What can be chosen about the scene. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Side = Literal["right", "left"]
ForearmDof = Literal["tx", "ty", "tz", "roll", "pitch", "yaw"]
Hands = Literal["both", "right", "left", "none"]
Physics = Literal["published", "fast"]


@dataclass(frozen=True)
class SceneConfig:
    """The simulated instrument and the hands over it."""

    hands: Hands = "both"
    """Which hands play; with none, actuators at the keys do."""
    reduced_action_space: bool = True
    """Leave out thumb joints 5 and 1 and little finger joint 5, as the paper does."""
    forearm_dofs: tuple[ForearmDof, ...] = ("tx", "ty")
    """How the forearms can move: slides along (tx), towards (ty) and above (tz) the keys, turns."""
    hand_spacing: float = 0.3
    """Distance along the keyboard between the two forearms where they are mounted [m]."""
    attachment_yaw: float = 0.0
    """Turn of both hands where they are mounted, thumbs inwards if positive [degree]."""
    gravity_compensation: bool = True
    """Hold the weight of the hands, as the paper does."""
    primitive_fingertips: bool = True
    """Collide fingertips as capsules; otherwise as ellipsoids with the bounds of their shells."""
    hand_collisions: bool = True
    """Let the two hands (and the fingers of one) hit each other."""
    sleeping_keys: bool = True
    """Let keys at rest cost nothing, which moves others by some micrometres; without, recordings
    of the published system replay bit for bit."""
    physics: Physics = "published"
    """Published dynamics, or faster ones for training: physics steps twice as long, joints without
    dry friction (docs/speed.md says what that changes)."""
