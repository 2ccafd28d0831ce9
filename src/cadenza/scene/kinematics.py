"""Where the fingers are, and how they move with the servos, for many postures."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.hands.body import prefix
from cadenza.scene.scene import Ids, Scene, as_ids, hand_on_keys
from cadenza.scene.servos import Servos

Array = NDArray[np.float64]

TIP = -1  # the last of a finger's points


class _Moves(NamedTuple):
    """N pairs of a joint and a point that it moves; no two have both the servo and the point."""

    joint: Ids
    """(N,)"""
    share: Array
    """(N,) of the servo's coordinate."""
    point: Ids
    """(N,)"""
    where: Ids
    """(3, N) of the Jacobian of a posture."""
    hinge: bool
    again: bool
    """Whether earlier ones have the same servos and points."""


class Links(NamedTuple):
    """The links of F fingers of each of H hands in S postures, and how they move.

    It is the A servos of a finger's own hand that move it. J joints are those of a hand.
    """

    points: Array
    """(S, H, F, P, 3), see `Kinematics` [m]."""
    tips: Array
    """(S, H, F, 3, A) the Jacobian of the tips."""
    screws: Array
    """(S, H, J, 6) of joints: their axes, and the velocity that they give to the origin."""
    carried: NDArray[np.bool_]
    """(F, P, J) whether a joint moves the link that begins at a point."""
    shares: Array
    """(J, A) what a unit of a servo's coordinate adds to each joint."""

    def along(self, posture: Ids, finger: Ids, link: Ids, at: Array, direction: Array) -> Array:
        """(..., A) how fast points on links go in a direction, by the servos.

        That is the product of the screws of joints and the wrench of a unit force at the point
        (Murray, Li & Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, 2.5).

        Args:
            posture: (...)
            finger: (...) of the right hand, or counted on from these of the left.
            link: (...) of the finger.
            at: (..., 3) where the point is [m].
            direction: (..., 3) of length 1.
        """
        hand, own = np.divmod(finger, len(self.carried))
        wrench = np.concatenate([_cross(at.T, direction.T).T, direction], axis=-1)
        of_joints = (self.screws[posture, hand] @ wrench[..., None])[..., 0]
        slopes: Array = (of_joints * self.carried[own, link]) @ self.shares
        return slopes


class Kinematics:
    """Forward kinematics of the F fingers of a scene, by MuJoCo. Joints without a servo stay at 0.

    The P points of a finger are the origins of its links, and its tip. One thread at a time.
    """

    def __init__(self, scene: Scene, servos: Servos) -> None:
        model = self._model = hand_on_keys(scene, range(0), ())
        self._servos, self._data = servos, mujoco.MjData(model)
        self._hands, self._num_servos = len(scene.sides), len(servos.low) // len(scene.sides)
        bodies = [
            model.body(prefix(side) + link).id
            for side in scene.sides
            for finger in scene.hand.fingers
            for link in (*finger.links, finger.links[-1])  # whose tip is the last point
        ]
        self._bodies, self._num_points = as_ids(bodies), len(scene.hand.fingers[0].links) + 1
        self._tips = as_ids(model.site(scene.model.site(i).name).id for i in scene.fingertip_sites)
        chains = [_chain(model, body) for body in bodies]
        of_tips = chains[self._num_points - 1 :: self._num_points]
        self._moves = _moves(model, servos.joints, of_tips, self._num_servos)
        joints = model.njnt // self._hands
        self._hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        self._shares = servos.joints[: self._num_servos, :joints].T
        of_one = chains[: len(chains) // self._hands]
        carried = [np.isin(model.jnt_bodyid[:joints], list(chain)) for chain in of_one]
        self._carried = np.array(carried).reshape(-1, self._num_points, joints)

    def links(self, postures: Array) -> Links:
        """Those of postures (S, A)."""
        points, axes, anchors = self._there(postures)
        tips = points[:, :, self._num_points - 1 :: self._num_points]
        jacobian = self._jacobian(tips, axes, anchors)
        linear = np.where(self._hinges, _cross(anchors, axes), axes)
        screws = np.concatenate([axes * self._hinges, linear])
        shape = len(postures), self._hands, len(self._carried)
        return Links(
            np.moveaxis(points, 0, 2).reshape(*shape, self._num_points, 3),
            jacobian.reshape(*shape, 3, -1),
            np.moveaxis(screws, 0, 2).reshape(*shape[:2], -1, 6),
            self._carried,
            self._shares,
        )

    def points(self, postures: Array) -> Array:
        """(S, F, P, 3) those of postures (S, A) [m]."""
        points, _, _ = self._there(postures)
        return np.moveaxis(points, 0, 2).reshape(len(postures), -1, self._num_points, 3)

    def fingertips(self, postures: Array, moving: slice = slice(None)) -> tuple[Array, Array]:
        """Tips (S, F, 3) [m] of postures (S, A), and their Jacobian (S', F, 3, A').

        It is that by the A' servos of a finger's own hand; those of the other do not move it.
        `moving` says of which of the postures it is, by default of all.
        """
        points, axes, anchors = self._there(postures)
        tips = points[:, :, self._num_points - 1 :: self._num_points]
        jacobian = self._jacobian(tips[:, moving], axes[:, moving], anchors[:, moving])
        return np.moveaxis(tips, 0, 2), jacobian.reshape(len(jacobian), tips.shape[2], 3, -1)

    def _jacobian(self, tips: Array, axes: Array, anchors: Array) -> Array:
        """(S, 3 F A') of tips (3, S, F), by axes and anchors (3, S, J) of joints."""
        jacobian = np.zeros((tips.shape[1], tips.shape[2] * 3 * self._num_servos))
        for moves in self._moves:
            column = moves.share * axes[:, :, moves.joint]
            if moves.hinge:
                column = _cross(column, tips[:, :, moves.point] - anchors[:, :, moves.joint])
            if moves.again:
                column += jacobian[:, moves.where].swapaxes(0, 1)
            jacobian[:, moves.where] = column.swapaxes(0, 1)
        return jacobian

    def _there(self, postures: Array) -> tuple[Array, Array, Array]:
        """(3, S, N) points, and (3, S, J) axes and anchors of joints, of postures (S, A)."""
        data, count, size = self._data, len(postures), self._num_points
        now = data.xpos, data.site_xpos, data.xaxis, data.xanchor
        rows = [np.empty((count, *values.shape)) for values in now]
        for row, qpos in enumerate(postures @ self._servos.joints):
            data.qpos = qpos
            mujoco.mj_kinematics(self._model, data)
            for kept, values in zip(rows, now, strict=True):
                kept[row] = values
        # An array for each coordinate, as products take several times as long of vectors.
        bodies, sites, axes, anchors = (
            np.ascontiguousarray(values.transpose(2, 0, 1)) for values in rows
        )
        points = bodies[:, :, self._bodies]
        points[:, :, size - 1 :: size] = sites[:, :, self._tips]
        return points, axes, anchors


def _moves(
    model: mujoco.MjModel, joints: Array, chains: list[set[int]], servos_of_hand: int
) -> list[_Moves]:
    """Of points in a model of hands, by their `_chain`, which servos move as `joints` (A, J) says.

    A joint that moves with a servo that has moved the point already is apart.
    """
    pairs: dict[tuple[int, bool], list[tuple[int, int, float, int]]] = {}
    times = Counter[tuple[int, int]]()
    for joint, shares in enumerate(joints.T):
        if not shares.any():
            continue
        servo, share = int(np.argmax(shares)), float(shares.max())
        own, hinge = servo % servos_of_hand, model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        for point, chain in enumerate(chains):
            if model.jnt_bodyid[joint] in chain:
                apart = times[own, point], bool(hinge)
                pairs.setdefault(apart, []).append((joint, own, share, point))
                times[own, point] += 1
    result = []
    for (nth, hinge), some in sorted(pairs.items()):
        which, servos, of_them, points = map(np.array, zip(*some, strict=True))
        where = (3 * points + np.arange(3)[:, None]) * servos_of_hand + servos
        result.append(_Moves(which, of_them, points, where, hinge, again=nth > 0))
    return result


def _chain(model: mujoco.MjModel, body: int) -> set[int]:
    """A body and those that carry it, but not the world."""
    chain = set[int]()
    while body:
        chain.add(body)
        body = int(model.body_parentid[body])
    return chain


def _cross(a: Array, b: Array) -> Array:
    """The cross products of vectors (3, ...)."""
    (x, y, z), (u, v, w), product = a, b, np.empty_like(b)
    product[0], product[1], product[2] = y * w - z * v, z * u - x * w, x * v - y * u
    return product
