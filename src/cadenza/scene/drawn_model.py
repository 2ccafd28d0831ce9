"""The scene as MuJoCo draws it: with the shells of hands in place of the shapes that collide."""

from __future__ import annotations

import mujoco

from cadenza.hands.body import prefix
from cadenza.hands.shell import Shell, surface
from cadenza.scene.scene import Scene, scene_spec

_COLLIDING_GROUP = 3  # which MuJoCo does not draw unless asked
_SHININESS = 0.6  # of the smoothest material


def drawn_model(scene: Scene) -> mujoco.MjModel:
    """A model with the joints and keys of a scene, in its order, that is for drawing only."""
    spec, _ = scene_spec(scene.config)
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
