"""An Allegro Hand with touch at the keyboard of mini keys."""

import gymnasium
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import cadenza
from cadenza import CadenzaError, SceneConfig
from cadenza.keyboards.mini import MINI
from cadenza.keyboards.piano import PIANO
from cadenza.music.etudes import make_etude
from cadenza.scene.scene import build_scene
from cadenza.tasks.view import TOUCH_RANGE

IDS = {"cadenza/MiniNote-v0": 1, "cadenza/MiniNotes-v0": 6, "cadenza/MiniDyads-v0": 6}


def test_its_keys_are_two_thirds_of_a_pianos():
    for mini, full in ((MINI.white, PIANO.white), (MINI.black, PIANO.black)):
        across = np.divide(mini.half_size[1:], full.half_size[1:])
        assert across == pytest.approx(2 / 3, rel=0.06)
        assert mini.travel == pytest.approx(full.travel, rel=0.06)
        assert mini.top == pytest.approx(PIANO.white.top if full is PIANO.white else 0.0305)
        front = (k.centre_x + k.half_size[0] for k in (MINI.black, PIANO.black))
        assert next(front) == pytest.approx(next(front))
    assert MINI.white.half_size[0] == pytest.approx(2 / 3 * PIANO.white.half_size[0])
    assert MINI.num_keys == 25
    assert MINI.spacing == pytest.approx(2 / 3 * PIANO.spacing, rel=0.01)


@pytest.mark.parametrize(("env_id", "count"), IDS.items())
def test_environments_draw_drills_with_touch(env_id, count):
    env = gymnasium.make(env_id)
    drawn = set()
    for seed in range(6):
        observation, info = env.reset(seed=seed)
        drawn.add(info["song"])
        task = env.unwrapped.task
        assert len(task.score(0).notes) == count
    assert len(drawn) > 1
    assert observation[env.unwrapped.observation_layout["touch"]].shape == (4,)


def test_a_hand_feels_the_key_that_it_presses():
    env = gymnasium.make("cadenza/MiniNotes-v0", song="etudes/notes-6-3").unwrapped
    observation, _ = env.reset(seed=0)
    touch = env.observation_layout["touch"]
    assert not observation[touch].any()
    felt = []
    for _ in range(20):
        observation, *_ = env.step(env.action_space.sample())
        felt.append(observation[touch])
        force = env.task.state.touch[0, :4]
        assert_array_equal(
            observation[touch], np.minimum(force / TOUCH_RANGE, 1).astype(np.float32)
        )
    assert np.max(felt) > 0


def test_hands_do_not_begin_beside_it():
    with pytest.raises(CadenzaError, match=r"keyboard mini is only 0\.23 m long; .*one hand 0"):
        build_scene(SceneConfig(keyboard="mini"))


@pytest.mark.slow
def test_the_planner_plays_it():
    performance = cadenza.play(make_etude("notes", 3, 0), setup="mini-allegro")
    assert performance.metrics["recall"] > 0.9
