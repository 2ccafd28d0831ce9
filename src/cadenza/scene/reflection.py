"""Reflections, which map the motion of one hand to the coordinates of the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.scene.scene import Ids, Scene
from cadenza.scene.servos import Servos

_ROUNDING = 1e-6  # of axes and places [m] of exact mirror images


@dataclass(frozen=True, eq=False)
class Reflection:
    """A map from the values of one hand to those of the other.

    Positions become value[..., source] * sign + offset.
    """

    source: Ids
    sign: NDArray[np.float32]
    offset: NDArray[np.float32]

    def __call__(self, values: NDArray[Any]) -> NDArray[Any]:
        """The mirror images of positions (..., n)."""
        return values[..., self.source] * self.sign + self.offset

    def speed(self, values: NDArray[Any]) -> NDArray[Any]:
        """The mirror images of speeds (..., n)."""
        return values[..., self.source] * self.sign


def joint_reflection(scene: Scene, middle: float) -> Reflection:
    """The reflection of the J joints about the plane y = `middle` [m].

    Raises:
        CadenzaError: the scene has not two hands that are mirror images and slide, or they cannot
            slide as far along the keyboard as their images are away.
    """
    if len(scene.sides) != 2 or len(scene.slide_joints) != 2:
        raise CadenzaError("only two hands that slide along the keyboard can be mirrored")
    model, count = scene.model, len(scene.hand_joint_names)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ids = [model.joint(name).id for name in scene.hand_joint_names]
    source, axes = np.roll(np.arange(count), count // 2), data.xaxis[ids]
    slides = model.jnt_type[ids] == mujoco.mjtJoint.mjJNT_SLIDE
    # The axis of a slide is a vector, that of a hinge a pseudovector.
    image = np.where(slides[:, None], [1.0, -1.0, 1.0], [-1.0, 1.0, -1.0])
    along = (axes * (axes[source] * image)).sum(axis=1)
    if np.abs(np.abs(along) - 1).max() > _ROUNDING:
        raise CadenzaError("the hands of this scene are no mirror images of each other")
    # A forearm's slides are at right angles to each other, however it is mounted.
    on_forearm = np.isin(model.jnt_bodyid[ids], model.jnt_bodyid[ids][scene.slide_joints])
    forearm = np.flatnonzero(slides & on_forearm)
    if (np.diff(slides[on_forearm & (np.arange(count) < count // 2)].astype(int)) > 0).any():
        raise CadenzaError(
            "forearms that turn before they slide cannot be mirrored: "
            "put tx and ty first among the forearm_dofs"
        )
    away = np.array([0.0, 2 * middle, 0.0])
    offset = np.zeros(count)
    offset[forearm] = axes[forearm] @ away
    moved = offset[forearm] @ axes[forearm] / 2  # summed over two hands
    if np.abs(moved - away).max() > _ROUNDING:
        raise CadenzaError(
            "hands that do not slide along the keyboard alone cannot be mirrored about "
            f"y = {middle:.4f} m: choose attachment_yaw 0, or tx and ty among the forearm_dofs"
        )
    return Reflection(source, np.sign(along).astype(np.float32), offset.astype(np.float32))


def servo_reflection(servos: Servos, joints: Reflection) -> Reflection:
    """The reflection of the A servos, by that of the joints that they move."""
    count, moved = len(servos.names), np.abs(servos.joints).argmax(axis=1)
    source = np.roll(np.arange(count), count // 2)
    return Reflection(source, joints.sign[moved], joints.offset[moved])
