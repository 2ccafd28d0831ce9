"""Hands from files that MuJoCo reads, MJCF or URDF, each described by a TOML.

Beside `NAME.toml` lies `NAME.measured.json`, which `cadenza hand measure` writes.
"""

import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, quoted
from cadenza.files import checked, content_of, read_json, sha256_of
from cadenza.fingers import Side
from cadenza.hands import forearm
from cadenza.hands.allegro import FOREARM
from cadenza.hands.arm_allegro import on_arm_as_on_forearm
from cadenza.hands.body import (
    ROTOR,
    SHAPES,
    Actuator,
    Body,
    Coupling,
    Follower,
    Geom,
    Joint,
    Link,
    Quaternion,
    Vector,
    product,
    quaternion_of,
)
from cadenza.hands.hand import FingerChain, Hand
from cadenza.hands.reach import Reach
from cadenza.hands.second_file import FlatHand, SecondFile, Section
from cadenza.hands.servo import Servo

Array = NDArray[np.float64]
ReachField = Literal["rest", "least", "most", "outward", "inward"]
Axis = Literal["x", "y", "z", "-x", "-y", "-z"]

TOML = ".toml"
HOW_TO = "docs/how-to/hand.md says what such a file has"
_MAX_LINKS = 3  # links of a finger with capsules for collisions
_THIN = 0.008  # [m] radius of a link without shapes
_MAX_TIP_RADIUS = 0.03  # [m]
_APART = 0.001  # [m] between the origins of links, for a capsule between them
_NO_MASS = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"}  # MuJoCo wants some
_STIFF = 1.5  # [N m/rad] from which motions have to be gentle
_SLACK = 0.3  # [rad] below which a tendon between two joints couples them
_FOREARM = replace(FOREARM, drawn=())  # not drawn, as a file may have none


@dataclass(frozen=True)
class Tip:
    """The end of a finger that presses."""

    tip: str  # a site at the centre of the round end, or the last body, whose shapes tell it
    at: Vector | None = None  # the centre in the body's frame [m], if its shapes tell it badly
    radius: float | None = None  # its radius [m], if its shapes tell it badly


@dataclass(frozen=True)
class FileDescription:
    """The parts of the MJCF or URDF of a hand."""

    file: str  # the MJCF or URDF, beside the TOML
    palm: str  # the body that the forearm carries, with all that hangs from it
    # Finger -> tip, the thumb first, then its neighbours in their order
    fingers: dict[str, str | Tip]
    # The axis of the palm's frame along which fingers point, if they do not while at 0
    along: Axis | None = None
    # Joint -> the joint that it follows, and its ratio to that; beside those of the file
    follows: dict[str, dict[str, float]] = field(default_factory=dict)
    fixed: dict[str, float] = field(default_factory=dict)  # joint -> where it stays [rad, m]
    kp: float | None = None  # gain of all servos [N m/rad], in place of those of the file
    force: float | None = None  # their largest torque [N m]
    damping: float | None = None  # damping of all joints [N m s/rad]
    armature: float | None = None  # rotor inertia of all joints [kg m^2]


@dataclass(frozen=True)
class Description(FileDescription):
    """The content of the TOML of a right hand."""

    left: FileDescription | None = None  # the left hand, if it is not the mirror image
    mount: Literal["forearm", "arm"] = "forearm"  # what carries the palm


@dataclass(frozen=True)
class Measurement:
    """What planners know of a hand from a file, measured by `cadenza hand measure`."""

    pos: Vector  # where the palm sits on the forearm [m]
    quat: Quaternion
    # Servo -> where the fingertips are just above white keys [rad, m]
    rest: dict[str, float] = field(default_factory=dict)
    lift: dict[str, float] = field(default_factory=dict)  # servo -> motion that lifts its finger
    # Finger -> where it presses white keys [m]
    on_white: dict[str, float] = field(default_factory=dict)
    # The arrays of `Reach`
    reach: dict[ReachField, list[Any]] = field(default_factory=dict)
    sha256: str = ""  # the digest of the files that were measured


def from_mjcf(path: str | Path) -> Hand:
    """Read a hand from its TOML, beside which its MJCF or URDF lies.

    Raises CadenzaError if a file is missing or wrong, or has changed since the hand was measured.
    """
    path = Path(path)
    measured = measurement_of(path)
    if not measured.exists():
        raise CadenzaError(f"{path}: not measured yet; run cadenza hand measure {path}")
    return _read(path, measured, path.stat().st_mtime_ns, measured.stat().st_mtime_ns)


def measurement_of(path: Path) -> Path:
    """The file of the measurement beside the TOML of a hand."""
    return path.with_suffix(".measured.json")


@lru_cache(maxsize=8)  # scenes are built again and again, and compare hands by identity
def _read(path: Path, measured: Path, *_times: int) -> Hand:
    measurement, file = read_json(measured, Measurement), HandFile(path)
    if measurement.sha256 != file.sha256:
        raise CadenzaError(f"{path}: changed since; run cadenza hand measure {path}")
    hand = file.hand(measurement)
    return on_arm_as_on_forearm(hand) if description_of(path).mount == "arm" else hand


def description_of(path: Path) -> Description:
    """The content of a TOML; raises CadenzaError if it is missing or wrong."""
    try:
        content = tomllib.loads(content_of(path).decode())
    except ValueError as error:
        raise CadenzaError(f"{path}: {error}; {HOW_TO}") from None
    return checked(content, Description, path, HOW_TO)


class HandFile:
    """The files of a hand, before it is measured.

    Attributes:
        description: the part of the TOML that describes the hand of this side.
        sha256: the digest of all files.
        flat: (3, 3) rotation from the palm's frame into the forearm's while the hand is flat.
        left: the second file, if there is one and this is the first.
    """

    def __init__(self, path: Path, side: Side = "right") -> None:
        """Read and compile the files; raises CadenzaError if they are missing, or do not fit."""
        self._path, self._side = path, side
        content = description_of(path)
        if content.left and content.mount == "arm":
            raise self.error("left: a hand on an arm is mirrored; leave it out")
        self.description = content.left if side == "left" and content.left else content
        for name in ("kp", "force", "damping", "armature"):
            if (value := getattr(self.description, name)) is not None and not 0 < value < math.inf:
                raise self.error(f"{name} {value:g}: give a positive number")
        self.file = path.parent / self.description.file
        left = content.left if side == "right" else None
        self.sha256 = sha256_of(path, self.file, *([path.parent / left.file] if left else []))
        self.left = HandFile(path, "left") if left else None
        self._model = _compiled(self.file)
        self._root = self._id("palm", mujoco.mjtObj.mjOBJ_BODY, self.description.palm)
        self._fixed = {
            self._id("fixed", mujoco.mjtObj.mjOBJ_JOINT, name): angle
            for name, angle in self.description.fixed.items()
        }
        self._bodies = [b for b in range(self._model.nbody) if self._root in self._line(b)]
        self._joints = dict(self._moving_joints())
        self._data = mujoco.MjData(self._model)
        for joint, angle in self._fixed.items():
            self._data.qpos[self._model.jnt_qposadr[joint]] = angle
        for joint, _, offset, _ in self._coupled():
            self._data.qpos[self._model.jnt_qposadr[joint]] += offset
        mujoco.mj_kinematics(self._model, self._data)
        self._tips = {name: self._tip(name) for name in self.description.fingers}
        self._own = self._own_links()
        self.flat = self._rotation()
        self._followers = {each.joint: each for each in self._find_followers()}
        self._couplings = dict[str, Coupling]()
        self._actuators = list(self._find_actuators())

    def hand(self, measurement: Measurement) -> Hand:
        """The hand with what was measured of it; raises CadenzaError if its parts do not fit."""
        links = [self._link(body, measurement) for body in self._bodies]
        rest = {each.name: float(np.clip(0.0, *each.range)) for each in _joints(links)}
        rest |= measurement.rest
        start = dict(rest)
        for name, coupling in self._couplings.items():
            share = start.pop(name, 0.0) / len(coupling.joints)
            start |= dict.fromkeys(coupling.joints, share)
        for each in self._followers.values():
            start[each.joint] = where = each.ratio * start.get(each.leader, 0.0)
            low, high = next(j.range for j in _joints(links) if j.name == each.joint)
            if not low <= where <= high:
                raise self.error(
                    f"joint {each.joint} follows {each.leader} to {where:.2g}, outside its range "
                    f"({low:.2g}, {high:.2g}); correct the file, or name it in fixed"
                )
        hand = Hand(
            name=self._path.stem,
            body=Body(
                links=(_FOREARM, *links),
                actuators=tuple(self._actuators),
                couplings=tuple(self._couplings.values()),
                followers=tuple(self._followers.values()),
                excluded=tuple(self._excluded(start)),
                mirrored_masses=True,
            ),
            fingers=tuple(self._chains(measurement)),
            servos={each.target: self._servo(each, rest, measurement) for each in self._actuators},
            reach=self._reach(measurement),
            start={joint: start[joint] for joint in self._joints.values()},
        )
        return hand if self.left is None else replace(hand, left=self._left_hand(hand, measurement))

    def _reach(self, measurement: Measurement) -> Reach:
        """How far fingers reach; all zeros before that is measured."""
        count = len(self._tips)
        reach: dict[str, Any] = {
            **{name: np.zeros(count) for name in ("rest", "outward", "inward")},
            **{name: np.zeros((count, count)) for name in ("least", "most")},
            **{name: np.array(values) for name, values in measurement.reach.items()},
        }
        return Reach(**reach, forearm_width=forearm.WIDTH)

    def _left_hand(self, hand: Hand, measurement: Measurement) -> Hand:
        """The hand of the second file, where the mirror image of this one would be."""
        assert self.left is not None
        second = SecondFile(self.flat_hand(), self.left.flat_hand(), self.left.error)
        at, rotation = second.place(np.array(measurement.pos), _matrix(measurement.quat))
        x, y, z = at.tolist()
        rest = second.rest(measurement.rest)
        left_hand = self.left.hand(Measurement((x, y, z), quaternion_of(rotation), rest))
        return second.renamed(left_hand, hand)

    def flat_hand(self) -> FlatHand:
        """The links and fingertips with all joints at 0, except those in `fixed`."""
        palm, joints = self._data.xmat[self._root].reshape(3, 3), self._model.body_jntadr
        lines = {finger: self._line(tip) for finger, (tip, _, _) in self._tips.items()}
        tips = [self._in_frame(self._root, tip) for _, tip, _ in self._tips.values()]
        fingers = {
            finger: [
                Section(
                    self._name(body),
                    self._joints.get(int(joints[body])),
                    bool(self._model.jnt_type[joints[body]] == mujoco.mjtJoint.mjJNT_SLIDE),
                    palm.T @ self._data.xaxis[joints[body]],
                )
                for body in line[: line.index(self._root) + 1]
            ]
            for finger, line in lines.items()
        }
        return FlatHand(self.flat, fingers, np.array(tips))

    # The file

    def error(self, text: str) -> CadenzaError:
        """An error in the TOML on this file."""
        return CadenzaError(f"{self._path}: {'left: ' if self._side == 'left' else ''}{text}")

    def _id(self, of: str, kind: mujoco.mjtObj, name: str) -> int:
        """The id of a body or joint that the TOML names."""
        id_ = int(mujoco.mj_name2id(self._model, kind, name))
        if id_ < 0:
            noun = kind.name.removeprefix("mjOBJ_").lower()
            ids = range(self._model.nbody if noun == "body" else self._model.njnt)
            names = [mujoco.mj_id2name(self._model, kind, each) or "" for each in ids]
            close = get_close_matches(name, names, n=1)
            raise self.error(
                f"{of}: no {noun} of {self.description.file} is named {quoted(name)}"
                f"{f'; did you mean {close[0]}?' if close else ''}"
            )
        return id_

    def _line(self, body: int) -> list[int]:
        """A body and all that it hangs from."""
        line = [body]
        while line[-1]:
            line.append(int(self._model.body_parentid[line[-1]]))
        return line

    def _name(self, body: int) -> str:
        name = self._model.body(body).name or f"body{body}"
        return f"{name}_of_file" if name == forearm.FOREARM else name

    def _moving_joints(self) -> Iterator[tuple[int, str]]:
        """Yield ids and names of the joints of the hand that are not fixed."""
        model = self._model
        for joint in range(model.njnt):
            body, kind = int(model.jnt_bodyid[joint]), mujoco.mjtJoint(model.jnt_type[joint])
            free = kind == mujoco.mjtJoint.mjJNT_FREE and body == self._root
            if body not in self._bodies or joint in self._fixed or free:
                continue
            name = model.joint(joint).name or f"{self._name(body)}_joint"
            if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                raise self.error(f"joint {name} is neither a hinge nor a slide")
            yield joint, name

    def _rotation(self) -> Array:
        """The rotation of a flat palm; a right hand's first finger is to the left."""
        fingers = list(self._own.values())[-max(len(self._own) - 1, 1) :]  # without the thumb
        bases = np.array([self._in_frame(self._root, self._origin(own[-1])) for own in fingers])
        tips = [self._in_frame(self._root, centre) for _, centre, _ in self._tips.values()]
        along = _axis((np.array(tips[-len(fingers) :]) - bases).sum(axis=0))
        if self.description.along is not None:
            sign, axis = self.description.along[:-1], self.description.along[-1]
            along = np.eye(3)["xyz".index(axis)] * (-1.0 if sign else 1.0)
        # A hand of one finger has no sides: any will do.
        left = bases[0] - bases[-1] if len(bases) > 1 else np.roll(along, 1)
        left *= 1.0 if self._side == "right" else -1.0
        left = _axis(left * (along == 0))
        return np.stack([left, np.cross(along, left), along])

    def _shapes(self, body: int) -> list[int]:
        """The geoms of a body that collide."""
        model, first = self._model, int(self._model.body_geomadr[body])
        geoms = range(first, first + int(model.body_geomnum[body]))
        return [g for g in geoms if model.geom_contype[g] | model.geom_conaffinity[g]]

    def _in_frame(self, body: int, point: Array) -> Vector:
        """A point of the world in the frame of a body's link."""
        x, y, z = self._data.xmat[body].reshape(3, 3).T @ (point - self._origin(body))
        return float(x), float(y), float(z)

    def _origin(self, body: int) -> Array:
        """The origin of a body's link, on the axis of its joint."""
        joint = int(self._model.body_jntadr[body])
        origin: Array = (
            self._data.xanchor[joint] if joint in self._joints else self._data.xpos[body]
        )
        return origin

    def _tip(self, finger: str) -> tuple[int, Array, float]:
        """The last body of a finger, and the centre of its tip [m] and its radius [m]."""
        description = self.description.fingers[finger]
        tip = Tip(description) if isinstance(description, str) else description
        site = int(mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, tip.tip))
        if site >= 0 and tip.at is None:
            body, centre = int(self._model.site_bodyid[site]), self._data.site_xpos[site]
        else:
            body, centre = self._id(f"finger {finger}", mujoco.mjtObj.mjOBJ_BODY, tip.tip), None
        if body not in self._bodies:
            raise self.error(f"finger {finger}: {tip.tip} does not hang from the palm")
        ends = [end for geom in self._shapes(body) for end in self._ends(geom)]
        if tip.at is not None:
            centre = self._data.xpos[body] + self._data.xmat[body].reshape(3, 3) @ np.array(tip.at)
        elif centre is None:
            if not ends:
                raise self.error(f"finger {finger} has no tip: {tip.tip} has no shape; give a site")
            origin = self._origin(body)
            centre, _ = max(ends, key=lambda end: float(np.linalg.norm(end[0] - origin)))
        radius = tip.radius
        if radius is not None and not 0 < radius <= _MAX_TIP_RADIUS:
            raise self.error(
                f"finger {finger}: radius {radius:g}: give metres, {_MAX_TIP_RADIUS:g} at most"
            )
        if radius is None:
            near = [(float(np.linalg.norm(end - centre)), radius) for end, radius in ends]
            radius = min(near)[1] if near else _THIN
        return body, centre, radius

    def _ends(self, geom: int) -> list[tuple[Array, float]]:
        """The centres of both ends of a shape [m], and their radius [m]."""
        size, pos = self._model.geom_size[geom], self._data.geom_xpos[geom]
        name, count = SHAPES[int(self._model.geom_type[geom])]
        if name == "sphere":
            return [(pos, float(size[0]))]
        longest = 2 if count == 2 else int(np.argmax(size))
        radius = _radius(name, size)
        half = size[1] if name == "capsule" else max(size[1 if count == 2 else longest] - radius, 0)
        along = half * self._data.geom_xmat[geom].reshape(3, 3)[:, longest]
        return [(pos - along, radius), (pos + along, radius)]

    def _find_followers(self) -> Iterator[Follower]:
        """Yield the joints that the TOML, equalities or taut tendons couple to others."""
        model, names = self._model, self._joints
        for follower, leaders in self.description.follows.items():
            yield from (Follower(follower, leader, ratio) for leader, ratio in leaders.items())
        given = set(self.description.follows)
        driven = {int(model.actuator_trnid[a, 0]) for a in range(model.nu) if not self._pulls(a)}
        for joint, leader, _, (ratio, *bent) in self._coupled():
            if np.any(bent):
                raise self.error(f"joint {names[joint]} follows by more than a ratio; use follows")
            given.add(names[joint])
            yield Follower(names[joint], names[leader], ratio)
        is_length = (model.eq_type == mujoco.mjtEq.mjEQ_TENDON) & (model.eq_obj2id < 0)
        fixed_tendons = set(model.eq_obj1id[is_length].tolist())
        for tendon in range(model.ntendon):
            joints, shares = self._wrapped(tendon)
            slack = 0.0 if tendon in fixed_tendons else np.ptp(model.tendon_range[tendon])
            is_limited = tendon in fixed_tendons or model.tendon_limited[tendon]
            if len(joints) != 2 or not is_limited or not set(joints) <= {*names}:
                continue
            for (joint, share), (leader, leader_share) in (
                ((joints[0], shares[0]), (joints[1], shares[1])),
                ((joints[1], shares[1]), (joints[0], shares[0])),
            ):
                free = joint not in driven and leader in driven and names[joint] not in given
                if free and slack < _SLACK * abs(share):
                    given.add(names[joint])
                    yield Follower(names[joint], names[leader], float(-leader_share / share))

    def _coupled(self) -> Iterator[tuple[int, int, float, list[float]]]:
        """Yield joints that equalities couple, their leaders, offsets and further coefficients."""
        model, names = self._model, self._joints
        for equality in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT):
            joint, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
            if {joint, leader} <= names.keys() and names[joint] not in self.description.follows:
                offset, *others = model.eq_data[equality, :5].tolist()
                yield joint, leader, offset, others

    def _wrapped(self, tendon: int) -> tuple[list[int], list[float]]:
        """The joints of a fixed tendon and their coefficients; empty for other tendons."""
        model, first = self._model, int(self._model.tendon_adr[tendon])
        wraps = slice(first, first + int(model.tendon_num[tendon]))
        if (model.wrap_type[wraps] != mujoco.mjtWrap.mjWRAP_JOINT).any():
            return [], []
        return model.wrap_objid[wraps].tolist(), model.wrap_prm[wraps].tolist()

    def _pulls(self, actuator: int) -> bool:
        return bool(self._model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON)

    def _find_actuators(self) -> Iterator[Actuator]:
        """Yield a servo for each joint or tendon that has one; without any, for each joint."""
        model, moved = self._model, set[int]()
        following = {j for j, name in self._joints.items() if name in self._followers}
        for a in range(model.nu):
            target, gear = int(model.actuator_trnid[a, 0]), float(model.actuator_gear[a, 0])
            joints, shares = self._wrapped(target) if self._pulls(a) else ([target], [1.0])
            if not joints or not set(joints) <= self._joints.keys() - following:
                continue
            name, moved = self._joints[joints[0]], moved.union(joints)
            if self._pulls(a):
                name, (low, high) = model.tendon(target).name, model.actuator_ctrlrange[a]
                if set(shares) != {1.0}:
                    raise self.error(f"tendon {name}: its actuator needs coefficients of 1")
                pulled = tuple(self._joints[j] for j in joints)
                self._couplings[name] = Coupling(name, pulled, (float(low), float(high)))
            kp, kv = -model.actuator_biasprm[a, 1:3] * gear**2
            force = gear * model.actuator_forcerange[a, 1] if model.actuator_forcelimited[a] else 0
            self._check_damped(joints, kv)
            yield self._actuator(name, float(kp), float(kv), float(force))
        for joint, name in self._joints.items():
            if joint in moved | following:
                continue
            if model.nu:
                raise self.error(
                    f"joint {name} has no actuator; give it one, or name it in follows or fixed"
                )
            self._check_damped([joint], 0.0)
            yield self._actuator(name, 0.0, 0.0, float(model.jnt_actfrcrange[joint, 1]))

    def _check_damped(self, joints: list[int], kv: float) -> None:
        damping = self._model.dof_damping[self._model.jnt_dofadr[joints]]
        if self.description.damping is None and kv <= 0 and not damping.all():
            name = self._joints[joints[0]]
            raise self.error(
                f"joint {name} has no damping; give damping [N m s/rad], kp / 25 or so"
            )

    def _actuator(self, name: str, kp: float, kv: float, force: float) -> Actuator:
        kp = self.description.kp or kp
        if kp <= 0:
            raise self.error(f"{name} has no position servo; give kp [N m/rad]")
        return Actuator(name, kp, self.description.force or force or math.pi * kp, max(kv, 0.0))

    # The parts of the hand

    def _link(self, body: int, measurement: Measurement) -> Link:
        model, data = self._model, self._data
        parent = int(model.body_parentid[body])
        if body == self._root:
            pos, quat, above = measurement.pos, measurement.quat, forearm.FOREARM
        else:
            pos, above = self._in_frame(parent, self._origin(body)), self._name(parent)
            quat = product(data.xquat[parent] * (1, -1, -1, -1), data.xquat[body])
        joint = int(model.body_jntadr[body])
        return Link(
            self._name(body),
            above,
            pos,
            mass=float(model.body_mass[body]),
            com=self._in_frame(body, data.xipos[body]),
            inertia=tuple(model.body_inertia[body].tolist()),
            inertia_quat=tuple(model.body_iquat[body].tolist()),
            quat=quat,
            joint=self._joint(joint) if joint in self._joints else None,
            geoms=tuple(self._geom(body, geom) for geom in self._shapes(body)),
            hides_keys=body == self._root,
        )

    def _joint(self, joint: int) -> Joint:
        model, dof = self._model, int(self._model.jnt_dofadr[joint])
        low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-math.pi, math.pi)
        given, zero = self.description, float(self._data.qpos[model.jnt_qposadr[joint]])
        rotor = float(model.dof_armature[dof]) or ROTOR
        return Joint(
            self._joints[joint],
            axis=tuple(model.jnt_axis[joint].tolist()),
            range=(float(low) - zero, float(high) - zero),
            damping=float(model.dof_damping[dof]) if given.damping is None else given.damping,
            slide=bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE),
            armature=rotor if given.armature is None else given.armature,
            friction_loss=float(model.dof_frictionloss[dof]),
        )

    def _geom(self, body: int, geom: int) -> Geom:
        name, count = SHAPES[int(self._model.geom_type[geom])]
        return Geom(
            name,
            size=tuple(self._model.geom_size[geom, :count].tolist()),
            pos=self._in_frame(body, self._data.geom_xpos[geom]),
            quat=tuple(self._model.geom_quat[geom].tolist()),
        )

    def _own_links(self) -> dict[str, list[int]]:
        """Finger -> the bodies that hang from no other finger's, from its tip on."""
        lines = {name: self._line(body) for name, (body, _, _) in self._tips.items()}
        links, moving = {}, {int(self._model.jnt_bodyid[joint]) for joint in self._joints}
        for name, line in lines.items():
            shared = {b for other in lines.values() if other is not line for b in other}
            links[name] = [b for b in line if b not in shared and b != self._root]
            while links[name] and links[name][-1] not in moving:
                links[name].pop()
            if not links[name]:
                raise self.error(f"finger {name} has no joint of its own; give another tip")
        return links

    def _chains(self, measurement: Measurement) -> Iterator[FingerChain]:
        """Yield the fingers, each with as many of its last links as the shortest has."""
        long = {name: list(self._with_length(own)) for name, own in self._own.items()}
        count = min(_MAX_LINKS, *map(len, long.values()))
        for name, links in long.items():
            chain, (_, centre, radius) = links[:count][::-1], self._tips[name]
            yield FingerChain(
                name,
                links=tuple(map(self._name, chain)),
                radii=(*map(self._thickness, chain[:-1]), radius),
                tip=self._in_frame(chain[-1], centre),
                on_white=measurement.on_white.get(name, 0.0),
            )

    def _with_length(self, links: list[int]) -> Iterator[int]:
        """Yield the last link, and each that begins elsewhere than the one after it."""
        yield links[0]
        for next_link, link in pairwise(links):
            if np.linalg.norm(self._origin(link) - self._origin(next_link)) > _APART:
                yield link

    def _thickness(self, body: int) -> float:
        return max((self._half_width(body, geom) for geom in self._shapes(body)), default=_THIN)

    def _half_width(self, body: int, geom: int) -> float:
        """Half of how wide a shape is across its link [m]; a box may be wider than long."""
        name, _ = SHAPES[int(self._model.geom_type[geom])]
        size, turn = self._model.geom_size[geom], self._data.geom_xmat[geom].reshape(3, 3)
        if name != "box":
            return _radius(name, size)
        along = turn.T @ (self._data.geom_xpos[geom] - self._origin(body))
        return float(np.delete(size, np.argmax(np.abs(along))).max())

    def _servo(
        self, actuator: Actuator, rests: dict[str, float], measurement: Measurement
    ) -> Servo:
        joint = actuator.target
        if joint in self._couplings:
            joint = self._couplings[joint].joints[0]
        body = next(self._model.jnt_bodyid[j] for j, name in self._joints.items() if name == joint)
        moved = [i for i, (tip, _, _) in enumerate(self._tips.values()) if body in self._line(tip)]
        rest = rests.get(actuator.target, 0.0)
        if len(moved) != 1:
            return Servo(rest, ease=0.3, acceleration=40.0, noise=0.03, correction=0.1)
        stiff = actuator.kp > _STIFF
        return Servo(
            rest,
            acceleration=40.0 if stiff else 160.0,
            noise=0.04 if stiff else 0.08,
            correction=0.1 if stiff else 0.25,
            lift=measurement.lift.get(actuator.target, 0.0),
            finger=moved[0],
        )

    def _excluded(self, start: dict[str, float]) -> Iterator[tuple[str, str]]:
        """Yield pairs of links that do not collide: by the file, or as they touch at rest."""
        model, data = self._model, mujoco.MjData(self._model)
        pairs = {tuple(divmod(int(each), 1 << 16)) for each in model.exclude_signature}
        for share in (0.0, 1.0):  # with straight fingers, and at rest
            data.qpos[:] = self._data.qpos
            for joint, name in self._joints.items():
                data.qpos[model.jnt_qposadr[joint]] += share * start.get(name, 0.0)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            touching = model.geom_bodyid[data.contact.geom].reshape(-1, 2)
            pairs |= {(min(pair), max(pair)) for pair in touching.tolist()}
        fingers = {body: name for name, own in self._own.items() for body in own}
        for pair in sorted(pairs):
            first, second = (fingers.get(body) for body in pair)
            if {*pair} <= {*self._bodies} and (first == second or None in (first, second)):
                yield self._name(pair[0]), self._name(pair[1])
        yield forearm.FOREARM, self._name(self._root)


def _joints(links: list[Link]) -> list[Joint]:
    return [link.joint for link in links if link.joint]


def _compiled(file: Path) -> mujoco.MjModel:
    """The model of a file, with a simple shape for each mesh; all of them collide."""
    try:
        spec = _one_joint_a_body(mujoco.MjSpec.from_file(str(file)), file)
        spec.compiler.fusestatic = False  # keeps the names of tips
        spec.compiler.balanceinertia = True  # of many a URDF
        for geom in spec.geoms:
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                root = not geom.parent.joints
                geom.type = mujoco.mjtGeom.mjGEOM_BOX if root else mujoco.mjtGeom.mjGEOM_CAPSULE
            if geom.contype | geom.conaffinity:
                geom.contype = geom.conaffinity = 1
        return spec.compile()
    except ValueError as error:
        raise CadenzaError(
            f"{file}: MuJoCo cannot read it: {' '.join(str(error).split())}"
        ) from error


def _one_joint_a_body(spec: mujoco.MjSpec, file: Path) -> mujoco.MjSpec:
    """Hang each body that has several joints from bodies without shapes, one for each but the last.

    Exclusions keep bodies from touching their former parents, as MuJoCo does for parents.
    """
    if not any(len(body.joints) > 1 for body in spec.bodies):
        return spec
    root = fromstring(spec.to_xml())
    excluded = root.find("contact") or SubElement(root, "contact")
    for parent in reversed([*root.iter("body")]):  # children before their parents
        for body in parent.findall("body"):
            name, joints = body.get("name"), body.findall("joint")
            for joint in joints[:-1]:
                inner = Element("body")
                inner.extend(part for part in body if part is not joint)
                body[:] = [joint, Element("inertial", _NO_MASS), inner]
                body.attrib.pop("name", None)
                body = inner
            if len(joints) > 1 and name and parent.get("name"):
                body.set("name", name)
                SubElement(excluded, "exclude", body1=parent.get("name", ""), body2=name)
    again = mujoco.MjSpec.from_string(tostring(root, encoding="unicode"))
    again.modelfiledir = str(file.parent)
    return again


def _axis(direction: Array) -> Array:
    """The unit vector of the axis that is nearest to a direction."""
    index = int(np.argmax(np.abs(direction)))
    unit: Array = np.sign(direction[index]) * np.eye(3)[index]
    return unit


def _matrix(quat: Quaternion) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(quat))
    return matrix.reshape(3, 3)


def _radius(name: str, size: Array) -> float:
    """How thick a shape is: half of its width [m]."""
    return float(np.sort(size)[1] if name in ("box", "ellipsoid") else size[0])
