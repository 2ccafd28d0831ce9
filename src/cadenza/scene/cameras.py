"""Cameras and light of the scene.

`CAMERAS` are the published scene's (robopianist 1.0.10), fixed where they are.
"""

import mujoco

# name: position [m], orientation (w, x, y, z), vertical field of view [degree]
CAMERAS = {
    "closeup": ((-0.313, 0.024, 0.455), (0.6348, 0.3140, -0.3130, -0.6329), 45.0),
    "left": ((0.393, -0.791, 0.638), (0.8660, 0.3925, 0.1279, 0.2821), 45.0),
    "right": ((0.472, 0.598, 0.58), (0.3883, 0.1753, 0.3723, 0.8246), 45.0),
    "back": ((-0.569, 0.008, 0.841), (0.6647, 0.2319, -0.2339, -0.6706), 45.0),
    "egocentric": ((0.417, -0.039, 0.717), (0.6825, 0.1821, 0.1824, 0.6839), 45.0),
    "topdown": ((0.0, 0.0, 1.0), (0.7071, 0.0, 0.0, 0.7071), 33.9496),
}
MAX_WIDTH, MAX_HEIGHT = 1920, 1080  # [px] of a picture

_LIGHT = (0.62, 0.4, 1.6)  # [m]; it points at the keys


def add_cameras(spec: mujoco.MjSpec) -> None:
    """Add the cameras, a light and a plain background."""
    world = spec.worldbody
    for name, (pos, quat, fovy) in CAMERAS.items():
        world.add_camera(name=name, pos=pos, quat=quat, fovy=fovy)
    world.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=_LIGHT, dir=(-0.35, -0.25, -1.0),
        diffuse=(0.60, 0.59, 0.57), specular=(0.5, 0.5, 0.5),
    )  # fmt: skip
    spec.visual.headlight.ambient = (0.38, 0.39, 0.41)
    spec.visual.headlight.diffuse = (0.13, 0.13, 0.14)
    spec.visual.headlight.specular = (0.15, 0.15, 0.15)
    spec.visual.quality.shadowsize = 1024
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
