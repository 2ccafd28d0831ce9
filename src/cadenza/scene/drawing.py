"""A scene as pages draw it, without MuJoCo, and as MuJoCo does: shells of hands, and a case."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cadenza.hands.body import SHAPES, prefix
from cadenza.hands.shell import METAL, Material, Shell, as_json, bevelled, surface
from cadenza.keyboards.keyboard import Keyboard
from cadenza.scene.furniture import FLOOR, IVORY, LACQUER, CasePiece, floor_height, furniture
from cadenza.scene.scene import Scene, scene_spec

_DECIMALS = 6  # decimals of lengths [m] and quaternions


def drawing(scene: Scene) -> dict[str, Any]:
    """The visible shapes of a scene, as plain values for JSON.

    bodies: names of the B bodies of the hands, in the order of `body_poses`.
    skeleton: for each of them its parent (index, or -1 where that stands still), pos [m] and quat
        (w x y z) in the parent's frame while all joints are at 0, and its joints, one after the
        other: type (slide or hinge), axis in the body's frame, index among the J joints.
    geoms: body (index, or -1 where it stands still), type, size (MuJoCo's half sizes [m]), pos
        [m] and quat (w x y z) in the body's frame, rgba, finger (number of a fingertip, or None),
        and whether it is part of a palm, which hides keys.
    shells: drawings of bodies in place of geoms: body, finger and palm as above, and the fields of
        `hands.shell.as_json`. Metal hides little, and is no part of a palm.
    furniture: the case: boxes with size, pos, quat and material as above.
    key_materials: the materials of white and of black keys.
    keys: for each its box at rest, pos and half size [m], a point on the hinge, the
        hinge's axis, travel [rad], and whether it is black.
    """
    model = scene.model
    index = {int(body): i for i, body in enumerate(scene.hand_bodies)}
    first = scene.present_fingers.start
    tips = model.site_bodyid[scene.fingertip_sites].tolist()
    fingertip = {body: number for number, body in enumerate(tips, start=first)}
    palms = set(scene.palm_bodies.tolist())

    def part(body: int) -> dict[str, Any]:
        return {
            "body": index.get(body, -1), "finger": fingertip.get(body), "palm": body in palms
        }  # fmt: skip

    shells = [
        (model.body(prefix(side) + link.name).id, shell.mirrored(side))
        for side in scene.sides
        for link in scene.hand.body.links
        for shell in link.drawn
    ]
    keys = range(model.ngeom)[scene.key_geoms]
    covered = {body for body, _ in shells} | {model.body("base").id}
    bodies = model.geom_bodyid.tolist()
    geoms = [g for g, body in enumerate(bodies) if g not in keys and body not in covered]
    return {
        "bodies": [model.body(b).name for b in scene.hand_bodies],
        "skeleton": [_body(scene, int(b), index) for b in scene.hand_bodies],
        "geoms": [part(bodies[g]) | _shape(model, g, fixed=bodies[g] not in index) for g in geoms],
        "shells": [
            part(body) | as_json(shell) | ({"palm": False} if shell.material == METAL else {})
            for body, shell in shells
        ],
        "furniture": [_piece(piece) for piece in furniture(scene.keyboard)],
        "key_materials": [IVORY.as_json(), LACQUER.as_json()],
        "keys": [_key(scene.keyboard, k) for k in range(scene.keyboard.num_keys)],
    }


def body_poses(
    scene: Scene, hand_qpos: NDArray[Any]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Positions (T, B, 3) [m] and orientations (T, B, 4) of the hands' bodies, by joints (T, J)."""
    data = mujoco.MjData(scene.model)
    xpos = np.zeros((len(hand_qpos), len(scene.hand_bodies), 3), np.float32)
    xquat = np.zeros((len(hand_qpos), len(scene.hand_bodies), 4), np.float32)
    for t, qpos in enumerate(hand_qpos):
        data.qpos[scene.hand_qpos] = qpos
        mujoco.mj_kinematics(scene.model, data)
        xpos[t], xquat[t] = data.xpos[scene.hand_bodies], data.xquat[scene.hand_bodies]
    return xpos, xquat


def _body(scene: Scene, body: int, index: dict[int, int]) -> dict[str, Any]:
    """A body whose joints turn about its own origin, as all of the hands do."""
    model = scene.model
    first = int(model.body_jntadr[body])
    joints = range(first, first + int(model.body_jntnum[body]))
    return {
        "parent": index.get(int(model.body_parentid[body]), -1),
        "pos": _rounded(model.body_pos[body]),
        "quat": _rounded(model.body_quat[body]),
        "joints": [
            {
                "type": "slide" if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE else "hinge",
                "axis": _rounded(model.jnt_axis[j]),
                "index": int(model.jnt_qposadr[j]) - scene.hand_qpos.start,
            }
            for j in joints
        ],
    }


def _shape(model: mujoco.MjModel, g: int, fixed: bool) -> dict[str, Any]:
    name, num_sizes = SHAPES[int(model.geom_type[g])]
    pos = model.geom_pos[g] + (model.body_pos[model.geom_bodyid[g]] if fixed else 0.0)
    return {
        "type": name,
        "size": _rounded(model.geom_size[g, :num_sizes]),
        "pos": _rounded(pos),
        "quat": _rounded(model.geom_quat[g]),
        "rgba": _rounded(model.geom_rgba[g]),
    }


def _piece(piece: CasePiece) -> dict[str, Any]:
    size, pos, quat = (np.array(a) for a in (piece.half_size, piece.pos, piece.quat))
    place = {"size": _rounded(size), "pos": _rounded(pos), "quat": _rounded(quat)}
    return place | piece.material.as_json()


def _key(keyboard: Keyboard, k: int) -> dict[str, Any]:
    centre, half_size = keyboard.centre[k], keyboard.half_size[k]
    return {
        "pos": _rounded(centre),
        "size": _rounded(half_size),
        "hinge": _rounded(centre - [half_size[0], 0.0, 0.0]),
        "axis": [0.0, 1.0, 0.0],
        "travel": round(float(keyboard.travel[k]), _DECIMALS),
        "black": bool(keyboard.is_black[k]),
    }


def _rounded(values: NDArray[Any]) -> list[float]:
    """`values` to the micrometre, which keeps pages small."""
    return [round(float(value), _DECIMALS) for value in values]


_COLLIDING_GROUP = 3  # not drawn by MuJoCo by default
_SHININESS = 0.6  # shininess of the smoothest material
_BEVEL = 0.0012  # [m] of edges of the case and the keys
_ROOM = 6.0  # [m] half of the floor
_SHADOWED = 0.55  # [m] to either side of where the light points, that has shadows
# [m] that is drawn. MuJoCo moves shadows by a part of it, without which surfaces shade themselves.
_MAX_DISTANCE = 3000.0
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
    model.vis.map.zfar = _MAX_DISTANCE / model.stat.extent
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
