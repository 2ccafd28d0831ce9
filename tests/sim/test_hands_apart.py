"""Hands at pianos of their own, whose keys are combined."""

import numpy as np
from numpy.testing import assert_array_equal

from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.sim.hands_apart import HandsApart

STEPS = 150
INWARDS = 0.15  # [m], by which each hand moves from its place, so that both are at the same keys


def test_a_key_that_both_hands_press_sounds_from_the_first_to_the_last():
    scene = build_scene(SceneConfig(hands="apart"))
    simulation = HandsApart(scene)
    rng, sounds_from = np.random.default_rng(0), scene.keyboard.sounds_from
    low, high = scene.action_low[:-1], scene.action_high[:-1]
    inwards = {"rh_A_forearm_tx": -INWARDS, "lh_A_forearm_tx": INWARDS}
    forearms = [scene.actuator_names.index(name) for name in inwards]
    sounding = np.zeros(scene.keyboard.num_keys, bool)
    simulation.reset([0], scene.hand_start[None])
    shared = 0
    for step in range(STEPS):
        if step % 2 == 0:
            ctrl = rng.uniform(low, high)
            ctrl[forearms] = list(inwards.values())
        simulation.step(ctrl[None])
        state = simulation.state
        onset, offset = state.key_onset[0], state.key_offset[0]
        began = ~np.isnan(onset) & ~(onset < offset)
        ended = ~np.isnan(offset) & ~(offset < onset)
        assert not (sounding & began & np.isnan(offset)).any()
        sounding = (sounding | began) & ~ended
        assert_array_equal(sounding, state.key_qpos[0] >= sounds_from)
        assert_array_equal(np.isnan(onset), np.isnan(state.key_speed[0]))
        parts = [simulation.part(side).key_qpos[0] >= sounds_from for side in scene.sides]
        shared += int((parts[0] & parts[1]).sum())
    assert shared
