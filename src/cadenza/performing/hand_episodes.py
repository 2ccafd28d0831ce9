"""Splits the recording of hands that play apart into an episode of each hand."""

from __future__ import annotations

import numpy as np

from cadenza.episode import KEY_EVENTS, Episode
from cadenza.fingers import NO_FINGER, SIDES, Side
from cadenza.scene.drawing import body_poses, drawing
from cadenza.scene.scene import Scene, hand_alone
from cadenza.tasks.reward import key_activation


def hand_episodes(episode: Episode, scene: Scene) -> dict[Side, Episode]:
    """Returns side -> the episode of that hand in its own scene; empty if they play together."""
    apart = f"{SIDES[0]}_key_qpos" in episode.arrays
    return {side: _hand_episode(episode, scene, side) for side in scene.sides} if apart else {}


def _hand_episode(episode: Episode, scene: Scene, side: Side) -> Episode:
    alone, servos, joints = hand_alone(scene, side)
    hand, key_qpos = scene.fingers.of_hand(SIDES.index(side)), episode[f"{side}_key_qpos"]
    number = episode["goal_fingers"]
    mine = (number >= hand.start) & (number < hand.stop)
    tips = np.zeros_like(episode["fingertip_xpos"])
    tips[:, hand] = episode["fingertip_xpos"][:, hand]
    hand_qpos = episode["hand_qpos"][:, joints]
    xpos, xquat = body_poses(alone, hand_qpos)
    pedal = episode["action"].shape[1] - 1
    actions = np.r_[servos, pedal]
    arrays = {
        "action": episode["action"][:, actions],
        "action_min": episode["action_min"][actions],
        "action_max": episode["action_max"][actions],
        "actuator_names": episode["actuator_names"][servos],
        "hand_joint_names": episode["hand_joint_names"][joints],
        "hand_qpos0": episode["hand_qpos0"][joints],
        "hand_qpos": hand_qpos,
        "hand_qvel": episode["hand_qvel"][:, joints],
        "fingertip_xpos": tips,
        "key_qpos": key_qpos,
        "key_activation": key_activation(key_qpos, scene.keyboard.sounds_from),
        "sustain_activation": episode["sustain_activation"],
        "goal_keys": episode["goal_keys"] & mine,
        "goal_fingers": np.where(mine, number, np.int8(NO_FINGER)),
        "goal_sustain": episode["goal_sustain"],
        "lowest_pitch": episode["lowest_pitch"],
        "body_xpos": xpos,
        "body_xquat": xquat,
    }
    arrays |= {  # not in older recordings
        name: episode[f"{side}_{name}"] for name in KEY_EVENTS if f"{side}_{name}" in episode.arrays
    }
    return Episode(f"{episode.song} ({side} hand)", episode.dt, arrays, drawing(alone))
