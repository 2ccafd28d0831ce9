"""What a hand is, to all that builds, simulates, fingers and plans with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco

from cadenza.fingers import Side
from cadenza.hands.body import Body, Options, add_fingertip_site
from cadenza.hands.check import check
from cadenza.hands.forearm import SERVOS as FOREARM_SERVOS
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo


@dataclass(frozen=True)
class Finger:
    """A chain of links from the palm to the tip that presses keys."""

    name: str
    links: tuple[str, ...]
    """The rigid links, the nearest to the palm first; as many for every finger of a hand. From the
    origin of each to that of the next, and from the last to the tip, runs a capsule."""
    radii: tuple[float, ...]
    """Of these capsules [m]; the last is that of the tip."""
    tip: tuple[float, float, float]
    """The centre of the end that presses, in the frame of the last link [m]."""
    on_white: float
    """Where it presses white keys: towards the player from their middle [m]."""

    @property
    def tip_radius(self) -> float:
        """[m]"""
        return self.radii[-1]


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand on a forearm. All figures are the right hand's; the left one is its mirror image."""

    name: str
    body: Body
    """What is built into the scene."""
    fingers: tuple[Finger, ...]
    """The thumb first, then its neighbours in their order; up to five."""
    servos: Mapping[str, Servo]
    """How planners use the hand's own servos, by the names that `Body.actuators` gives them."""
    reach: Reach
    thumb_meets: int = 2
    """How many of the fingers next to the thumb it can run into."""
    start: Mapping[str, float] = field(default_factory=dict)
    """Where joints are when an episode begins [rad]; 0 where nothing is said."""

    def __post_init__(self) -> None:
        """Raises: CadenzaError: its parts do not go together."""
        check(self)

    @property
    def palm_links(self) -> tuple[str, ...]:
        """What hides keys from above."""
        return tuple(link.name for link in self.body.links if link.hides_keys)

    def add_to(self, spec: mujoco.MjSpec, side: Side, options: Options) -> tuple[str, ...]:
        """Adds the hand of one side to a scene; returns the names of its fingertips' sites."""
        self.body.add_to(spec, side, options)
        return tuple(
            add_fingertip_site(spec, side, finger.name, finger.links[-1], finger.tip)
            for finger in self.fingers
        )

    def servo(self, name: str) -> Servo:
        """Of the hand or of its forearm, such as "FFJ3" or "forearm_tx"."""
        return self.servos[name] if name in self.servos else FOREARM_SERVOS[name]
