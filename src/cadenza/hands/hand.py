"""A hand as a value, its checks, and its part of the scene."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise

import mujoco
import numpy as np

from cadenza.configs import Positive, wrong_types
from cadenza.errors import CadenzaError, quoted
from cadenza.fingers import Side
from cadenza.hands import forearm
from cadenza.hands.body import Body, BodyBuilder, HandOptions, mirror_image, mirrored, prefix
from cadenza.hands.reach import JumpTimes, Reach
from cadenza.hands.servo import Servo

MAX_FINGERS = 8
"""The largest number of fingers of a hand, as the search for fingers enumerates their subsets."""

_SITE_GROUP = 4  # hidden by MuJoCo's viewers
_SITE_RADIUS = 0.004  # [m] of a fingertip without touch
_TOUCH_RADIUS = 1.1  # radius within which contacts count, in radii of the tip


@dataclass(frozen=True)
class FingerChain:
    """A chain of links from the palm to the tip that presses keys."""

    name: str
    links: tuple[str, ...]
    """The rigid links, the nearest to the palm first, the same number for every finger. A capsule
    runs from the origin of each to the next, and from the last to the tip."""
    radii: tuple[Positive, ...]
    """The radii of these capsules [m]; the last is the tip's."""
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
    """A hand on a forearm or an arm. All figures are the right hand's, but those of `left`."""

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
    """Positions of joints when an episode begins [m, rad]; 0 for all others."""
    kept_apart: tuple[str, ...] = (forearm.FOREARM,)
    """The links that the reward for forearms keeps from those of the other hand."""
    left: "Hand | None" = None
    """The left hand, with the names of the right one; None if it is its mirror image."""

    def __post_init__(self) -> None:
        """Check that the parts go together; raises CadenzaError if they do not."""
        for fault in _faults(self):
            raise CadenzaError(f"hand {self.name}: {fault}")

    @property
    def palm_links(self) -> tuple[str, ...]:
        """The links that hide keys from above."""
        return tuple(link.name for link in self.body.links if link.hides_keys)

    def add_to(self, spec: mujoco.MjSpec, side: Side, options: HandOptions) -> tuple[str, ...]:
        """Add the hand of one side to a scene; return the names of its fingertips' sites."""
        hand = self if side == "right" else self.left or self._mirror_image()
        BodyBuilder(hand.body, spec, side, options).build()
        return tuple(_add_fingertip(spec, side, each, options.touch) for each in hand.fingers)

    def _mirror_image(self) -> "Hand":
        fingers = tuple(replace(each, tip=mirrored(each.tip)) for each in self.fingers)
        return replace(self, body=mirror_image(self.body), fingers=fingers)

    def servo(self, name: str) -> Servo:
        """The servo of the hand or of its forearm with a name such as "FFJ3" or "forearm_tx"."""
        return self.servos[name] if name in self.servos else forearm.SERVOS[name]


def _add_fingertip(spec: mujoco.MjSpec, side: Side, finger: FingerChain, touch: bool) -> str:
    """Add the site where a finger presses, with `touch` a sensor; return the site's name.

    The sensor measures the normal force [N] of contacts of the last link in the sphere of the site,
    which is a little larger than the tip.
    """
    name = f"{prefix(side)}{finger.name}tip"
    spec.body(prefix(side) + finger.links[-1]).add_site(
        name=name,
        pos=finger.tip,
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
    """Yield a line for each fault of a hand that MuJoCo does not refuse itself."""
    for link in hand.body.links:
        yield from (f"link {link.name}: {fault}" for fault in wrong_types(link))
        if not any(link.quat):
            yield f"link {link.name}: quat 0 0 0 0 is no rotation; leave it out to turn nothing"
    yield from wrong_types(hand.body)
    yield from _faults_of_body(hand.body)
    count = len(hand.fingers)
    if not 0 < count <= MAX_FINGERS:
        yield f"has {count} fingers; give 1 to {MAX_FINGERS}"
    parents = {link.name: link.parent for link in hand.body.links}
    for finger in hand.fingers:
        yield from _faults_of_finger(finger, hand.fingers[0], parents)
    for name, value in vars(hand.reach).items():
        shape = (count, count) if name in ("least", "most") else (count,)
        if np.ndim(value) and (not isinstance(value, np.ndarray) or value.shape != shape):
            yield f"reach.{name}: give an array of NumPy of shape {shape}"
    yield from _unknown("kept_apart", "link", hand.kept_apart, parents)
    yield from _faults_of_servos(hand)
    yield from _faults_of_start(hand)


def _faults_of_servos(hand: Hand) -> Iterator[str]:
    ranges = {link.joint.name: link.joint.range for link in hand.body.links if link.joint}
    ranges |= {coupling.name: coupling.control_range for coupling in hand.body.couplings}
    targets = {actuator.target: ranges[actuator.target] for actuator in hand.body.actuators}
    for target in targets:
        if target not in hand.servos:
            yield f"servos has none for the actuator of {quoted(target)}; add a Servo"
    yield from _unknown("servos", "actuator of", hand.servos, targets)
    for name, servo in hand.servos.items():
        if servo.finger is not None and not 0 <= servo.finger < len(hand.fingers):
            last = len(hand.fingers) - 1
            yield f"servo {name}: finger is {servo.finger}; give 0 to {last}, or None"
        if not _within(servo.rest, targets[name]):
            yield f"servo {name}: rest is {servo.rest}, outside its range {targets[name]}"


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
    yield from (f"finger {finger.name}: {fault}" for fault in wrong_types(finger))
    yield from _unknown(f"finger {finger.name}", "link", finger.links, parents)
    if len(finger.links) != len(thumb.links) or not finger.links:
        yield (
            f"finger {finger.name} has {len(finger.links)} links and {thumb.name} "
            f"{len(thumb.links)}; give as many for every finger"
        )
    for link, next_link in pairwise(finger.links):
        if link not in _ancestors(next_link, parents):
            yield (
                f"finger {finger.name}: link {next_link} does not hang from {link}; "
                "name the link nearest to the palm first"
            )
    if len(finger.radii) != len(finger.links):
        yield f"finger {finger.name}: give a radius for each of its {len(finger.links)} links"


def _ancestors(link: str, parents: Mapping[str, str]) -> Iterator[str]:
    while link := parents[link]:
        yield link


def _faults_of_body(body: Body) -> Iterator[str]:
    links = [link.name for link in body.links]
    if not links or body.links[0].parent or (body.mount is None and links[0] != forearm.FOREARM):
        yield f"the first link must be {forearm.FOREARM!r}, and have no parent"
    if forearm.FOREARM not in links:
        yield f"the link of the arm that carries the hand must be named {forearm.FOREARM!r}"
    for place, link in enumerate(body.links):
        if place and link.parent not in links[:place]:
            yield f"link {link.name}: no link before it is named {quoted(link.parent)}, its parent"
    joints = [link.joint.name for link in body.links if link.joint]
    targets = [actuator.target for actuator in body.actuators]
    coupled = [joint for each in body.couplings if each.name in targets for joint in each.joints]
    moved = [*(target for target in targets if target in joints), *coupled]
    if repeated := [name for name, count in Counter(moved).items() if count > 1]:
        yield f"joint {repeated[0]} is moved by two actuators; keep one"
    for coupling in body.couplings:
        yield from _unknown(f"coupling {coupling.name}", "joint", coupling.joints, joints)
    followers = {each.joint: each.leader for each in body.followers}
    yield from _unknown("followers", "joint", (*followers, *followers.values()), joints)
    for joint, leader in followers.items():
        if joint in moved or leader not in moved:
            yield f"joint {joint} follows {leader}: {leader} needs an actuator, {joint} has none"
    valid_names = {*joints, *(coupling.name for coupling in body.couplings)}
    yield from _unknown("actuators", "joint or coupling", targets, valid_names)
    yield from _unknown("excluded", "link", chain.from_iterable(body.excluded), links)
    yield from _unknown("locked", "joint", body.locked, joints)
    yield from _unknown("reduced_ranges", "joint", body.reduced_ranges, joints)


def _unknown(of: str, kind: str, names: Iterable[str], valid: Collection[str]) -> Iterator[str]:
    if missing := sorted(set(names).difference(valid)):
        yield f"{of}: there is no {kind} {quoted(missing[0])}"
