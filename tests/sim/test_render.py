"""Pictures of the scene, where this machine can draw."""

import itertools
from contextlib import closing
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cadenza.cameras import VIEWS
from cadenza.errors import CadenzaError
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.sim.render import Picture, Renderer

SHAPES = (160, 90), (90, 160), (160, 120), (120, 120)
APART = -0.05, 0.05, 0.3  # [m] that each hand is moved away from the other
DATA = Path(__file__).parents[1] / "data"


@pytest.mark.parametrize(
    ("picture", "problem"),
    [
        ({"camera": "front"}, "no camera 'front': choose from player, close, top, audience, side"),
        ({"width": 0}, "0 x 360: choose up to 1920 x 1080"),
        ({"height": 1081}, "640 x 1081: choose up to 1920 x 1080"),
    ],
)
def test_pictures_that_make_no_sense_are_refused(picture, problem):
    with pytest.raises(CadenzaError, match=problem):
        Picture(**picture)


@pytest.mark.parametrize(
    ("view", "shape"),
    [
        pytest.param(view, shape, marks=[] if j == i % 2 else [pytest.mark.slow])
        for i, view in enumerate(VIEWS)
        for j, shape in enumerate(SHAPES)
    ],
)
def test_piano_or_hands_fill_a_picture_of_any_shape(view, shape):
    scene = build_scene(SceneConfig(reduced_action_space=True))
    recorded = np.load(DATA / "episode_d.npz", allow_pickle=False)
    tips = scene.model.site_bodyid[scene.fingertip_sites]
    with closing(Renderer(scene, Picture(*shape, view))) as renderer:
        for row, apart in itertools.product((0, 70, 140), APART):
            keys, silent = recorded["key_qpos"][row], np.zeros(88, bool)
            hands = recorded["hand_qpos"][row].copy()
            hands[scene.slide_joints] += apart, -apart
            renderer.frame(hands, keys, silent, silent)
            bodies, is_floor = bodies_seen(renderer)
            for across in (0, 1):
                filled = np.flatnonzero(~is_floor.all(axis=across))
                empty = filled[0], is_floor.shape[1 - across] - 1 - filled[-1]
                assert max(empty) <= 0.1 * is_floor.shape[1 - across]
            fingers = np.isin(bodies, [*tips, *scene.palm_bodies])
            assert fingers.any()
            assert not fingers[:, [0, -1]].any()
            assert not fingers[[0, -1]].any()


def bodies_seen(renderer):
    """The body that each pixel of a picture shows, and whether it shows only floor or sky."""
    model, drawn, (width, height) = renderer._model, renderer._drawn, renderer._size
    for flag in mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR:
        drawn.flags[flag] = 1
    pixels, viewport = np.empty((height, width, 3), np.uint8), mujoco.MjrRect(0, 0, width, height)
    mujoco.mjr_render(viewport, drawn, renderer._context)
    mujoco.mjr_readPixels(pixels, None, viewport, renderer._context)
    for flag in mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR:
        drawn.flags[flag] = 0
    geoms = np.full(drawn.ngeom + 1, -1)  # the first stands for the sky
    for geom in drawn.geoms[: drawn.ngeom]:
        geoms[geom.segid + 1] = geom.objid
    seen = geoms[pixels.astype(int) @ [1, 1 << 8, 1 << 16]]
    is_floor = (seen < 0) | (model.geom_type[seen] == mujoco.mjtGeom.mjGEOM_PLANE)
    return np.where(seen < 0, -1, model.geom_bodyid[seen]), is_floor
