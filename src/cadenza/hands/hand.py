"""A hand as a value, its checks, and its part of the scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf
from typing import Any

import mujoco
import numpy as np

from cadenza.errors import CadenzaError, quoted
from cadenza.fingers import Side
from cadenza.hands import forearm
from cadenza.hands.body import (
    GEOM_TYPES,
    Body,
    BodyBuilder,
    Geom,
    HandOptions,
    Link,
    mirrored,
    prefix,
)
from cadenza.hands.reach import JumpTimes, Reach
from cadenza.hands.servo import Servo

MAX_FINGERS = 8
"""The largest number of fingers of a hand, as the search for fingers enumerates their subsets."""

_SITE_GROUP = 4  # hidden by MuJoCo's viewers
_SITE_RADIUS = 0.004  # [m] of a fingertip without touch
_TOUCH_RADIUS = 1.1  # of the sphere in which contacts count, in radii of the tip

# Field of a link -> how many numbers it has.
_LINK_NUMBERS = {"pos": 3, "com": 3, "inertia": 3, "quat": 4, "inertia_quat": 4}


@dataclass(frozen=True)
class FingerChain:
    """A chain of links from the palm to the tip that presses keys."""

    name: str
    links: tuple[str, ...]
    """The rigid links, the nearest to the palm first; as many for every finger of a hand. From the
    origin of each to that of the next, and from the last to the tip, runs a capsule."""
    radii: tuple[float, ...]
    """The radii of these capsules [m]; the last is that of the tip."""
    tip: tuple[float, float, float]
    """The centre of the end that presses, in the frame of the last link [m]."""
    on_white: float
    """Distance from the middle of white keys, towards the player, at which it presses [m]."""

    @property
    def tip_radius(self) -> float:
        """The radius of the tip [m]."""
        return self.radii[-1]


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand on a forearm. All figures are the right hand's; the left one is its mirror image."""

    name: str
    body: Body
    """The links, joints and actuators in the scene."""
    fingers: tuple[FingerChain, ...]
    """The thumb first, then its neighbours in their order; up to `MAX_FINGERS`."""
    servos: Mapping[str, Servo]
    """The hand's own servos as planners use them, by the names in `Body.actuators`."""
    reach: Reach
    jump_times: JumpTimes = field(default_factory=JumpTimes)
    thumb_meets: int = 2
    """Number of fingers next to the thumb that it can run into."""
    start: Mapping[str, float] = field(default_factory=dict)
    """Positions of joints when an episode begins [m, rad]; 0 for those that are left out."""
    kept_apart: tuple[str, ...] = (forearm.FOREARM,)
    """The links that the reward for forearms wants to keep from those of the other hand."""

    def __post_init__(self) -> None:
        """Checks that the parts go together.

        Raises:
            CadenzaError: they do not.
        """
        for fault in _faults(self):
            raise CadenzaError(f"hand {self.name}: {fault}")

    @property
    def palm_links(self) -> tuple[str, ...]:
        """The links that hide keys from above."""
        return tuple(link.name for link in self.body.links if link.hides_keys)

    def add_to(self, spec: mujoco.MjSpec, side: Side, options: HandOptions) -> tuple[str, ...]:
        """Adds the hand of one side to a scene; returns the names of its fingertips' sites."""
        BodyBuilder(self.body, spec, side, options).build()
        return tuple(_add_fingertip(spec, side, each, options.touch) for each in self.fingers)

    def servo(self, name: str) -> Servo:
        """The servo of the hand or of its forearm with a name such as "FFJ3" or "forearm_tx"."""
        return self.servos[name] if name in self.servos else forearm.SERVOS[name]


def _add_fingertip(spec: mujoco.MjSpec, side: Side, finger: FingerChain, touch: bool) -> str:
    """Adds the site where a finger presses, and a touch sensor if wanted; returns the site's name.

    The sensor measures the normal force [N] of contacts of the last link in the sphere of the site,
    which is a little larger than the tip.
    """
    name = f"{prefix(side)}{finger.name}tip"
    spec.body(prefix(side) + finger.links[-1]).add_site(
        name=name,
        pos=mirrored(finger.tip, side),
        size=np.full(3, _TOUCH_RADIUS * finger.tip_radius if touch else _SITE_RADIUS),
        group=_SITE_GROUP,
    )
    if touch:
        spec.add_sensor(
            name=f"{name}_touch",
            type=mujoco.mjtSensor.mjSENS_TOUCH,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=name,
        )
    return name


def _faults(hand: Hand) -> Iterator[str]:
    """Yields a line for each fault of a hand: what is wrong, where, and what to do."""
    yield from _faults_of_body(hand.body)
    count = len(hand.fingers)
    if not 0 < count <= MAX_FINGERS:
        yield f"has {count} fingers; give 1 to {MAX_FINGERS}"
    for name in _repeated(finger.name for finger in hand.fingers):
        yield f"two fingers are named {quoted(name)}; give each a name of its own"
    parents = {link.name: link.parent for link in hand.body.links}
    for finger in hand.fingers:
        yield from _faults_of_finger(finger, hand.fingers[0], parents)
    for name, given in vars(hand.reach).items():
        if isinstance(given, list | tuple):
            yield f"reach.{name} is a {type(given).__name__}; give an array of NumPy"
        shape = {"least": (count, count), "most": (count, count)}.get(name, (count,))
        if isinstance(given, np.ndarray) and given.shape != shape:
            yield f"reach.{name} has shape {given.shape}; give {shape}"
    yield from _unknown("kept_apart", "link", hand.kept_apart, parents)
    yield from _faults_of_servos(hand)
    yield from _faults_of_start(hand)


def _faults_of_servos(hand: Hand) -> Iterator[str]:
    ranges = {link.joint.name: link.joint.range for link in hand.body.links if link.joint}
    ranges |= {coupling.name: coupling.control_range for coupling in hand.body.couplings}
    targets = [actuator.target for actuator in hand.body.actuators]
    for target in targets:
        if target not in hand.servos:
            yield f"servos has none for the actuator of {quoted(target)}; add a Servo"
    for name, servo in hand.servos.items():
        if name not in targets:
            yield f"servos: no actuator moves {quoted(name)}; choose from {', '.join(targets)}"
            continue
        if servo.finger is not None and not 0 <= servo.finger < len(hand.fingers):
            last = len(hand.fingers) - 1
            yield f"servo {name}: finger is {servo.finger}; give 0 to {last}, or None"
        if not _within(servo.rest, ranges[name]):
            yield f"servo {name}: rest is {servo.rest}, outside its range {ranges[name]}"


def _faults_of_start(hand: Hand) -> Iterator[str]:
    ranges = {link.joint.name: link.joint.range for link in hand.body.links if link.joint}
    yield from _unknown("start", "joint", hand.start, ranges)
    for name, position in hand.start.items():
        if not _within(position, ranges[name]):
            yield f"start: joint {name} begins at {position}, outside its range {ranges[name]}"
    for name, limits in ranges.items():
        if name not in hand.start and not _within(0.0, limits):
            yield f"joint {name}: its range {limits} is without 0; say in start where it begins"


def _within(position: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= position <= limits[1]


def _faults_of_finger(
    finger: FingerChain, thumb: FingerChain, parents: Mapping[str, str]
) -> Iterator[str]:
    yield from _unknown(f"finger {finger.name}", "link", finger.links, parents)
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
    yield from _wrong_numbers(f"finger {finger.name}: tip", finger.tip, 3)


def _ancestors(link: str, parents: Mapping[str, str]) -> Iterator[str]:
    while link := parents[link]:
        yield link


def _faults_of_body(body: Body) -> Iterator[str]:
    if not body.links:
        yield "has no links; begin with the forearm"
        return
    links = [link.name for link in body.links]
    if (body.mount is None and links[:1] != [forearm.FOREARM]) or body.links[0].parent:
        yield f"the first link must be {forearm.FOREARM!r}, and have no parent"
    if forearm.FOREARM not in links:
        yield f"the link of the arm that carries the hand must be named {forearm.FOREARM!r}"
    for name in _repeated(links):
        yield f"two links are named {quoted(name)}; give each a name of its own"
    for place, link in enumerate(body.links):
        if place and link.parent not in links[:place]:
            yield f"link {link.name}: no link before it is named {quoted(link.parent)}, its parent"
        yield from _faults_of_link(link)
    joints = [link.joint.name for link in body.links if link.joint]
    couplings = [coupling.name for coupling in body.couplings]
    targets = [actuator.target for actuator in body.actuators]
    for name in _repeated([*joints, *couplings]):
        yield f"two joints or couplings are named {quoted(name)}; give each a name of its own"
    for name in _repeated(targets):
        yield f"two actuators move {quoted(name)}; keep one"
    moved = [target for target in targets if target in joints]
    moved += [joint for each in body.couplings if each.name in targets for joint in each.joints]
    for name in _repeated(moved):
        yield f"joint {name} is moved by two actuators; keep one"
    for coupling in body.couplings:
        yield from _unknown(f"coupling {coupling.name}", "joint", coupling.joints, joints)
        yield from _wrong_range(f"coupling {coupling.name}", coupling.control_range)
    yield from _faults_of_actuators(body, {*joints, *couplings})
    for pair in body.excluded:
        yield from _unknown("excluded", "link", pair, links)
    yield from _unknown("locked", "joint", body.locked, joints)
    yield from _unknown("reduced_ranges", "joint", body.reduced_ranges, joints)
    for name, limits in body.reduced_ranges.items():
        yield from _wrong_range(f"reduced_ranges: joint {name}", limits)


def _wrong_range(of: str, limits: Any) -> Iterator[str]:
    """Says so if `limits` are anything but a smaller and a larger number."""
    if not _are_numbers(limits, 2) or limits[0] >= limits[1]:
        yield f"{of} has the range {limits}; give two numbers, the smaller one first"


def _faults_of_link(link: Link) -> Iterator[str]:
    for name, count in _LINK_NUMBERS.items():
        yield from _wrong_numbers(f"link {link.name}: {name}", getattr(link, name), count)
    if not 0 <= link.mass < inf:
        yield f"link {link.name}: its mass is {link.mass}; give 0 or more"
    if joint := link.joint:
        yield from _wrong_numbers(f"joint {joint.name}: axis", joint.axis, 3)
        yield from _wrong_range(f"joint {joint.name}", joint.range)
    for geom in (*link.geoms, *link.round_geoms):
        yield from _faults_of_geom(f"link {link.name}", geom)
    for ball in (ball for shell in link.drawn for ball in shell.balls):
        yield from _wrong_numbers(f"link {link.name}: ball of what is drawn", ball, 4)


def _faults_of_geom(of: str, geom: Geom) -> Iterator[str]:
    if geom.type not in GEOM_TYPES:
        yield f"{of}: no geom of type {quoted(geom.type)}; choose from {', '.join(GEOM_TYPES)}"
        return
    _, count = GEOM_TYPES[geom.type]
    for size in (geom.size, geom.left_size):
        if size is not None and (not _are_numbers(size, count) or min(size) <= 0):
            numbers = "number" if count == 1 else "numbers"
            yield f"{of}: the size of its {geom.type} is {size}; give {count} positive {numbers}"
    yield from _wrong_numbers(f"{of}: pos of its {geom.type}", geom.pos, 3)
    yield from _wrong_numbers(f"{of}: quat of its {geom.type}", geom.quat, 4)
    if geom.left_quat is not None:
        yield from _wrong_numbers(f"{of}: left_quat of its {geom.type}", geom.left_quat, 4)


def _faults_of_actuators(body: Body, targets: set[str]) -> Iterator[str]:
    for actuator in body.actuators:
        if actuator.target not in targets:
            yield f"there is no joint or coupling {quoted(actuator.target)} for an actuator to move"
        for name in ("kp", "force"):
            if not (given := getattr(actuator, name)) > 0:
                yield f"actuator of {actuator.target}: {name} is {given}; give more than 0"


def _wrong_numbers(of: str, numbers: Any, count: int) -> Iterator[str]:
    if not _are_numbers(numbers, count):
        yield f"{of} is {numbers}; give {count} finite numbers"
    elif count == 4 and not np.any(numbers):
        yield f"{of} is {numbers}; give a quaternion (w, x, y, z), (1, 0, 0, 0) for no rotation"


def _are_numbers(numbers: Any, count: int) -> bool:
    return np.shape(numbers) == (count,) and bool(np.isfinite(numbers).all())


def _unknown(of: str, kind: str, names: Iterable[str], known: Collection[str]) -> Iterator[str]:
    if missing := sorted(set(names).difference(known)):
        yield f"{of}: there is no {kind} {quoted(missing[0])}"


def _repeated(names: Iterable[str]) -> Iterator[str]:
    return (name for name, count in Counter(names).items() if count > 1)
