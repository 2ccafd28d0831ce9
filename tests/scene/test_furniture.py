"""The case of a piano, which is only drawn."""

import mujoco
import numpy as np
import pytest

from cadenza.keyboards.mini import MINI
from cadenza.keyboards.piano import PIANO
from cadenza.scene.config import SceneConfig
from cadenza.scene.drawing import drawn_model, key_geoms
from cadenza.scene.furniture import furniture
from cadenza.scene.scene import build_scene


@pytest.mark.parametrize("keyboard", [PIANO, MINI], ids=lambda keyboard: keyboard.name)
def test_keys_go_down_without_touching_the_case(keyboard):
    front = keyboard.centre + keyboard.half_size
    for piece in furniture(keyboard):
        if piece.slope:
            continue
        low, high = (np.array(piece.pos) + sign * np.array(piece.half_size) for sign in (-1, 1))
        beside = (low[1] >= front[:, 1]) | (high[1] <= (keyboard.centre - keyboard.half_size)[:, 1])
        before, below = low[0] >= front[:, 0], high[2] <= keyboard.bounds[0][2]
        behind = high[0] <= keyboard.bounds[0][0] + 0.0025  # where keys turn, and hardly move
        assert (beside | before | below | behind).all()


def test_the_case_is_around_the_whole_keyboard():
    for keyboard in (PIANO, MINI):
        ends = [abs(piece.pos[1]) + piece.half_size[1] for piece in furniture(keyboard)]
        assert keyboard.half_length < max(ends) < keyboard.half_length + 0.06


@pytest.mark.parametrize(
    "options", [{}, {"hand": "allegro", "keyboard": "mini", "hands": "right", "hand_spacing": 0}]
)
def test_what_is_only_drawn_touches_nothing(options):
    scene = build_scene(SceneConfig(**options))
    drawn = drawn_model(scene)
    keys = key_geoms(drawn, scene)
    assert sorted(keys.values()) == list(range(scene.keyboard.num_keys))
    meshes = drawn.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    meshes[list(keys)] = False
    assert not (drawn.geom_contype | drawn.geom_conaffinity)[meshes].any()
    np.testing.assert_allclose(drawn.body_mass, scene.model.body_mass)
