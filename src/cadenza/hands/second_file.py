"""A left hand from a file of its own, as planners want it: in the place and words of the right."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, quoted
from cadenza.hands.body import Actuator, Body, Coupling, Follower, Link
from cadenza.hands.hand import Hand

Array = NDArray[np.float64]

_ALIKE = 0.01  # [m] from where the mirror image of a fingertip is, at most
_ALIGNED = 0.9  # cosine of the angle between axes that are the same, at least
_MIRROR = np.diag([-1.0, 1.0, 1.0])  # from the frame of the right forearm into that of the left


class Section(NamedTuple):
    """A link on the way from a fingertip to the palm."""

    link: str
    joint: str | None  # its joint to the one before, if it has one
    slides: bool  # whether that is a slide
    axis: Array  # (3,) the axis of the joint in the palm's frame while the hand is flat


class FlatHand(NamedTuple):
    """A hand while all joints are at 0."""

    rotation: Array  # (3, 3) from the palm's frame into the forearm's
    fingers: dict[str, list[Section]]  # finger -> its links, the last first, down to the palm
    tips: Array  # (F, 3) in the palm's frame [m]


class SecondFile:
    """The pairing of the parts of a left hand with those of the right one.

    Joints that turn the other way than the mirror image of the right hand's are turned around.
    """

    def __init__(
        self, right: FlatHand, left: FlatHand, error: Callable[[str], CadenzaError]
    ) -> None:
        """Pair links and joints of each finger in their order; raises an `error` if they differ."""
        self._right, self._left, self._error = right, left, error
        self._called = dict[str, str]()  # link or joint of the left hand -> of the right one
        self._sign = dict[str, float]()  # joint of the left hand -> 1, or -1 if turned around
        if list(right.fingers) != list(left.fingers):
            raise error(f"fingers: give the same as of the right hand, {', '.join(right.fingers)}")
        for finger, theirs in left.fingers.items():
            ours = right.fingers[finger]
            if [each.joint is None for each in ours] != [each.joint is None for each in theirs]:
                raise error(f"finger {finger} has other links and joints than that of the right")
            for their, our in zip(theirs, ours, strict=True):
                self._called[their.link] = our.link
                if their.joint and our.joint:
                    self._called[their.joint] = our.joint
                    self._sign[their.joint] = self._direction(their, our)

    def _direction(self, their: Section, our: Section) -> float:
        mirrored = _MIRROR @ self._right.rotation @ our.axis * (1.0 if our.slides else -1.0)
        cosine = float(mirrored @ self._left.rotation @ their.axis)
        if their.slides != our.slides or abs(cosine) < _ALIGNED:
            raise self._error(f"joint {their.joint} moves another way than {our.joint}")
        return float(np.sign(cosine))

    def place(self, pos: Array, rotation: Array) -> tuple[Array, Array]:
        """Where the left palm sits on its forearm if the right one sits at `pos` [m], turned."""
        right, left = self._right, self._left
        turn = _MIRROR @ rotation @ right.rotation.T @ _MIRROR @ left.rotation
        targets = (pos + right.tips @ rotation.T) @ _MIRROR
        at = (targets - left.tips @ turn.T).mean(axis=0)
        off = np.linalg.norm(at + left.tips @ turn.T - targets, axis=1)
        if off.max() > _ALIKE:
            raise self._error(
                f"finger {list(left.fingers)[int(off.argmax())]} ends {1000 * off.max():.0f} mm "
                "from the mirror image of the right one: give a hand that mirrors it"
            )
        return at, turn

    def rest(self, ours: dict[str, float]) -> dict[str, float]:
        """Where the left hand's joints are at rest, if the right one's joints are `ours`."""
        return {
            name: sign * ours[self._called[name]]
            for name, sign in self._sign.items()
            if self._called[name] in ours
        }

    def renamed(self, left: Hand, right: Hand) -> Hand:
        """The left hand in the words and the order of the right one."""
        order = {link.name: place for place, link in enumerate(right.body.links)}
        links = [self._link(each) for each in left.body.links]
        links.sort(key=lambda link: order.get(link.name, len(order)))
        couplings = {each.name: self._coupling(each, right) for each in left.body.couplings}
        by_target = {each.target: each for each in self._actuators(left.body.actuators, couplings)}
        targets = [each.target for each in right.body.actuators]
        if set(targets) != set(by_target):
            differ = sorted(set(targets) ^ set(by_target))
            raise self._error(f"actuators differ: one of the hands has none for {differ[0]}")
        body = Body(
            links=tuple(links),
            actuators=tuple(by_target[target] for target in targets),
            couplings=tuple(couplings.values()),
            followers=tuple(map(self._follower, left.body.followers)),
            excluded=tuple((self._name(a), self._name(b)) for a, b in left.body.excluded),
            mirrored_masses=True,
        )
        fingers = tuple(
            replace(each, links=tuple(map(self._name, each.links)), radii=our.radii)
            for each, our in zip(left.fingers, right.fingers, strict=True)
        )
        return replace(right, name=f"{right.name}, left", body=body, fingers=fingers, left=None)

    def _name(self, name: str) -> str:
        """What the right hand calls a link; one that it lacks has a name that it does not use."""
        ours = self._called.values()
        return self._called.get(name, f"{name}_of_left" if name in ours else name)

    def _link(self, link: Link) -> Link:
        joint = link.joint
        if joint is not None:
            if joint.name not in self._sign:
                raise self._error(f"joint {quoted(joint.name)} moves no finger; name it in fixed")
            if self._sign[joint.name] < 0:
                (x, y, z), (low, high) = joint.axis, joint.range
                joint = replace(joint, axis=(-x, -y, -z), range=(-high, -low))
            joint = replace(joint, name=self._called[joint.name])
        parent = self._name(link.parent)
        return replace(link, name=self._name(link.name), parent=parent, joint=joint)

    def _coupling(self, coupling: Coupling, right: Hand) -> Coupling:
        joints = {self._called[name] for name in coupling.joints}
        low, high = coupling.control_range
        signs = {self._sign[name] for name in coupling.joints}
        for our in right.body.couplings:
            if set(our.joints) == joints and len(signs) == 1:
                return replace(our, control_range=(low, high) if signs == {1.0} else (-high, -low))
        raise self._error(f"tendon {coupling.name} pulls other joints than any of the right hand")

    def _actuators(
        self, actuators: tuple[Actuator, ...], couplings: dict[str, Coupling]
    ) -> Iterator[Actuator]:
        for actuator in actuators:
            ours = couplings.get(actuator.target)
            yield replace(actuator, target=ours.name if ours else self._called[actuator.target])

    def _follower(self, follower: Follower) -> Follower:
        joint, leader, ratio = follower.joint, follower.leader, follower.ratio
        turned = ratio * self._sign[joint] * self._sign[leader]
        return Follower(self._called[joint], self._called[leader], turned)
