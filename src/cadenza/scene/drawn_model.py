"""The scene as MuJoCo draws it: with the shells of hands in place of the shapes that collide."""

from __future__ import annotations

import mujoco

from cadenza.hands.body import prefix
from cadenza.hands.shell import Shell, surface
from cadenza.keyboards.keyboard import Keyboard
from cadenza.scene.scene import Scene, scene_spec

_COLLIDING_GROUP = 3  # which MuJoCo does not draw unless asked
_WOOD = (0.055, 0.05, 0.055, 1.0)
_FLOOR = (0.80, 0.83, 0.87, 1.0)
_MARGIN = 0.022  # [m] of the piano's case beside its keys
_ROOM = 4.0  # [m] half of the floor
_CHEEK = 0.009  # [m] half of the width of its ends
_SHADOW_SCALE = 0.5  # part of the light's cone that has shadows, which makes them finer
_SHININESS = 0.6  # of the smoothest material


def drawn_model(scene: Scene, furniture: bool = False) -> mujoco.MjModel:
    """A model with the joints and keys of a scene, in its order, that is for drawing only.

    `furniture` adds what the simulation leaves out: a bed under the keys, ends, and a floor.
    """
    spec, _ = scene_spec(scene.config)
    if furniture:
        _furnish(spec, scene.keyboard)
    for side in scene.sides:
        for link in scene.hand.body.links:
            if not link.drawn:
                continue
            body = spec.body(prefix(side) + link.name)
            for geom in body.geoms:
                geom.group = _COLLIDING_GROUP
            for number, shell in enumerate(link.drawn):
                _add(spec, body, f"{body.name}_{number}", shell.mirrored(side))
    return spec.compile()


def key_geoms(model: mujoco.MjModel, scene: Scene) -> dict[int, int]:
    """The number of a key's geom in a drawn model -> the key."""
    keys = range(scene.keyboard.num_keys)
    return {model.geom(scene.keyboard.key_name(key)).id: key for key in keys}


def _furnish(spec: mujoco.MjSpec, keyboard: Keyboard) -> None:
    low, high = keyboard.bounds
    depth, width = (high[0] - low[0]) / 2 + 0.01, (high[1] - low[1]) / 2 + _MARGIN
    middle, bottom = (low[0] + high[0]) / 2 + 0.004, low[2]
    box, plane = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_PLANE
    bare = {"contype": 0, "conaffinity": 0}
    spec.visual.map.shadowscale = _SHADOW_SCALE
    spec.add_material(name="wood", rgba=_WOOD, specular=0.8, shininess=0.7)
    add = spec.worldbody.add_geom
    bed = (middle, 0, bottom - 0.012)
    add(type=box, material="wood", pos=bed, size=(depth, width, 0.011), **bare)
    for end in (-1, 1):
        pos = (middle, end * (width - _CHEEK), bottom + 0.018)
        add(type=box, material="wood", pos=pos, size=(depth, _CHEEK, 0.019), **bare)
    add(type=plane, rgba=_FLOOR, pos=(0, 0, bottom - 0.024), size=(_ROOM, _ROOM, 0.1), **bare)


def _add(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, shell: Shell) -> None:
    vertices, normals, triangles = surface(shell.balls)
    spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        usernormal=normals.ravel(),
        userface=triangles.ravel(),
        userfacenormal=triangles.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
    )
    look = shell.material
    spec.add_material(
        name=name,
        rgba=look.rgba,
        specular=1.0 - look.roughness,
        shininess=_SHININESS * (1.0 - look.roughness),
        reflectance=0.0,
    )
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name,
        contype=0, conaffinity=0, mass=0.0,
    )  # fmt: skip
