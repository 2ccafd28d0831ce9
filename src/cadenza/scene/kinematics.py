"""Where the fingers are, and how they move with the servos, for many postures at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.hands.body import prefix
from cadenza.scene.scene import Scene, hand_on_keys
from cadenza.scene.servos import Servos

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

TIP = -1  # the last of a finger's points


class _Joints(NamedTuple):
    """J joints, of as many bodies, of which one does not carry another."""

    bodies: Ids
    """(J,) among those of their level."""
    ids: Ids
    """(J,) in the model."""
    servo: Ids
    """(J,)"""
    share: Array
    """(J, 1) of the servo's coordinate."""
    hinge: bool
    axis: Array
    """(J, 3)"""
    anchor: Array
    """(J, 3)"""
    across: Array
    """(J, 1, 3, 3) that multiplies by the axis, and"""
    twice: Array
    """(J, 1, 3, 3) its square."""
    moved: list[list[int]]
    """Points, by joint."""

    def rotations(self, angle: Array) -> Array:
        """(J, S, 3, 3) by angles (J, S) [rad] about the axes: Rodrigues' formula."""
        sin, cos = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
        return np.eye(3) + sin * self.across + (1 - cos) * self.twice


class _Level(NamedTuple):
    """B bodies that are equally many bodies away from the world."""

    parents: Ids
    """(B,) among those of the level before."""
    pos: Array
    """(B, 1, 3)"""
    rot: Array
    """(B, 1, 3, 3)"""
    joints: list[_Joints]
    points: Ids
    """(N,) that they carry."""
    carriers: Ids
    """(N,) of these, among the bodies."""


class _Moves(NamedTuple):
    """N pairs of a joint and a point that it moves; no two have both the servo and the point."""

    joint: Ids
    """(N,) in the order of the levels."""
    servo: Ids
    """(N,) among those of its hand."""
    share: Array
    """(N, 1, 1) of the servo's coordinate."""
    point: Ids
    """(N,)"""
    hinge: bool
    again: bool
    """Whether earlier ones have the same servos and points."""


class Kinematics:
    """Forward kinematics of the F fingers of a scene, written over arrays of postures.

    The same as MuJoCo's, which takes one posture at a time. Joints without a servo stay at zero.
    The P points of a finger are the origins of its links, and its tip. Bodies that are alike in
    all fingers are moved together: of few postures, it is the number of calls that takes time.
    """

    def __init__(self, scene: Scene, servos: Servos) -> None:
        model = scene.model
        bodies = [int(body) for body in scene.hand_bodies]
        index = {body: i for i, body in enumerate(bodies)}
        self._num_servos = len(servos.low) // len(scene.sides)
        point_body, point_pos = [], []
        chains = [(prefix(side), f.links) for side in scene.sides for f in scene.hand.fingers]
        for (hand, links), site in zip(chains, scene.fingertip_sites, strict=True):
            origins = [index[model.body(hand + link).id] for link in links]
            point_body += [*origins, origins[-1]]
            point_pos += [np.zeros(3)] * len(origins) + [model.site_pos[site].copy()]
        self._num_points = len(scene.hand.fingers[0].links) + 1
        self._point_bodies = _ids(bodies[i] for i in point_body)
        self._point_pos = np.array(point_pos)[:, None, :, None]
        parent = [index.get(int(model.body_parentid[body]), -1) for body in bodies]
        chain: list[list[int]] = []  # of a body and those that carry it
        for i, carrier in enumerate(parent):
            chain.append([i] if carrier < 0 else [*chain[carrier], i])
        moved = [
            [p for p, body in enumerate(point_body) if i in chain[body]] for i in index.values()
        ]
        joints = [_joints_of(scene, servos, body) for body in bodies]
        self._levels = []
        before: list[int] = []
        for depth in range(1, max(map(len, chain)) + 1):
            level = [i for i, carriers in enumerate(chain) if len(carriers) == depth]
            points = [p for p, body in enumerate(point_body) if body in level]
            ids = [bodies[i] for i in level]
            self._levels.append(
                _Level(
                    parents=_ids(before.index(parent[i]) for i in level if before),
                    pos=model.body_pos[ids][:, None],
                    rot=np.array([_matrix(quat) for quat in model.body_quat[ids]])[:, None],
                    joints=_together([joints[i] for i in level], [moved[i] for i in level]),
                    points=_ids(points),
                    carriers=_ids(level.index(point_body[p]) for p in points),
                )
            )
            before = level
        groups = [joints for level in self._levels for joints in level.joints]
        self._moves = _moves(groups, self._num_servos)

    def fingers(self, postures: Array) -> tuple[Array, Array]:
        """Points (S, F, P, 3) [m] of postures (S, A), and their Jacobian (S, F, P, 3, A').

        It is that by the A' servos of a finger's own hand; those of the other do not move it.
        """
        points, axes, centres = self._there(postures)
        count = len(postures)
        jacobian = np.zeros((self._num_servos, count, len(points), 3))
        for moves in self._moves:
            column = moves.share * axes[moves.joint]
            if moves.hinge:
                column = _cross(column, points[moves.point] - centres[moves.joint])
            if moves.again:
                column += jacobian[moves.servo, :, moves.point]
            jacobian[moves.servo, :, moves.point] = column
        shape = (count, len(points) // self._num_points, self._num_points, 3)
        points = np.ascontiguousarray(points.transpose(1, 0, 2)).reshape(shape)
        return points, np.moveaxis(jacobian, 0, -1).reshape(*shape, -1)

    def _there(self, postures: Array) -> tuple[Array, Array, Array]:
        """(N, S, 3) points, and (J, S, 3) axes and anchors of joints, of postures (S, A)."""
        count, coordinates = len(postures), np.ascontiguousarray(postures.T)
        points = np.zeros((len(self._point_pos), count, 3))
        motions = []
        rot, pos = np.zeros((0, count, 3, 3)), np.zeros((0, count, 3))
        for i, level in enumerate(self._levels):
            if i:
                carrier = rot[level.parents]
                pos = pos[level.parents] + (carrier @ level.pos[..., None])[..., 0]
                rot = carrier @ level.rot
            else:
                pos = np.tile(level.pos, (1, count, 1))
                rot = np.tile(level.rot, (1, count, 1, 1))
            for joints in level.joints:
                value = joints.share * coordinates[joints.servo]
                turned, there = rot[joints.bodies], pos[joints.bodies]
                axis = _turn(turned, joints.axis)
                centre = there + _turn(turned, joints.anchor)
                if joints.hinge:
                    turned = turned @ joints.rotations(value)
                    rot[joints.bodies] = turned
                    pos[joints.bodies] = centre - _turn(turned, joints.anchor)
                else:
                    pos[joints.bodies] = there + axis * value[..., None]
                motions.append((axis, centre))
            on = (rot[level.carriers] @ self._point_pos[level.points])[..., 0]
            points[level.points] = pos[level.carriers] + on
        axes, centres = map(np.concatenate, zip(*motions, strict=True))
        return points, axes, centres


class KinematicsOfFew(Kinematics):
    """The same, of one posture after the other by MuJoCo: faster where there are few.

    The last digits are not the same.
    """

    def __init__(self, scene: Scene, servos: Servos) -> None:
        super().__init__(scene, servos)
        model = self._model = hand_on_keys(scene, range(0), ())
        self._servos, self._data = servos, mujoco.MjData(model)
        joints = np.concatenate([j.ids for level in self._levels for j in level.joints])
        self._joints = _ids(model.joint(scene.model.joint(i).name).id for i in joints)
        self._bodies = _ids(model.body(scene.model.body(i).name).id for i in self._point_bodies)
        self._tips = _ids(model.site(scene.model.site(i).name).id for i in scene.fingertip_sites)

    def _there(self, postures: Array) -> tuple[Array, Array, Array]:
        data, count, size = self._data, len(postures), self._num_points
        now = data.xpos, data.site_xpos, data.xaxis, data.xanchor
        rows = [np.empty((count, *values.shape)) for values in now]
        for row, qpos in enumerate(postures @ self._servos.joints):
            data.qpos = qpos
            mujoco.mj_kinematics(self._model, data)
            for kept, values in zip(rows, now, strict=True):
                kept[row] = values
        bodies, sites, axes, anchors = (values.swapaxes(0, 1) for values in rows)
        points = bodies[self._bodies]
        points[size - 1 :: size] = sites[self._tips]
        return points, axes[self._joints], anchors[self._joints]


class _Joint(NamedTuple):
    id: int
    servo: int
    share: float  # of the servo's coordinate
    hinge: bool
    axis: Array
    anchor: Array


def _joints_of(scene: Scene, servos: Servos, body: int) -> list[_Joint]:
    model = scene.model
    first = model.body_jntadr[body]
    joints = []
    for j in range(first, first + model.body_jntnum[body]):
        shares = servos.joints[:, model.jnt_qposadr[j] - scene.hand_qpos.start]
        if shares.any():
            servo = int(np.argmax(shares))
            hinge = bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE)
            axis, anchor = model.jnt_axis[j].copy(), model.jnt_pos[j].copy()
            joints.append(_Joint(j, servo, float(shares[servo]), hinge, axis, anchor))
    return joints


def _together(joints: list[list[_Joint]], moved: list[list[int]]) -> list[_Joints]:
    """Those of the bodies of a level, which move these points; all their first ones come first."""
    result = []
    for nth in range(max(map(len, joints))):
        for hinge in (False, True):
            mine = [
                b for b, some in enumerate(joints) if len(some) > nth and some[nth].hinge == hinge
            ]
            if mine:
                some = [joints[b][nth] for b in mine]
                axes = np.array([joint.axis for joint in some])
                across = np.array([_across(axis) for axis in axes])[:, None]
                result.append(
                    _Joints(
                        bodies=_ids(mine),
                        ids=_ids(joint.id for joint in some),
                        servo=_ids(joint.servo for joint in some),
                        share=np.array([[joint.share] for joint in some]),
                        hinge=hinge,
                        axis=axes,
                        anchor=np.array([joint.anchor for joint in some]),
                        across=across,
                        twice=across @ across,
                        moved=[moved[b] for b in mine],
                    )
                )
    return result


def _moves(groups: list[_Joints], servos_of_hand: int) -> list[_Moves]:
    """Of the joints of all levels; those of a servo that come later are apart."""
    pairs: dict[tuple[int, bool], list[tuple[int, int, float, int]]] = {}
    times = Counter[tuple[int, int]]()
    first = 0
    for group in groups:
        for j, moved in enumerate(group.moved):
            servo, share = int(group.servo[j]) % servos_of_hand, float(group.share[j, 0])
            for point in moved:
                apart = times[servo, point], group.hinge
                pairs.setdefault(apart, []).append((first + j, servo, share, point))
                times[servo, point] += 1
        first += len(group.moved)
    result = []
    for (nth, hinge), some in sorted(pairs.items()):
        joint, servos, shares, points = zip(*some, strict=True)
        result.append(
            _Moves(
                joint=_ids(joint),
                servo=_ids(servos),
                share=np.array(shares)[:, None, None],
                point=_ids(points),
                hinge=hinge,
                again=nth > 0,
            )
        )
    return result


def _across(axis: Array) -> Array:
    """(3, 3) that multiplies a vector by `axis`."""
    x, y, z = axis
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _ids(values: Iterable[int]) -> Ids:
    return np.array(list(values), np.intp)


def _turn(rot: Array, vectors: Array) -> Array:
    """(B, S, 3) of rotations (B, S, 3, 3) and vectors (B, 3)."""
    turned: Array = (rot @ vectors[:, None, :, None])[..., 0]
    return turned


def _matrix(quat: Array) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def _cross(a: Array, b: Array) -> Array:
    """The cross product; NumPy's own takes several times as long."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
