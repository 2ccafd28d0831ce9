"""What cannot be right about a hand, said before it shows somewhere else."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.fingers import PER_HAND
from cadenza.hands import forearm

if TYPE_CHECKING:
    from cadenza.hands.body import Body
    from cadenza.hands.hand import Finger, Hand


def check(hand: Hand) -> None:
    """Raises: CadenzaError: parts of the hand do not go together."""
    for fault in _faults(hand):
        raise CadenzaError(f"hand {hand.name}: {fault}")


def _faults(hand: Hand) -> Iterator[str]:
    yield from _faults_of_body(hand.body)
    links = {link.name for link in hand.body.links}
    count = len(hand.fingers)
    if not 0 < count <= PER_HAND:
        yield f"has {count} fingers; give 1 to {PER_HAND}"
    for finger in hand.fingers:
        yield from _faults_of_finger(finger, hand.fingers[0], links)
    for actuator in hand.body.actuators:
        if actuator.target not in hand.servos:
            yield f"servos has none for the actuator of {actuator.target!r}; add a Servo"
    joints = {link.joint.name for link in hand.body.links if link.joint}
    if unknown := sorted(hand.start.keys() - joints):
        yield f"start: there is no joint {unknown[0]!r}"
    for field, given in vars(hand.reach).items():
        shape = {"least": (count, count), "most": (count, count)}.get(field, (count,))
        if isinstance(given, np.ndarray) and given.shape != shape:
            yield f"reach.{field} has shape {given.shape}; give {shape}"


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


def _faults_of_finger(finger: Finger, thumb: Finger, links: set[str]) -> Iterator[str]:
    if unknown := [link for link in finger.links if link not in links]:
        yield f"finger {finger.name}: there is no link {unknown[0]!r}"
    if len(finger.links) != len(thumb.links) or not finger.links:
        yield (
            f"finger {finger.name} has {len(finger.links)} links and {thumb.name} "
            f"{len(thumb.links)}; give as many for every finger"
        )
    if len(finger.radii) != len(finger.links):
        yield f"finger {finger.name}: give a radius for each of its {len(finger.links)} links"
