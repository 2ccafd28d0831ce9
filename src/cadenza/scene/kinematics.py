"""Forward kinematics and Jacobians of fingers, for many postures at once."""

from collections import Counter
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.hands.body import prefix
from cadenza.scene.scene import Ids, Scene, as_ids, reduced_model
from cadenza.scene.servos import servos_of

Array = NDArray[np.float64]

TIP = -1  # index of the tip among a finger's points


class _JacobianTerms(NamedTuple):
    """N pairs of a joint and a point that it moves; no two have both the servo and the point."""

    joint: Ids  # (N,) the joints
    share: Array  # (N,) derivatives of the joints by the servo's coordinate
    point: Ids  # (N,) the points
    where: Ids  # (3, N) places of x, y and z in the Jacobian of a posture, flattened
    hinge: bool  # whether the joints are hinges, not slides
    repeated: bool  # whether earlier terms have the same servos and points


class Links(NamedTuple):
    """The links of F fingers of each of H hands in S postures, and their Jacobians.

    A is the number of servos of one hand, which move its fingers; J that of its joints.
    """

    points: Array  # (S, H, F, P, 3) the points of `Kinematics` [m]
    tips: Array  # (S, H, F, 3, A) Jacobians of the tips
    # (S, H, J, 6) screws of the joints: axis, and velocity that they give to the origin
    screws: Array
    carried: NDArray[np.bool_]  # (F, P, J) whether a joint moves the link that begins at a point
    shares: Array  # (J, A) derivatives of the joints by the servos' coordinates

    def along(self, posture: Ids, finger: Ids, link: Ids, at: Array, direction: Array) -> Array:
        """(..., A) derivatives of points on links along a direction, by the servos' coordinates.

        They are the product of the screws of joints and the wrench of a unit force at the point
        (Murray, Li & Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, 2.5).

        Args:
            posture: (...) indices of postures.
            finger: (...) indices of fingers, the left hand's after the right hand's.
            link: (...) indices of the fingers' links.
            at: (..., 3) the points [m].
            direction: (..., 3) unit vectors.
        """
        hand, own_finger = np.divmod(finger, len(self.carried))
        wrench = np.concatenate([_cross(at.T, direction.T).T, direction], axis=-1)
        by_joints = (self.screws[posture, hand] @ wrench[..., None])[..., 0]
        derivatives: Array = (by_joints * self.carried[own_finger, link]) @ self.shares
        return derivatives


class Kinematics:
    """Forward kinematics of the F fingers of a scene, by MuJoCo. Joints without a servo stay at 0.

    The P points of a finger are the origins of its links, and its tip. One thread at a time.

    Attributes:
        scene: the scene, with one hand or two.
        servos: the servos of its hands.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.servos = scene, servos_of(scene)
        servos, model = self.servos, reduced_model(scene, range(0), ())
        self._model, self._data = model, mujoco.MjData(model)
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
        self._terms = _jacobian_terms(model, servos.joints, of_tips, self._num_servos)
        joints = model.njnt // self._hands
        self._hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        self._shares = servos.joints[: self._num_servos, :joints].T
        chains_of_hand = chains[: len(chains) // self._hands]
        carried = [np.isin(model.jnt_bodyid[:joints], list(chain)) for chain in chains_of_hand]
        self._carried = np.array(carried).reshape(-1, self._num_points, joints)

    def links(self, postures: Array) -> Links:
        """The links in postures (S, A)."""
        points, axes, anchors = self._forward(postures)
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
        """(S, F, P, 3) points of the fingers in postures (S, A) [m]."""
        points, _, _ = self._forward(postures)
        return np.moveaxis(points, 0, 2).reshape(len(postures), -1, self._num_points, 3)

    def fingertips(self, postures: Array, moving: slice = slice(None)) -> tuple[Array, Array]:
        """Tips (S, F, 3) of the fingers in postures (S, A) [m], and Jacobians (S', F, 3, A').

        They are by the A' servos of a finger's own hand, as the other's do not move it, for the
        postures `moving`, by default all.
        """
        points, axes, anchors = self._forward(postures)
        tips = points[:, :, self._num_points - 1 :: self._num_points]
        jacobian = self._jacobian(tips[:, moving], axes[:, moving], anchors[:, moving])
        return np.moveaxis(tips, 0, 2), jacobian.reshape(len(jacobian), tips.shape[2], 3, -1)

    def _jacobian(self, tips: Array, axes: Array, anchors: Array) -> Array:
        """(S, 3 F A') Jacobians of tips (3, S, F), given axes and anchors (3, S, J) of joints."""
        jacobian = np.zeros((tips.shape[1], tips.shape[2] * 3 * self._num_servos))
        for terms in self._terms:
            column = terms.share * axes[:, :, terms.joint]
            if terms.hinge:
                column = _cross(column, tips[:, :, terms.point] - anchors[:, :, terms.joint])
            if terms.repeated:
                column += jacobian[:, terms.where].swapaxes(0, 1)
            jacobian[:, terms.where] = column.swapaxes(0, 1)
        return jacobian

    def _forward(self, postures: Array) -> tuple[Array, Array, Array]:
        """(3, S, N) points, and (3, S, J) axes and anchors of joints, in postures (S, A)."""
        data, count, size = self._data, len(postures), self._num_points
        values_of_data = data.xpos, data.site_xpos, data.xaxis, data.xanchor
        rows = [np.empty((count, *values.shape)) for values in values_of_data]
        for row, qpos in enumerate(postures @ self.servos.joints):
            data.qpos = qpos
            mujoco.mj_kinematics(self._model, data)
            for target, values in zip(rows, values_of_data, strict=True):
                target[row] = values
        # An array for each of x, y and z: products of vectors take several times as long.
        bodies, sites, axes, anchors = (
            np.ascontiguousarray(values.transpose(2, 0, 1)) for values in rows
        )
        points = bodies[:, :, self._bodies]
        points[:, :, size - 1 :: size] = sites[:, :, self._tips]
        return points, axes, anchors


def _jacobian_terms(
    model: mujoco.MjModel, joints: Array, chains: list[set[int]], servos_of_hand: int
) -> list[_JacobianTerms]:
    """The terms of the Jacobian of points, each given by its `_chain`.

    `joints` (A, J) says which joints a servo moves. If several of them move a point, each gets
    terms of its own, as one assignment by index adds only one of them.
    """
    groups: dict[tuple[int, bool], list[tuple[int, int, float, int]]] = {}
    count = Counter[tuple[int, int]]()
    for joint, shares in enumerate(joints.T):
        if not shares.any():
            continue
        servo = int(np.argmax(np.abs(shares)))
        share = float(shares[servo])
        own, hinge = servo % servos_of_hand, model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        for point, chain in enumerate(chains):
            if model.jnt_bodyid[joint] in chain:
                group = groups.setdefault((count[own, point], bool(hinge)), [])
                group.append((joint, own, share, point))
                count[own, point] += 1
    result = []
    for (nth, hinge), group in sorted(groups.items()):
        which, servos, shares, points = map(np.array, zip(*group, strict=True))
        where = (3 * points + np.arange(3)[:, None]) * servos_of_hand + servos
        result.append(_JacobianTerms(which, shares, points, where, hinge, repeated=nth > 0))
    return result


def _chain(model: mujoco.MjModel, body: int) -> set[int]:
    """A body and its ancestors, without the world."""
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
