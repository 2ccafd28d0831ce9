"""What can be wrong with the body of a hand, each fault in a line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from math import inf
from typing import Any

import numpy as np

from cadenza.hands import forearm
from cadenza.hands.body import Body, Geom, Joint, Link

_LINK_NUMBERS = {"pos": 3, "com": 3, "inertia": 3, "quat": 4, "inertia_quat": 4}
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}


def faults_of_body(body: Body) -> Iterator[str]:
    if not body.links:
        yield "has no links; begin with the forearm"
        return
    links = [link.name for link in body.links]
    if (body.mount is None and links[:1] != [forearm.FOREARM]) or body.links[0].parent:
        yield f"the first link must be {forearm.FOREARM!r}, and have no parent"
    if forearm.FOREARM not in links:
        yield f"the link of the arm that carries the hand must be named {forearm.FOREARM!r}"
    for name in repeated(links):
        yield f"two links are named {name!r}; give each a name of its own"
    for place, link in enumerate(body.links):
        if place and link.parent not in links[:place]:
            yield f"link {link.name}: no link before it is named {link.parent!r}, its parent"
        yield from _faults_of_link(link)
    joints = [link.joint.name for link in body.links if link.joint]
    couplings = [coupling.name for coupling in body.couplings]
    targets = [actuator.target for actuator in body.actuators]
    for name in repeated([*joints, *couplings]):
        yield f"two joints or couplings are named {name!r}; give each a name of its own"
    for name in repeated(targets):
        yield f"two actuators move {name!r}; keep one"
    moved = [target for target in targets if target in joints]
    moved += [joint for each in body.couplings if each.name in targets for joint in each.joints]
    for name in repeated(moved):
        yield f"joint {name} is moved by two actuators; keep one"
    yield from _faults_of_couplings(body, joints)
    yield from _faults_of_actuators(body, {*joints, *couplings})
    for pair in body.excluded:
        yield from _unknown("excluded", "link", pair, links)
    yield from _unknown("locked", "joint", body.locked, joints)
    yield from _unknown("reduced_ranges", "joint", body.reduced_ranges, joints)
    for name, limits in body.reduced_ranges.items():
        yield from _wrong_range(f"reduced_ranges: joint {name}", limits)


def _wrong_range(of: str, limits: Any) -> Iterator[str]:
    """Whether `limits` are anything but a smaller and a larger number."""
    if not _are_numbers(limits, 2) or limits[0] >= limits[1]:
        yield f"{of} has the range {limits}; give two numbers, the smaller one first"


def _faults_of_link(link: Link) -> Iterator[str]:
    for field, count in _LINK_NUMBERS.items():
        yield from wrong_numbers(f"link {link.name}: {field}", getattr(link, field), count)
    if not 0 <= link.mass < inf:
        yield f"link {link.name}: its mass is {link.mass}; give 0 or more"
    if link.joint:
        yield from _faults_of_joint(link.joint)
    for geom in (*link.geoms, *link.round_geoms, *link.drawn):
        yield from _faults_of_geom(f"link {link.name}", geom)


def _faults_of_joint(joint: Joint) -> Iterator[str]:
    yield from wrong_numbers(f"joint {joint.name}: axis", joint.axis, 3)
    yield from _wrong_range(f"joint {joint.name}", joint.range)


def _faults_of_geom(of: str, geom: Geom) -> Iterator[str]:
    if geom.type not in _SIZES:
        yield f"{of}: no geom of type {geom.type!r}; choose from {', '.join(_SIZES)}"
        return
    count = _SIZES[geom.type]
    for size in (geom.size, geom.left_size):
        if size is not None and (not _are_numbers(size, count) or min(size) <= 0):
            numbers = "number" if count == 1 else "numbers"
            yield f"{of}: the size of its {geom.type} is {size}; give {count} positive {numbers}"
    yield from wrong_numbers(f"{of}: pos of its {geom.type}", geom.pos, 3)
    yield from wrong_numbers(f"{of}: quat of its {geom.type}", geom.quat, 4)
    if geom.left_quat is not None:
        yield from wrong_numbers(f"{of}: left_quat of its {geom.type}", geom.left_quat, 4)


def _faults_of_couplings(body: Body, joints: Sequence[str]) -> Iterator[str]:
    for coupling in body.couplings:
        yield from _unknown(f"coupling {coupling.name}", "joint", coupling.joints, joints)
        yield from _wrong_range(f"coupling {coupling.name}", coupling.control_range)


def _faults_of_actuators(body: Body, targets: set[str]) -> Iterator[str]:
    for actuator in body.actuators:
        if actuator.target not in targets:
            yield f"there is no joint or coupling {actuator.target!r} for an actuator to move"
        for field in ("kp", "force"):
            if not getattr(actuator, field) > 0:
                yield (
                    f"actuator of {actuator.target}: {field} is {getattr(actuator, field)}; "
                    "give more than 0"
                )


def wrong_numbers(of: str, numbers: Any, count: int) -> Iterator[str]:
    if not _are_numbers(numbers, count):
        yield f"{of} is {numbers}; give {count} finite numbers"
    elif count == 4 and not np.any(numbers):
        yield f"{of} is {numbers}; give a quaternion (w, x, y, z), (1, 0, 0, 0) for no rotation"


def _are_numbers(numbers: Any, count: int) -> bool:
    return np.shape(numbers) == (count,) and bool(np.isfinite(numbers).all())


def _unknown(of: str, kind: str, names: Iterable[str], known: Sequence[str]) -> Iterator[str]:
    if missing := sorted(set(names).difference(known)):
        yield f"{of}: there is no {kind} {missing[0]!r}"


def repeated(names: Iterable[str]) -> Iterator[str]:
    return (name for name, count in Counter(names).items() if count > 1)
