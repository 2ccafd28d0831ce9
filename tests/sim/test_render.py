"""Pictures of the scene, where this machine can draw."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.scene.cameras import camera_on, eye_of
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.render import Picture


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene()


@pytest.mark.parametrize("aspect", [16 / 9, 1, 9 / 16])
@pytest.mark.parametrize("elevation", [0.3, 0.8, 1.4])
def test_a_camera_sees_all_of_a_box_and_comes_as_near_as_that_allows(
    scene: Scene, elevation: float, aspect: float
) -> None:
    """By MuJoCo's own camera."""
    box = np.array([[-0.3, -0.2, 0.0], [0.2, 0.5, 0.1]])
    corners = np.array(list(itertools.product(*box.T)))
    drawn, data = mujoco.MjvScene(scene.model, maxgeom=1000), mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    camera = camera_on(corners, elevation, aspect)
    mujoco.mjv_updateScene(
        scene.model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, drawn
    )
    eye, forward, up = np.zeros(3), np.zeros(3), np.zeros(3)
    mujoco.mjv_cameraInModel(eye, forward, up, drawn)
    np.testing.assert_allclose(eye_of(camera), eye, atol=1e-6)
    slope = np.tan(np.deg2rad(scene.model.vis.global_.fovy) / 2)
    depth = (corners - eye) @ forward
    upwards = np.abs((corners - eye) @ up) / (depth * slope)
    across = np.abs((corners - eye) @ np.cross(forward, up)) / (depth * slope * aspect)
    assert max(upwards.max(), across.max()) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("picture", "problem"),
    [
        ({"camera": "front"}, "no camera 'front': choose from closeup"),
        ({"width": 0}, "0 x 360: choose up to 1920 x 1080"),
        ({"height": 1081}, "640 x 1081: choose up to 1920 x 1080"),
    ],
)
def test_pictures_that_make_no_sense_are_refused(picture: dict, problem: str) -> None:
    with pytest.raises(CadenzaError, match=problem):
        Picture(**picture)
