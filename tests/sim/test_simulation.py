"""A batch of simulations: independent, repeatable, and robust against one that diverges."""

from __future__ import annotations

import logging
import pickle
import threading
from collections.abc import Iterator
from copy import deepcopy

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cadenza.errors import CadenzaError
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.simulation import Simulation, State

STEPS = 12


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene()


def controls(scene: Scene, num_envs: int, seed: int = 0) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(seed)
    low, high = scene.action_low[:-1], scene.action_high[:-1]
    for _ in range(STEPS):
        yield rng.uniform(low, high, (num_envs, len(low)))


def run(scene: Scene, num_envs: int, num_threads: int) -> State:
    simulation = Simulation(scene, num_envs, num_threads=num_threads)
    for ctrl in controls(scene, num_envs):
        simulation.step(ctrl)
    simulation.close()
    return simulation.state


def assert_same(a: State, b: State, rows: slice = slice(None)) -> None:
    for field, left, right in zip(State._fields, a, b, strict=True):
        assert_array_equal(left[rows], right[rows], err_msg=field)


@pytest.mark.parametrize("num_threads", [2, 3, 8])
def test_same_bits_for_any_number_of_threads(scene: Scene, num_threads: int) -> None:
    assert_same(run(scene, 5, 1), run(scene, 5, num_threads))


def test_each_simulation_is_alone(scene: Scene) -> None:
    """Row i of a batch moves as if it were the only one."""
    batch = Simulation(scene, 3)
    single = [Simulation(scene, 1) for _ in range(3)]
    for ctrl in controls(scene, 3):
        batch.step(ctrl)
        for i, simulation in enumerate(single):
            simulation.step(ctrl[i : i + 1])
    for i, simulation in enumerate(single):
        for ours, alone in zip(batch.state, simulation.state, strict=True):
            assert_array_equal(ours[i], alone[0])


def test_reset_leaves_no_trace(scene: Scene) -> None:
    used, fresh = Simulation(scene, 1), Simulation(scene, 1)
    for ctrl in controls(scene, 1, seed=1):
        used.step(ctrl)
    used.reset()
    for ctrl in controls(scene, 1):
        used.step(ctrl)
        fresh.step(ctrl)
    assert_same(used.state, fresh.state)


@pytest.mark.parametrize("num_threads", [1, 2])
def test_rollout_is_many_steps(scene: Scene, num_threads: int) -> None:
    ctrl = np.stack(list(controls(scene, 3)), axis=1)
    rolled, stepped = Simulation(scene, 3, num_threads=num_threads), Simulation(scene, 3)
    states = rolled.rollout(ctrl)
    for k in range(STEPS):
        stepped.step(ctrl[:, k])
        for ours, alone in zip(states, stepped.state, strict=True):
            assert_array_equal(ours[:, k], alone)
    assert_same(rolled.state, stepped.state)


def test_steps_only_those_asked_for(scene: Scene) -> None:
    simulation = Simulation(scene, 2)
    before = simulation.state
    simulation.step(next(controls(scene, 2)), env_ids=[1])
    assert_array_equal(simulation.state.hand_qpos[0], before.hand_qpos[0])
    assert (simulation.state.hand_qpos[1] != before.hand_qpos[1]).any()


def test_copies_the_state_of_another(scene: Scene) -> None:
    original, copies = Simulation(scene, 1), Simulation(scene, 3, control_timestep=0.01)
    for ctrl in controls(scene, 1):
        original.step(ctrl)
    copies.copy_from(original, 0)
    for i in range(3):
        assert_array_equal(copies.state.hand_qpos[i], original.state.hand_qpos[0])
    ctrl = next(controls(scene, 1, seed=5))
    original.step(ctrl)
    for _ in range(5):
        copies.step(np.tile(ctrl, (3, 1)))
    assert_array_equal(copies.state.key_qpos[2], original.state.key_qpos[0])


@pytest.mark.parametrize("sleeping", [False, True])
def test_another_scene_goes_on_from_a_physics_state(sleeping: bool) -> None:
    """To the bit where keys never sleep, and closely where they did."""
    waking = build_scene(SceneConfig(sleeping_keys=False))
    original = Simulation(build_scene(SceneConfig(sleeping_keys=sleeping)))
    for ctrl in controls(waking, 1):
        original.step(ctrl)
    others = Simulation(waking, 2)
    others.set_physics_state(original.physics_state(0))
    for ctrl in list(controls(waking, 1, seed=5))[:2]:
        original.step(ctrl)
        others.step(np.tile(ctrl, (2, 1)))
    for expected, found in zip(original.state, others.state, strict=True):
        np.testing.assert_allclose(found[1], expected[0], rtol=0, atol=1e-3 * sleeping)


def test_coordinates_are_those_of_keys_and_hands(scene: Scene) -> None:
    simulation = Simulation(scene, 2)
    for ctrl in controls(scene, 2):
        simulation.step(ctrl)
    positions, velocities = np.split(simulation.coordinates(), 2, axis=1)
    assert_array_equal(positions[:, scene.key_qpos], simulation.state.key_qpos)
    assert_array_equal(positions[:, scene.hand_qpos], simulation.state.hand_qpos)
    assert_array_equal(velocities[:, scene.hand_qvel], simulation.state.hand_qvel)


@pytest.mark.parametrize("num_threads", [1, 2])
def test_a_diverging_simulation_is_counted_and_harms_no_other(
    scene: Scene, num_threads: int, caplog: pytest.LogCaptureFixture
) -> None:
    healthy = run(scene, 3, 1)
    simulation = Simulation(scene, 3, num_threads=num_threads)
    with caplog.at_level(logging.WARNING):
        for step, ctrl in enumerate(controls(scene, 3)):
            if step == 5:
                simulation._data[1].qvel[:] = 1e12
            simulation.step(ctrl)
    assert_array_equal(simulation.state.unstable, [False, True, False])
    assert simulation.num_unstable == 1
    assert [r.message for r in caplog.records if "simulation 1 became unstable" in r.message]
    assert_same(simulation.state, healthy, slice(0, None, 2))
    assert np.isfinite(simulation.state.hand_qpos).all()
    simulation.reset([1])
    assert not simulation.state.unstable.any()
    assert simulation.num_unstable == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs 0: choose 1 to"),
        ({"num_threads": 0}, "num_threads 0: choose 1 to"),
        ({"control_timestep": 0.012}, "not a multiple"),
        ({"control_timestep": 0.0}, "not a multiple"),
    ],
)
def test_says_what_is_wrong(scene: Scene, options: dict, message: str) -> None:
    with pytest.raises(CadenzaError, match=message):
        Simulation(scene, **options)


def test_a_copy_that_is_made_while_another_thread_steps(scene: Scene) -> None:
    simulation, done = Simulation(scene, 2), threading.Event()
    ctrl = np.zeros((2, len(scene.action_low) - 1))

    def step() -> None:
        while not done.is_set():
            simulation.step(ctrl)

    thread = threading.Thread(target=step)
    thread.start()
    try:
        for _ in range(20):
            deepcopy(simulation).step(ctrl)
            pickle.loads(pickle.dumps(simulation)).step(ctrl)
    finally:
        done.set()
        thread.join()
