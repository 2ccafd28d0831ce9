"""A batch of simulations, robust, and of hands at pianos of their own."""

import logging

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from random_controls import assert_same, controls

from cadenza.errors import CadenzaError
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.sim.hands_apart import HandsApart
from cadenza.sim.key_crossings import dense_key_events, last_key_events
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.planning_simulation import PlanningSimulation


@pytest.mark.parametrize("num_threads", [1, 2])
def test_a_diverging_simulation_is_reported_once_and_harms_no_other(scene, num_threads, caplog):
    healthy = MujocoSimulation(scene, 3)
    simulation = PlanningSimulation(scene, 3, num_threads=num_threads)
    far_away = np.full((1, len(scene.hand_joint_names)), 1e9)  # [m, rad]
    with caplog.at_level(logging.WARNING):
        for step, ctrl in enumerate(controls(scene, 3)):
            if step == 5:
                simulation.reset([1], far_away)
            simulation.step(ctrl)
            healthy.step(ctrl)
    assert_array_equal(simulation.state.unstable, [False, True, False])
    logged = [r.message for r in caplog.records if "became unstable" in r.message]
    assert logged == ["simulation 1 became unstable"]
    assert_same(simulation.state, healthy.state, slice(0, None, 2))
    assert np.isfinite(simulation.state.hand_qpos).all()
    simulation.reset([1])
    assert not simulation.state.unstable.any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs 0: choose 1 to"),
        ({"num_threads": 0}, "num_threads 0: choose 1 to"),
        ({"control_timestep": 0.012}, "not a multiple"),
        ({"control_timestep": 0.0}, "not a multiple"),
    ],
)
def test_says_what_is_wrong(scene, options, message):
    with pytest.raises(CadenzaError, match=message):
        MujocoSimulation(scene, **options)


def test_dense_events_are_the_last_ones():
    """Keys that rest, that cross once, and that cross many times in a step."""
    rng = np.random.default_rng(0)
    paths = rng.uniform(0.0, 1.0, (50, 11, 3)) * [0.0, 1.0, 0.52]
    sounds_from = np.array([0.5, 0.5, 0.5])
    sparse = last_key_events(paths, sounds_from, 0.005)
    for ours, theirs in zip(dense_key_events(paths, sounds_from, 0.005), sparse, strict=True):
        assert_array_equal(ours, theirs)
        assert 0 < np.isnan(theirs[:, 2]).sum() < 50


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
