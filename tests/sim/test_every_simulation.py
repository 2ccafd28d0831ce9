"""What every simulation on the CPU keeps to: also with models of their own, and of hands apart."""

from copy import deepcopy

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from random_controls import assert_same, controls, drawn

from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.hands_apart import HandsApart
from cadenza.sim.mujoco_simulation import MujocoSimulation


@pytest.fixture(scope="module", params=["nominal", "randomized", "apart"])
def kind(request):
    hands = "apart" if request.param == "apart" else "both"
    return request.param, build_scene(SceneConfig(hands=hands))


def made(
    kind: tuple[str, Scene], *seeds: int, num_threads: int = 1
) -> MujocoSimulation | HandsApart:
    """A simulation for each of the seeds, from which their models follow if they differ."""
    name, scene = kind
    make = HandsApart if name == "apart" else MujocoSimulation
    simulation = make(scene, num_envs=len(seeds), num_threads=num_threads)
    for env, seed in enumerate(seeds if name == "randomized" else ()):
        simulation.randomize(env, drawn(scene, seed))
    simulation.reset(range(len(seeds)), np.tile(scene.hand_start, (len(seeds), 1)))
    return simulation


class TestSimulation:
    @pytest.mark.parametrize("num_threads", [2, 3, 8])
    def test_same_bits_for_any_number_of_threads_and_alone(self, kind, num_threads):
        """Row i of a batch moves as if it were the only one."""
        seeds = range(5)
        one, several = made(kind, *seeds), made(kind, *seeds, num_threads=num_threads)
        single = [made(kind, seed) for seed in seeds]
        for ctrl in controls(kind[1], len(seeds)):
            one.step(ctrl)
            several.step(ctrl)
            for i, simulation in enumerate(single):
                simulation.step(ctrl[i : i + 1])
        assert_same(one.state, several.state)
        for i, simulation in enumerate(single):
            for batch, alone in zip(one.state, simulation.state, strict=True):
                assert_array_equal(batch[i], alone[0])
        assert len({row.tobytes() for row in one.state.hand_qpos}) == len(seeds)
        several.close()

    def test_a_reset_leaves_no_trace(self, kind):
        used, fresh = made(kind, 0), made(kind, 0)
        for ctrl in controls(kind[1], 1, seed=1):
            used.step(ctrl)
        used.reset([0], kind[1].hand_start[None])
        for ctrl in controls(kind[1], 1):
            used.step(ctrl)
            fresh.step(ctrl)
        assert_same(used.state, fresh.state)

    def test_only_those_asked_for_take_a_step(self, kind):
        simulation = made(kind, 0, 1)
        before = simulation.state
        simulation.step(next(controls(kind[1], 2)), env_ids=[1])
        assert_array_equal(simulation.state.hand_qpos[0], before.hand_qpos[0])
        assert (simulation.state.hand_qpos[1] != before.hand_qpos[1]).any()

    def test_a_copy_goes_on_as_its_original(self, kind):
        simulation = made(kind, 0, 1)
        twin = deepcopy(simulation)
        for ctrl in controls(kind[1], 2):
            simulation.step(ctrl)
            twin.step(ctrl)
        assert_same(simulation.state, twin.state)
