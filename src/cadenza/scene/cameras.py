"""Cameras and light of the scene.

`CAMERAS` are the published scene's (robopianist 1.0.10), fixed where they are. The player's camera
is Cadenza's own: it comes as near as the keys of a song allow.
"""

from __future__ import annotations

import itertools

import mujoco
import numpy as np

from cadenza.keyboards.keyboard import Keyboard

# name: position [m], orientation (w, x, y, z), vertical field of view [degree]
CAMERAS = {
    "closeup": ((-0.313, 0.024, 0.455), (0.6348, 0.3140, -0.3130, -0.6329), 45.0),
    "left": ((0.393, -0.791, 0.638), (0.8660, 0.3925, 0.1279, 0.2821), 45.0),
    "right": ((0.472, 0.598, 0.58), (0.3883, 0.1753, 0.3723, 0.8246), 45.0),
    "back": ((-0.569, 0.008, 0.841), (0.6647, 0.2319, -0.2339, -0.6706), 45.0),
    "egocentric": ((0.417, -0.039, 0.717), (0.6825, 0.1821, 0.1824, 0.6839), 45.0),
    "topdown": ((0.0, 0.0, 1.0), (0.7071, 0.0, 0.0, 0.7071), 33.9496),
}
PLAYER = "player"
MAX_WIDTH, MAX_HEIGHT = 1920, 1080  # [px] of a picture

_ELEVATION = np.deg2rad(62.0)  # of the player's camera over the keys
_FOVY = np.deg2rad(45.0)  # MuJoCo's for cameras that are not fixed
_BESIDE_KEYS = 0.06  # [m] in view on either side of a song's keys
_BEHIND_KEYS = 0.065  # [m] in view
_WRISTS_X = 0.2  # [m] end of the view


def player_camera(keyboard: Keyboard, keys: tuple[int, int], aspect: float) -> mujoco.MjvCamera:
    """The camera over the player's head, at which a song's keys and the hands fill the view.

    Args:
        keyboard: the keyboard.
        keys: the lowest and the highest key of the song.
        aspect: width of the picture over its height.
    """
    left, right = keyboard.centre[list(keys), 1] + np.array([-_BESIDE_KEYS, _BESIDE_KEYS])
    back = keyboard.white.centre_x - keyboard.white.half_size[0] - _BEHIND_KEYS
    centre = np.array([(back + _WRISTS_X) / 2, (left + right) / 2, keyboard.white.centre_z])
    towards = np.array([np.cos(_ELEVATION), 0.0, np.sin(_ELEVATION)])
    up = np.array([-np.sin(_ELEVATION), 0.0, np.cos(_ELEVATION)])
    sides = ((back, _WRISTS_X), (left, right), (0.0, keyboard.black.top))
    corners = np.array(list(itertools.product(*sides)))
    across, upwards, nearer = np.stack([[0, 1, 0], up, towards]) @ (corners - centre).T
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation = 180.0, -np.rad2deg(_ELEVATION)
    camera.lookat[:] = centre
    slope = np.tan(_FOVY / 2)
    distance = np.maximum(np.abs(across) / aspect, np.abs(upwards)) / slope
    camera.distance = float(np.max(nearer + distance))
    return camera


def add_cameras(spec: mujoco.MjSpec) -> None:
    """Adds the cameras, a light and a plain background."""
    world = spec.worldbody
    for name, (pos, quat, fovy) in CAMERAS.items():
        world.add_camera(name=name, pos=pos, quat=quat, fovy=fovy)
    world.add_light(pos=(0.5, 0.3, 1.6), dir=(-0.3, -0.2, -1.0), diffuse=(0.55, 0.55, 0.55))
    spec.visual.headlight.ambient = (0.35, 0.35, 0.35)
    spec.visual.headlight.diffuse = (0.25, 0.25, 0.25)
    spec.visual.quality.shadowsize = 2048
    spec.visual.global_.offwidth, spec.visual.global_.offheight = MAX_WIDTH, MAX_HEIGHT
    spec.add_texture(
        name="background",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.93, 0.94, 0.96),
        rgb2=(0.62, 0.66, 0.72),
        width=64,
        height=64,
    )
