"""What a hand is, to all that builds, simulates, fingers and plans with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import mujoco
import numpy as np

from cadenza.errors import CadenzaError
from cadenza.fingers import Side
from cadenza.hands import forearm
from cadenza.hands.body import Body, Options, add_fingertip_site, add_touch_sensor
from cadenza.hands.faults import faults_of_body, repeated, wrong_numbers
from cadenza.hands.jump import JumpTimes
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
    jump_times: JumpTimes = field(default_factory=JumpTimes)
    thumb_meets: int = 2
    """How many of the fingers next to the thumb it can run into."""
    start: Mapping[str, float] = field(default_factory=dict)
    """Where joints are when an episode begins [rad]; 0 where nothing is said."""
    kept_apart: tuple[str, ...] = (forearm.FOREARM,)
    """The links that the reward for forearms wants to keep from those of the other hand."""

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
        sites = tuple(
            add_fingertip_site(spec, side, finger.name, finger.links[-1], finger.tip)
            for finger in self.fingers
        )
        if options.touch:
            for site, finger in zip(sites, self.fingers, strict=True):
                add_touch_sensor(spec, site, finger.tip_radius)
        return sites

    def servo(self, name: str) -> Servo:
        """Of the hand or of its forearm, such as "FFJ3" or "forearm_tx"."""
        return self.servos[name] if name in self.servos else forearm.SERVOS[name]


def _faults(hand: Hand) -> Iterator[str]:
    yield from faults_of_body(hand.body)
    count = len(hand.fingers)
    if not 0 < count <= MOST_FINGERS:
        yield f"has {count} fingers; give 1 to {MOST_FINGERS}"
    for name in repeated(finger.name for finger in hand.fingers):
        yield f"two fingers are named {name!r}; give each a name of its own"
    parents = {link.name: link.parent for link in hand.body.links}
    for finger in hand.fingers:
        yield from _faults_of_finger(finger, hand.fingers[0], parents)
    for name, given in vars(hand.reach).items():
        if isinstance(given, list | tuple):
            yield f"reach.{name} is a {type(given).__name__}; give an array of NumPy"
        shape = {"least": (count, count), "most": (count, count)}.get(name, (count,))
        if isinstance(given, np.ndarray) and given.shape != shape:
            yield f"reach.{name} has shape {given.shape}; give {shape}"
    if strange := [name for name in hand.kept_apart if name not in parents]:
        yield f"kept_apart: there is no link {strange[0]!r}"
    yield from _faults_of_servos(hand)
    yield from _faults_of_start(hand)


def _faults_of_servos(hand: Hand) -> Iterator[str]:
    ranges = {link.joint.name: link.joint.range for link in hand.body.links if link.joint}
    ranges |= {coupling.name: coupling.control_range for coupling in hand.body.couplings}
    targets = [actuator.target for actuator in hand.body.actuators]
    for target in targets:
        if target not in hand.servos:
            yield f"servos has none for the actuator of {target!r}; add a Servo"
    for name, servo in hand.servos.items():
        if name not in targets:
            yield f"servos: no actuator moves {name!r}; choose from {', '.join(targets)}"
            continue
        if servo.finger is not None and not 0 <= servo.finger < len(hand.fingers):
            last = len(hand.fingers) - 1
            yield f"servo {name}: finger is {servo.finger}; give 0 to {last}, or None"
        if not _within(servo.rest, ranges[name]):
            yield f"servo {name}: rest is {servo.rest}, outside its range {ranges[name]}"


def _faults_of_start(hand: Hand) -> Iterator[str]:
    ranges = {link.joint.name: link.joint.range for link in hand.body.links if link.joint}
    for name, position in hand.start.items():
        if name not in ranges:
            yield f"start: there is no joint {name!r}"
        elif not _within(position, ranges[name]):
            yield f"start: joint {name} begins at {position}, outside its range {ranges[name]}"
    for name, limits in ranges.items():
        if name not in hand.start and not _within(0.0, limits):
            yield f"joint {name}: its range {limits} is without 0; say in start where it begins"


def _within(position: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= position <= limits[1]


def _faults_of_finger(
    finger: FingerChain, thumb: FingerChain, parents: Mapping[str, str]
) -> Iterator[str]:
    if unknown := [link for link in finger.links if link not in parents]:
        yield f"finger {finger.name}: there is no link {unknown[0]!r}"
    if len(finger.links) != len(thumb.links) or not finger.links:
        yield (
            f"finger {finger.name} has {len(finger.links)} links and {thumb.name} "
            f"{len(thumb.links)}; give as many for every finger"
        )
    for before, after in pairwise(finger.links):
        if before not in _ancestors(after, parents):
            yield (
                f"finger {finger.name}: link {after} does not hang from {before}; "
                "name the link nearest to the palm first"
            )
    if len(finger.radii) != len(finger.links):
        yield f"finger {finger.name}: give a radius for each of its {len(finger.links)} links"
    yield from wrong_numbers(f"finger {finger.name}: tip", finger.tip, 3)


def _ancestors(link: str, parents: Mapping[str, str]) -> Iterator[str]:
    while link := parents[link]:
        yield link
