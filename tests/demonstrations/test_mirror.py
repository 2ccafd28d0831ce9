"""The mirror image of steps, against the simulator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.demonstrations.dataset import kept, open_dataset
from cadenza.demonstrations.mirror import Mirror
from cadenza.demonstrations.recorded_episode import played_actions
from cadenza.errors import CadenzaError
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.tasks.piano_task import PianoTask

CONFIGS = {
    "shadow": SceneConfig(),
    "allegro": SceneConfig(hand="allegro"),
    "turned": SceneConfig(attachment_yaw=15.0),
}


@pytest.fixture(scope="module", params=CONFIGS)
def scene(request: pytest.FixtureRequest) -> Scene:
    return build_scene(CONFIGS[request.param])


def test_fingertips_are_where_those_of_the_other_hand_would_be(scene: Scene) -> None:
    mirror, data = Mirror(scene), mujoco.MjData(scene.model)
    low, high = scene.model.jnt_range[scene.model.dof_jntid[scene.hand_qvel]].T
    rng = np.random.default_rng(0)

    def tips(hand_qpos: np.ndarray) -> np.ndarray:
        data.qpos[scene.hand_qpos] = hand_qpos
        mujoco.mj_kinematics(scene.model, data)
        return data.site_xpos[scene.fingertip_sites].copy()

    for _ in range(10):
        posture = rng.uniform(low, high)
        image = mirror.points(tips(posture)[None])[0]
        np.testing.assert_allclose(tips(mirror.joints(posture)), image, atol=1e-7)


def test_the_image_of_the_image_is_the_same(made: Path) -> None:
    dataset = open_dataset(made)
    mirror = Mirror(dataset.scene)
    batch = dataset.batch(np.arange(dataset.num_steps), lookahead=3, ahead=(0, 2))
    assert mirror.possible(batch).all()
    twice = mirror(mirror(batch))
    for name, values in batch._asdict().items():
        np.testing.assert_allclose(getattr(twice, name), values, atol=1e-6, err_msg=name)


def test_mirrored_goals_are_those_of_the_mirrored_score(made: Path) -> None:
    dataset = open_dataset(made)
    mirror = Mirror(dataset.scene)
    for number, episode in enumerate(dataset.episodes):
        steps = np.arange(episode.facts.num_steps)
        image = mirror(dataset.batch(dataset.first[number] + steps, lookahead=0))
        played = replace(episode)
        played.__dict__["score"] = episode.score.mirrored
        goals = played.goals(dataset.scene)
        assert (image.goal[:, 0, :-1] == goals.keys[steps]).all()
        assert (image.fingering[:, 0] == goals.fingers_wanted[steps]).all()


def test_mirrored_actions_make_the_mirrored_episode(made: Path) -> None:
    """The images are equal to rounding in the air, and nearly so where fingers touch keys."""
    scene = build_scene()
    mirror = Mirror(scene)
    episode = kept(made)[0]
    begun = replace(scene, hand_start=mirror.joints(np.array(episode.facts.start)))
    config = replace(episode.facts.task, fingering="off")
    task = PianoTask([episode.score.mirrored], config, begun)
    result = play_episode(task, Playback(mirror.actions(played_actions(episode.steps, scene))))
    image = mirror.joints(episode.steps["hand_qpos"][1:].astype(np.float64))
    off = np.abs(result.episode["hand_qpos"] - image).max(axis=1)
    assert off[:5].max() < 1e-6
    assert off.max() < 0.05
    assert result.metrics["f1"] == pytest.approx(episode.facts.f1, abs=0.05)


def test_keys_without_an_image_are_told(made: Path) -> None:
    dataset = open_dataset(made)
    mirror = Mirror(dataset.scene)
    batch = dataset.batch(np.arange(3))
    batch.goal[1, 4, 87] = True
    assert mirror.possible(batch).tolist() == [True, False, True]


def test_one_hand_has_no_image() -> None:
    with pytest.raises(CadenzaError, match="only two hands"):
        Mirror(build_scene(SceneConfig(hands="left")))


def test_hands_that_cannot_slide_to_where_their_image_is_have_none() -> None:
    turned = SceneConfig(attachment_yaw=15.0, forearm_dofs=("tx",))
    with pytest.raises(CadenzaError, match="choose attachment_yaw 0, or tx and ty"):
        Mirror(build_scene(turned))


def test_forearms_that_turn_before_they_slide_have_none() -> None:
    """A turned slide goes elsewhere than its image."""
    with pytest.raises(CadenzaError, match="put tx and ty first among the forearm_dofs"):
        Mirror(build_scene(SceneConfig(forearm_dofs=("yaw", "tx"))))
