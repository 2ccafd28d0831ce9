"""Ranges of joints and actions that a song needs, to normalise a policy's joints and actions.

The forearms of the hands slide along 1.2 m of rails, a key is 2 cm wide, and a tune rarely spans
more than a third of the keyboard. Normalised to the whole keyboard, random actions hardly ever
land where the song is, and neighbouring keys are hard to tell from each other. Fingers and wrists
that may go anywhere brush keys beside theirs; kept near their rest, they learn in fewer steps.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.keyboards.piano import PIANO
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.servos import servos_of
from cadenza.tasks.augmentation import draws_pitch
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import to_range

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

_MARGIN = 0.05  # [m] on either side, at a piano: hands turn and fingers spread
_ALONG_KEYBOARD = 1  # axis y


class Ranges(NamedTuple):
    """Least and largest joint positions and actions, which become -1 and 1."""

    joints: Array  # (2, J) [m, rad]
    actions: Array  # (2, A) [m, rad], the pedal last

    def ctrl(self, action: Floats) -> Array:
        """Actions (N, A) in actuator units from those in [-1, 1], which are clipped."""
        return to_range(action, *self.actions)

    def scaled(self, joints: Floats) -> Floats:
        """Joint positions (..., J) normalised to [-1, 1], beyond it where out of range."""
        low, high = self.joints.astype(np.float32)
        return (joints - (high + low) / 2) / ((high - low) / 2)


def ranges_of(task: PianoTask) -> Ranges:
    """The ranges of a task with hands: fingers near their rest, forearms where scores need them."""
    scene, servos = task.scene, servos_of(task.scene)
    joints = np.array([scene.model.joint(name).range for name in scene.hand_joint_names]).T
    actions = np.stack([task.spec.action_low, task.spec.action_high])
    keys = _keys_of_fingers(task)
    rest, travel = np.array([(s.rest, s.travel) for s in map(scene.hand.servo, servos.names)]).T
    near = np.isfinite(travel)
    actions[:, :-1] = np.clip((rest - travel, rest + travel), *actions[:, :-1])
    moved = servos.joints[near].any(axis=0)
    joints[:, moved] = (actions[:, :-1][:, near] @ servos.joints[near])[:, moved]
    fingertips = Kinematics(scene).fingertips(np.where(near, rest, 0.0)[None])
    tips, jacobian = (values[0, :, _ALONG_KEYBOARD] for values in fingertips)
    margin = _MARGIN * scene.keyboard.spacing / PIANO.spacing
    slides = servos.along_keyboard
    for side, servo in zip(scene.sides, slides, strict=bool(slides)):
        own = scene.fingertips_on(side)
        along = jacobian[own, servo - scene.servos_on(side).start]
        finger, key = np.nonzero(keys[own])
        centre = scene.keyboard.centre[key, _ALONG_KEYBOARD]
        places = (centre - tips[own][finger]) / along[finger]
        places = places if len(places) else np.zeros(1)  # it may rest
        ends = np.array([places.min() - margin, places.max() + margin])
        actions[:, servo] = np.clip(ends, *actions[:, servo])
        joints[:, np.flatnonzero(servos.joints[servo])] = actions[:, servo, None]
    return Ranges(joints, actions)


def _keys_of_fingers(task: PianoTask) -> NDArray[np.bool_]:
    """Whether (F, K) any score asks for a key from a finger, or from no finger in particular."""
    there = task.scene.present_fingers
    numbers = range(there.start, there.stop)
    keys = np.full((len(numbers), task.scene.keyboard.num_keys), draws_pitch(task.config))
    for track in task.tracks:
        goals = track.goals
        anyone = goals.keys & ~task.scene.has_fingers(goals.fingers)
        for finger, number in enumerate(numbers):
            keys[finger] |= ((goals.fingers == number) | anyone).any(axis=0)
    return keys
