"""What is drawn of a hand: shells, each the convex hull of a few balls, in a few materials.

Shells have neither mass nor contacts. Pages and films draw them in place of the shapes that
collide.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.fingers import Side

Ball = tuple[float, float, float, float]  # the centre x, y, z and the radius of a ball [m]


@dataclass(frozen=True)
class Material:
    """The look of a surface: its colour, and how rough and how metallic it is, from 0 to 1."""

    rgba: tuple[float, float, float, float]
    roughness: float
    metalness: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """What a page needs to draw it."""
        return asdict(self) | {"rgba": list(self.rgba)}


COVER = Material((0.86, 0.85, 0.82, 1.0), 0.38)
"""Glossy ivory plastic, which palms and fingers are covered with."""
METAL = Material((0.42, 0.44, 0.48, 1.0), 0.32, 0.75)  # anodised metal of joints
RUBBER = Material((0.15, 0.16, 0.18, 1.0), 0.85)
"""The soft skin of fingertips, dark so that it is seen on white keys."""
SLEEVE = Material((0.19, 0.22, 0.28, 1.0), 0.5, 0.1)  # forearms and arms
TRIM = Material((0.72, 0.55, 0.38, 1.0), 0.3, 0.85)  # brushed bronze, for edges


@dataclass(frozen=True)
class Shell:
    """The convex hull of `balls` in the frame of a link, made of a `material`."""

    balls: tuple[Ball, ...]
    material: Material = COVER

    def mirrored(self, side: Side) -> Shell:
        """The shell of a right hand, or its mirror image for the left."""
        if side == "right":
            return self
        return Shell(tuple((-x, y, z, r) for x, y, z, r in self.balls), self.material)


def across(width: float, z: float, radius: float, y: float = 0.0) -> tuple[Ball, Ball]:
    """Two balls side by side, at x = -`width` and `width` [m]."""
    return (-width, y, z, radius), (width, y, z, radius)


def ring(
    radius: float, z: float, thickness: float, y: float = 0.0, width: float = 0.0
) -> tuple[Ball, ...]:
    """Balls that make a disc across z, with an edge rounded by half of its thickness [m].

    It reaches further by `width` to either side, along x.
    """
    inner = radius - thickness
    turns = np.linspace(0, 2 * np.pi, _RING, endpoint=False) + np.pi / _RING
    return tuple(
        (float(inner * np.cos(t) + np.copysign(width, np.cos(t))), float(y + inner * np.sin(t)),
         z, thickness)
        for t in turns
    )  # fmt: skip


def rounded_box(
    half_size: tuple[float, float, float], pos: tuple[float, float, float], radius: float
) -> tuple[Ball, ...]:
    """Balls in the corners of a box, which round its edges with a `radius` [m]."""
    corners = product(
        *((p - h + radius, p + h - radius) for p, h in zip(pos, half_size, strict=True))
    )
    return tuple((x, y, z, radius) for x, y, z in corners)


_RING = 16  # balls of a disc


def bevelled(
    half_size: tuple[float, float, float], bevel: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """A box whose edges are cut off as a mesh: vertices (24, 3) [m], normals (24, 3), triangles.

    Each corner has a vertex on each of its three faces, with the normal of that face. So the faces
    look flat and the edges round.
    """
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    normals = corners[:, None] * np.eye(3)  # (corner, face, 3)
    vertices = (corners[:, None] * (np.array(half_size) - bevel) + bevel * normals).reshape(-1, 3)
    triangles = [(3 * c, 3 * c + 1, 3 * c + 2) for c in range(8)]
    for axis, step in enumerate((4, 2, 1)):  # from a corner to the next along the axis
        one, other = (a for a in range(3) if a != axis)
        for c in (c for c in range(8) if not c & step):  # where edges along the axis begin
            d = c + step
            triangles += [(3 * c + one, 3 * d + one, 3 * d + other)]
            triangles += [(3 * c + one, 3 * d + other, 3 * c + other)]
        for c in (0, step):
            p, q = (s for s in (4, 2, 1) if s != step)
            e, f, g, h = (3 * corner + axis for corner in (c, c + p, c + p + q, c + q))
            triangles += [(e, f, g), (e, g, h)]
    faces = np.array(triangles)
    x, y, z = vertices[faces].transpose(1, 0, 2)
    inwards = np.einsum("ij,ij->i", np.cross(y - x, z - x), x + y + z) < 0
    faces[inwards] = faces[inwards, ::-1]
    return vertices, normals.reshape(-1, 3), faces.astype(np.int32)


def surface(
    balls: Iterable[Ball], meridians: int, parallels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """The convex hull of balls as a mesh: vertices (V, 3) [m], normals (V, 3), triangles (F, 3).

    For each direction of a globe's grid, the vertex is the point of the hull that lies farthest in
    that direction, and the direction is the normal there.
    """
    x, y, z, radius = np.array(list(balls)).T
    centre = np.stack([x, y, z], axis=1)
    polar = np.linspace(0.0, np.pi, parallels + 1)[:, None]
    turn = np.linspace(0.0, 2 * np.pi, meridians, endpoint=False)[None]
    sine = np.abs(np.sin(polar).round(9))  # 0 at both poles, so that flat ends are closed
    normals = np.stack(
        np.broadcast_arrays(sine * np.cos(turn), sine * np.sin(turn), np.cos(polar) + 0 * turn),
        axis=-1,
    ).reshape(-1, 3)
    farthest = np.argmax(normals @ centre.T + radius, axis=1)
    vertices = centre[farthest] + radius[farthest, None] * normals
    row, column = np.divmod(np.arange(parallels * meridians), meridians)
    right = row * meridians + (column + 1) % meridians
    here = row * meridians + column
    below = (row + 1) * meridians + column
    diagonal = right + meridians
    triangles = np.concatenate(
        [np.stack([here, below, diagonal], axis=1), np.stack([here, diagonal, right], axis=1)]
    )
    return vertices, normals, triangles.astype(np.int32)


def as_json(shell: Shell) -> dict[str, Any]:
    """What a page needs to draw a shell."""
    balls = [[round(value, _DECIMALS) for value in ball] for ball in shell.balls]
    return {"balls": balls} | shell.material.as_json()


_DECIMALS = 5  # decimals of lengths [m]
