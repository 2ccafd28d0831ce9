"""The mirror image of steps: each hand does what the other did, about D4.

Bodies of the hands are exact mirror images. Keys are not: a black key stands half a millimetre to
the right of the gap that it covers, and so up to a millimetre beside its mirror image. So the image
is exact for hands in the air, and nearly so where they touch keys; an episode that is to be exact
is played mirrored.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.demonstrations.dataset import Array, Batch
from cadenza.errors import CadenzaError
from cadenza.fingers import NO_FINGER
from cadenza.music.score import MIRROR
from cadenza.scene.reflection import joint_reflection, servo_reflection
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of


class Mirror:
    """Mirrors steps of a scene with two hands that slide along the keyboard."""

    def __init__(self, scene: Scene) -> None:
        """Raises a CadenzaError if the scene has no mirror image."""
        pitches = scene.keyboard.pitches
        if MIRROR // 2 not in pitches:
            raise CadenzaError(
                f"a keyboard without a key of pitch {MIRROR // 2} has no mirror image"
            )
        middle = pitches.index(MIRROR // 2)
        self._about = float(scene.keyboard.centre[middle, 1])
        self._keys = 2 * middle - np.arange(scene.keyboard.num_keys)
        self._has_key = (self._keys >= 0) & (self._keys < scene.keyboard.num_keys)
        self.joints = joint_reflection(scene, self._about)
        self.servos = servo_reflection(servos_of(scene), self.joints)
        fingers = scene.fingers
        self._fingers = np.roll(np.arange(fingers.count), fingers.per_hand)

    def possible(self, batch: Batch) -> NDArray[np.bool_]:
        """Returns the steps (B,) whose keys, to press and held down, all have an image."""
        keys = batch.goal[..., :-1].any(axis=1) | batch.sounding
        return np.logical_not((keys & ~self._has_key).any(axis=1))

    def __call__(self, batch: Batch) -> Batch:
        """Returns the image of all steps; see `possible`."""
        fingers = batch.fingers[..., self._fingers]
        image = np.where(fingers == NO_FINGER, NO_FINGER, self._keys[fingers])
        return Batch(
            hand_qpos=self.joints(batch.hand_qpos),
            hand_qvel=self.joints.speed(batch.hand_qvel),
            fingertip_xpos=self.points(batch.fingertip_xpos),
            key_state=np.where(self._has_key, self._keys_image(batch.key_state), batch.key_state),
            pedal=batch.pedal,
            sounding=self._keys_image(batch.sounding),
            previous_action=self.actions(batch.previous_action),
            previous_reward=batch.previous_reward,
            action=self.actions(batch.action),
            tracked=self.servos(batch.tracked),
            goal=np.concatenate(
                [self._keys_image(batch.goal[..., :-1]), batch.goal[..., -1:]], axis=-1
            ),
            fingers=np.where(image < 0, NO_FINGER, image).astype(np.int8),
            reference=np.stack(
                [
                    self.servos(batch.reference[..., 0]),
                    self.servos.speed(batch.reference[..., 1]),
                ],
                axis=-1,
            ),
            reference_fingertips=self.points(batch.reference_fingertips),
        )

    def actions(self, actions: Array) -> Array:
        """Returns the image of actions (..., A + 1) in actuator units, the pedal last."""
        return np.concatenate([self.servos(actions[..., :-1]), actions[..., -1:]], axis=-1)

    def points(self, points: Array) -> Array:
        """Returns the image of a point of each finger (..., F, 3) [m]."""
        image = points[..., self._fingers, :].copy()
        image[..., 1] = 2 * self._about - image[..., 1]
        return image

    def _keys_image(self, values: Array) -> Array:
        there = np.where(self._has_key, self._keys, 0)
        return np.where(self._has_key, values[..., there], values.dtype.type(0))
