"""The task on MuJoCo Warp: what the planner plays in C has the same F1 there."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import cadenza
from cadenza.music.libraries.library import load_score
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

pytestmark = pytest.mark.slow  # it compiles for a minute
pytest.importorskip("mujoco_warp")

SECONDS = 4.0
F1 = 0.001
KEYS = 1e-3  # [rad], a sixtieth of the way of a key; it was 7e-6 over the whole song


def test_what_was_planned_in_c_is_played():
    """By the task on the host, and by the one whose arrays stay on the device."""
    import jax

    from cadenza.sim.warp import WarpSimulation
    from cadenza.tasks.functional import FunctionalPianoTask

    score = load_score("OdeToJoy").until(SECONDS)
    config = TaskConfig()
    played = cadenza.play(score, seed=1, task=config)
    actions, keys = (played.episode.arrays[name] for name in ("action", "key_qpos"))
    host = PianoTask([score], config, make_simulation=WarpSimulation)
    host.reset([np.random.default_rng(0)], [0])
    device = FunctionalPianoTask([score], config, host.scene, 1)
    state = device.reset(jax.random.key(0))
    for step, (action, key_qpos) in enumerate(zip(actions, keys, strict=True)):
        host.step(action[None])
        assert_allclose(host.state.key_qpos[0], key_qpos, atol=KEYS)
        state = device.step(state, device.spec.unscale_action(action[None]))
        assert_allclose(state.info["state"].key_qpos[0], key_qpos, atol=KEYS)
        assert_array_equal(state.done, [step == len(actions) - 1])
    assert host.episode_metrics(0)["f1"] == pytest.approx(played.metrics["f1"], abs=F1)
    assert float(state.metrics["f1"][0]) == pytest.approx(played.metrics["f1"], abs=F1)
    assert played.metrics["f1"] > 0.9
    assert not state.info["overflow"].any()
