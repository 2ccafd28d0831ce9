"""What is drawn of hands."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from cadenza.hands.shell import Shell, across, bevelled, ring, rounded_box, surface

HULLS = {
    "rod": across(0.02, 0.01, 0.008),
    "disc": ring(0.04, 0.0, 0.006),
    "box": rounded_box((0.02, 0.03, 0.04), (0.01, 0.0, 0.0), 0.004),
    "cone": ((0.0, 0.0, 0.0, 0.02), (0.0, 0.0, 0.06, 0.008)),
}


def points_of(balls: tuple[tuple[float, float, float, float], ...]) -> np.ndarray:
    """Points on the balls, at random."""
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.concatenate([np.array(ball[:3]) + ball[3] * directions for ball in balls])


@pytest.mark.parametrize("name", HULLS)
def test_a_surface_is_that_of_the_convex_hull(name):
    balls = HULLS[name]
    vertices, normals, triangles = surface(balls, meridians=48, parallels=32)
    hull = ConvexHull(points_of(balls))
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(hull.volume, rel=0.15)  # turned outwards, so not negative
    outside = hull.equations[:, :3] @ vertices.T + hull.equations[:, 3:]
    assert outside.max() < 2e-4
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)


def test_a_bevelled_box_is_the_hull_of_its_corners():
    vertices, normals, triangles = bevelled((0.02, 0.03, 0.04), 0.004)
    hull = ConvexHull(vertices)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    assert np.einsum("ij,ij->i", a, across).sum() / 6 == pytest.approx(hull.volume)
    assert np.linalg.norm(across, axis=1).sum() / 2 == pytest.approx(hull.area)
    assert (vertices * normals).sum(axis=1) == pytest.approx(np.abs(normals) @ [0.02, 0.03, 0.04])
    assert np.abs(vertices).max(axis=0) == pytest.approx([0.02, 0.03, 0.04])


def test_the_left_shell_is_the_mirror_image():
    shell = Shell(((0.01, 0.02, 0.03, 0.004),))
    assert shell.mirrored("right") == shell
    assert shell.mirrored("left").balls == ((-0.01, 0.02, 0.03, 0.004),)
