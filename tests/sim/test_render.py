"""Pictures of the scene, where this machine can draw."""

from __future__ import annotations

from contextlib import closing

import mujoco
import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.keyboards.mini import MINI
from cadenza.keyboards.piano import PIANO
from cadenza.scene.cameras import player_camera
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.render import Picture, Renderer


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene()


def drawn(scene: Scene, picture: Picture, keys: tuple[int, int], sounding: int) -> np.ndarray:
    """The picture of hands at rest, with one key that rightly sounds."""
    lit = np.arange(88) == sounding
    try:
        renderer = Renderer(scene, picture, keys)
    except CadenzaError as error:
        pytest.skip(str(error))
    with closing(renderer):
        joints = np.zeros(len(scene.hand_joint_names))
        return renderer.frame(joints, np.zeros(88), lit, lit).astype(int)


@pytest.mark.parametrize("aspect", [16 / 9, 1, 9 / 16])
@pytest.mark.parametrize("keys", [(39, 39), (0, 87), (60, 70), (0, 5)])
def test_the_player_sees_all_keys_of_the_song(
    scene: Scene, keys: tuple[int, int], aspect: float
) -> None:
    """By MuJoCo's own camera."""
    drawn = mujoco.MjvScene(scene.model, maxgeom=1000)
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    camera = player_camera(scene.keyboard, keys, aspect)
    mujoco.mjv_updateScene(
        scene.model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, drawn
    )
    eye, forward, up = np.zeros(3), np.zeros(3), np.zeros(3)
    mujoco.mjv_cameraInModel(eye, forward, up, drawn)
    slope = np.tan(np.deg2rad(scene.model.vis.global_.fovy) / 2)
    for key in keys:
        corners = PIANO.centre[key] + PIANO.half_size[key] * np.array([[1, 1, 1], [-1, -1, -1]])
        depth = (corners - eye) @ forward
        assert (np.abs((corners - eye) @ up) <= depth * slope).all()
        assert (np.abs((corners - eye) @ np.cross(forward, up)) <= depth * slope * aspect).all()
    assert camera.distance < 3


def test_the_player_sees_as_much_behind_the_keys_of_any_keyboard() -> None:
    camera = player_camera(PIANO, (0, 87), 16 / 9)
    assert list(camera.lookat) == [pytest.approx(0.03), pytest.approx(0, abs=1e-3), 0.01125]
    shorter = player_camera(MINI, (0, 24), 16 / 9)
    behind = [k.white.centre_x - k.white.half_size[0] for k in (PIANO, MINI)]
    assert shorter.lookat[0] - camera.lookat[0] == pytest.approx((behind[1] - behind[0]) / 2)


def test_the_player_sees_a_key_through_the_palm(scene: Scene) -> None:
    under_the_right_palm = int(np.abs(PIANO.centre[:, 1] - 0.15).argmin())
    picture = Picture(320, 180, "player")
    lit, unlit = (drawn(scene, picture, (30, 60), key) for key in (under_the_right_palm, 3))
    changed = np.argwhere(np.abs(lit - unlit).max(axis=2) > 25)
    assert np.ptp(changed[:, 0]) > 0.25 * picture.height  # almost all of the key's length


@pytest.mark.parametrize(
    ("picture", "problem"),
    [
        ({"camera": "front"}, "no camera 'front': choose from player, closeup"),
        ({"width": 0}, "0 x 360: choose up to 1920 x 1080"),
        ({"height": 1081}, "640 x 1081: choose up to 1920 x 1080"),
    ],
)
def test_pictures_that_make_no_sense_are_refused(picture: dict, problem: str) -> None:
    with pytest.raises(CadenzaError, match=problem):
        Picture(**picture)
