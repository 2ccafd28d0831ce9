"""What a hand is, to all that builds, simulates, fingers and plans with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from cadenza.errors import CadenzaError
from cadenza.fingers import Side
from cadenza.hands import forearm
from cadenza.hands.body import Body, Options, add_fingertip_site
from cadenza.hands.reach import Reach
from cadenza.hands.servo import Servo

MOST_FINGERS = 8
"""The search for fingers goes through all sets of them."""


@dataclass(frozen=True)
class FingerChain:
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
    fingers: tuple[FingerChain, ...]
    """The thumb first, then its neighbours in their order; up to `MOST_FINGERS`."""
    servos: Mapping[str, Servo]
    """How planners use the hand's own servos, by the names that `Body.actuators` gives them."""
    reach: Reach
    thumb_meets: int = 2
    """How many of the fingers next to the thumb it can run into."""
    start: Mapping[str, float] = field(default_factory=dict)
    """Where joints are when an episode begins [rad]; 0 where nothing is said."""

    def __post_init__(self) -> None:
        """Raises: CadenzaError: its parts do not go together."""
        for fault in _faults(self):
            raise CadenzaError(f"hand {self.name}: {fault}")

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
        return self.servos[name] if name in self.servos else forearm.SERVOS[name]


def _faults(hand: Hand) -> Iterator[str]:
    yield from _faults_of_body(hand.body)
    links = {link.name for link in hand.body.links}
    count = len(hand.fingers)
    if not 0 < count <= MOST_FINGERS:
        yield f"has {count} fingers; give 1 to {MOST_FINGERS}"
    for finger in hand.fingers:
        yield from _faults_of_finger(finger, hand.fingers[0], links)
    for actuator in hand.body.actuators:
        if actuator.target not in hand.servos:
            yield f"servos has none for the actuator of {actuator.target!r}; add a Servo"
    joints = {link.joint.name for link in hand.body.links if link.joint}
    if unknown := sorted(hand.start.keys() - joints):
        yield f"start: there is no joint {unknown[0]!r}"
    for name, given in vars(hand.reach).items():
        shape = {"least": (count, count), "most": (count, count)}.get(name, (count,))
        if isinstance(given, np.ndarray) and given.shape != shape:
            yield f"reach.{name} has shape {given.shape}; give {shape}"


def _faults_of_body(body: Body) -> Iterator[str]:
    links = [link.name for link in body.links]
    if links[:1] != [forearm.FOREARM] or body.links[0].parent:
        yield f"the first link must be {forearm.FOREARM!r}, and have no parent"
    for place, link in enumerate(body.links):
        if place and link.parent not in links[:place]:
            yield f"link {link.name}: no link before it is named {link.parent!r}, its parent"
    joints = {link.joint.name for link in body.links if link.joint}
    pulled = {coupling.name: coupling.joints for coupling in body.couplings}
    for name, those in pulled.items():
        if unknown := sorted(set(those) - joints):
            yield f"coupling {name}: there is no joint {unknown[0]!r}"
    for actuator in body.actuators:
        if actuator.target not in joints | pulled.keys():
            yield f"there is no joint or coupling {actuator.target!r} for an actuator to move"


def _faults_of_finger(finger: FingerChain, thumb: FingerChain, links: set[str]) -> Iterator[str]:
    if unknown := [link for link in finger.links if link not in links]:
        yield f"finger {finger.name}: there is no link {unknown[0]!r}"
    if len(finger.links) != len(thumb.links) or not finger.links:
        yield (
            f"finger {finger.name} has {len(finger.links)} links and {thumb.name} "
            f"{len(thumb.links)}; give as many for every finger"
        )
    if len(finger.radii) != len(finger.links):
        yield f"finger {finger.name}: give a radius for each of its {len(finger.links)} links"
