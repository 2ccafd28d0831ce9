"""The scene as MuJoCo draws it: shells of hands in place of the shapes that collide, and a case."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.hands.body import prefix
from cadenza.hands.shell import Material, Shell, bevelled, surface
from cadenza.keyboards.keyboard import Keyboard
from cadenza.scene.furniture import FLOOR, IVORY, LACQUER, floor_height, furniture
from cadenza.scene.scene import Scene, scene_spec

_COLLIDING_GROUP = 3  # which MuJoCo does not draw unless asked
_SHININESS = 0.6  # of the smoothest material
_BEVEL = 0.0012  # [m] of edges of the case and the keys
_ROOM = 6.0  # [m] half of the floor
_SHADOWED = 0.55  # [m] to either side of where the light points, that has shadows
# [m] that is drawn. MuJoCo moves shadows by a part of it, without which surfaces shade themselves.
_FARTHEST = 3000.0
# Meridians and parallels of shells, wider than so much [m] from their middle or not
_LARGE, _FINE, _COARSE = 0.028, (20, 12), (12, 8)
_BARE: dict[str, Any] = {"contype": 0, "conaffinity": 0, "mass": 0.0}

Mesh = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]


def drawn_model(scene: Scene) -> mujoco.MjModel:
    """A model with the joints and keys of a scene, in its order, that is for drawing only."""
    spec, _ = scene_spec(scene.config, scene.keyboard, scene.hand)
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
    model = spec.compile()
    model.vis.map.shadowclip = _SHADOWED / model.stat.extent
    model.vis.map.zfar = _FARTHEST / model.stat.extent
    model.vis.quality.numquads = 1  # all but boxes of notes are meshes
    return model


def key_geoms(model: mujoco.MjModel, scene: Scene) -> dict[int, int]:
    """The number of a key's geom in a drawn model -> the key."""
    keys = range(scene.keyboard.num_keys)
    return {model.geom(scene.keyboard.key_name(key)).id: key for key in keys}


def _furnish(spec: mujoco.MjSpec, keyboard: Keyboard) -> None:
    """Put the case in place of the box behind the keys, bevel the keys, and add a floor."""
    spec.geom("base").group = _COLLIDING_GROUP
    for number, piece in enumerate(furniture(keyboard)):
        name = f"case_{number}"
        _add_mesh(spec, name, bevelled(piece.half_size, min(_BEVEL, *piece.half_size) / 2))
        _add_material(spec, name, piece.material)
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name,
            pos=piece.pos, quat=piece.quat, **_BARE,
        )  # fmt: skip
    for black, material in enumerate((IVORY, LACQUER)):
        shape = keyboard.black if black else keyboard.white
        name = "black" if black else "white"
        _add_mesh(spec, name, bevelled(shape.half_size, _BEVEL))
        _add_material(spec, name, material)
    for key, black in enumerate(keyboard.is_black):
        geom = spec.geom(keyboard.key_name(key))
        geom.type = mujoco.mjtGeom.mjGEOM_MESH
        geom.meshname = geom.material = "black" if black else "white"
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, rgba=FLOOR.rgba, pos=(0, 0, floor_height(keyboard)),
        size=(_ROOM, _ROOM, _ROOM), **_BARE,
    )  # fmt: skip


def _add(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, shell: Shell) -> None:
    large = max(abs(x) + radius for x, _, _, radius in shell.balls) > _LARGE
    _add_mesh(spec, name, surface(shell.balls, *(_FINE if large else _COARSE)))
    _add_material(spec, name, shell.material)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name, **_BARE)


def _add_mesh(spec: mujoco.MjSpec, name: str, mesh: Mesh) -> None:
    vertices, normals, triangles = mesh
    spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        usernormal=normals.ravel(),
        userface=triangles.ravel(),
        userfacenormal=triangles.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
    )


def _add_material(spec: mujoco.MjSpec, name: str, look: Material) -> None:
    spec.add_material(
        name=name,
        rgba=look.rgba,
        specular=1.0 - look.roughness,
        shininess=_SHININESS * (1.0 - look.roughness),
        reflectance=0.0,
    )
