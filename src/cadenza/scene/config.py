"""The options of the scene. Imports nothing heavy: the command line shows them."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cadenza.configs import in_short
from cadenza.errors import CadenzaError
from cadenza.registry import module_of

ForearmDof = Literal["tx", "ty", "tz", "roll", "pitch", "yaw"]
Hands = Literal["both", "apart", "right", "left", "none"]
Physics = Literal["published", "fast"]
Engine = Literal["c", "warp"]


@dataclass(frozen=True)
class SceneConfig:
    """The scene: the piano, the hands and the physics."""

    keyboard: str = "piano"
    """The keyboard: piano, mini, one of an installed package, or module:NAME."""
    hand: str = "shadow"
    """Kind of hand: shadow, allegro, another that `cadenza info` lists, or module:NAME."""
    hands: Hands = "both"
    """The hands that play; apart: a scene each; none: no hands at all."""
    reduced_action_space: bool = True
    """Lock the joints that the hand names as such (Shadow, as in the paper: thumb 5 and 1, little
    finger 5)."""
    forearm_dofs: tuple[ForearmDof, ...] = ("tx", "ty")
    """Degrees of freedom of the forearms: slides along (tx), towards (ty) and above (tz) the keys,
    and rotations."""
    hand_spacing: float = 0.3
    """Distance between the forearms' mounts along the keyboard [m]."""
    attachment_yaw: float = 0.0
    """Yaw of both hands at their mounts, positive with thumbs inwards [degree]."""
    gravity_compensation: bool = True
    """Compensate gravity on the hands, as in the paper."""
    primitive_fingertips: bool = True
    """Use capsules as collision geometry of the fingertips. Otherwise ellipsoids of the size of
    their shells."""
    hand_collisions: bool = True
    """Enable collisions between the hands, and between fingers of one hand."""
    touch: bool = False
    """Have touch sensors on the fingertips, and observe their normal forces."""
    sleeping_keys: bool = True
    """Skip the simulation of keys at rest, which is faster and moves the others by 1e-4 rad or so.
    Without it, recordings of the published system replay bit for bit unless the forearms touch."""
    physics: Physics = "published"
    """The published dynamics, or faster ones for training: twice the physics timestep, no dry
    friction in joints. See docs/speed.md for the difference."""
    engine: Engine = "c"
    """The simulator: MuJoCo in C on threads, or MuJoCo Warp on a GPU, see docs/gpu.md. Planners
    always plan in C."""

    __repr__ = in_short


def named_by_module(config: SceneConfig) -> dict[str, str]:
    """Option -> name, for the hand and the keyboard if they are given as `module:NAME`."""
    names = {option: getattr(config, option) for option in ("hand", "keyboard")}
    return {option: name for option, name in names.items() if module_of(name) is not None}


def check_modules(config: SceneConfig, where: Path) -> None:
    """Check that a configuration read from a file imports no module, which may run anything.

    Raises CadenzaError if `where` names a `module:NAME` that is not imported.
    """
    for option, name in named_by_module(config).items():
        if (module := module_of(name)) not in sys.modules:
            raise CadenzaError(
                f"{where}: has the {option} {name}, and no file makes Cadenza import a module; "
                f"give --{option} {name} if you trust it, or import {module} first"
            )
