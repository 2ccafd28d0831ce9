"""Where the fingers are, and how they move with the servos, for many postures at once."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.hands.body import prefix
from cadenza.scene.scene import Scene
from cadenza.scene.servos import Servos

Array = NDArray[np.float64]

TIP = -1  # the last of a finger's points


class _Joint(NamedTuple):
    servo: int
    share: float  # of the servo's coordinate
    hinge: bool
    axis: Array
    anchor: Array


class Kinematics:
    """Forward kinematics of the F fingers of a scene, written over arrays of postures.

    The same as MuJoCo's, which takes one posture at a time. Joints without a servo stay at zero.
    The P points of a finger are the origins of its links, and its tip.
    """

    def __init__(self, scene: Scene, servos: Servos) -> None:
        model = scene.model
        bodies = [int(body) for body in scene.hand_bodies]
        index = {body: i for i, body in enumerate(bodies)}
        self._num_servos = len(servos.low)
        self._parent = [index.get(int(model.body_parentid[body]), -1) for body in bodies]
        self._pos = model.body_pos[bodies]
        self._rot = np.array([_matrix(quat) for quat in model.body_quat[bodies]])
        self._joints = [_joints_of(scene, servos, body) for body in bodies]
        point_body, self._point_pos = [], []
        chains = [(prefix(side), f.links) for side in scene.sides for f in scene.hand.fingers]
        for (hand, links), site in zip(chains, scene.fingertip_sites, strict=True):
            origins = [index[model.body(hand + link).id] for link in links]
            point_body += [*origins, origins[-1]]
            self._point_pos += [np.zeros(3)] * len(origins) + [model.site_pos[site].copy()]
        self._num_points = len(scene.hand.fingers[0].links) + 1
        self._point_body = point_body
        self._moved = [self._points_below(i) for i in range(len(bodies))]

    def _points_below(self, body: int) -> slice:
        """The points that move with a body: those of a finger, or of a hand, are neighbours."""
        below = []
        for point, carrier in enumerate(self._point_body):
            while carrier > body:
                carrier = self._parent[carrier]
            if carrier == body:
                below.append(point)
        return slice(below[0], below[-1] + 1) if below else slice(0, 0)

    def fingers(self, postures: Array) -> tuple[Array, Array]:
        """Points (S, F, P, 3) [m] of postures (S, A), and their Jacobian (S, F, P, 3, A)."""
        count = len(postures)
        poses: list[tuple[Array, Array]] = []
        motions = []
        for i, parent in enumerate(self._parent):
            if parent >= 0:
                rot, pos = poses[parent]
                rot, pos = rot @ self._rot[i], pos + rot @ self._pos[i]
            else:
                rot = np.broadcast_to(self._rot[i], (count, 3, 3))
                pos = np.broadcast_to(self._pos[i], (count, 3))
            for joint in self._joints[i]:
                value = joint.share * postures[:, joint.servo]
                axis = rot @ joint.axis
                centre = pos + rot @ joint.anchor
                if joint.hinge:
                    rot = rot @ _rotations(joint.axis, value)
                    pos = centre - rot @ joint.anchor
                else:
                    pos = pos + axis * value[:, None]
                motions.append((i, joint, axis, centre))
            poses.append((rot, pos))
        points = np.stack(
            [
                poses[body][1] + poses[body][0] @ pos
                for body, pos in zip(self._point_body, self._point_pos, strict=True)
            ],
            axis=1,
        )
        jacobian = np.zeros((self._num_servos, *points.shape))
        for i, joint, axis, centre in motions:
            moved = self._moved[i]
            column = jacobian[joint.servo, :, moved]
            along = joint.share * axis[:, None]
            column += _cross(along, points[:, moved] - centre[:, None]) if joint.hinge else along
        shape = (count, len(self._point_body) // self._num_points, self._num_points, 3)
        return points.reshape(shape), np.moveaxis(jacobian, 0, -1).reshape(*shape, -1)


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
            joints.append(_Joint(servo, float(shares[servo]), hinge, axis, anchor))
    return joints


def _matrix(quat: Array) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def _rotations(axis: Array, angle: Array) -> Array:
    """(S, 3, 3) rotations by angles (S,) [rad] about a unit axis: Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sin, cos = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)


def _cross(a: Array, b: Array) -> Array:
    """The cross product; NumPy's own takes several times as long."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)
