"""A task on a simulation that is not MuJoCo's."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from begun import begun
from cadenza.agents.baselines.ilqg import ILQG
from cadenza.agents.baselines.predictive_sampling import PredictiveSampling
from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.env import PianoVectorEnv
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.setups import setup_named

SONG = Score((Note(0.0, 0.1, 60), Note(0.1, 0.25, 62)), title="two notes")
STEPS = 6


class SelfPlayingPiano:
    """Keys are at once where their controls want them; there are no hands."""

    def __init__(self, scene: Scene, num_envs: int, **_: Any) -> None:
        self.state = State.at_rest(scene, num_envs)
        self.closed = False

    def reset(self, env_ids: Sequence[int], hand_qpos: np.ndarray) -> None:
        assert hand_qpos.shape == (len(env_ids), 0)
        self._move(0.0, env_ids)

    def step(self, ctrl: np.ndarray, env_ids: Sequence[int] | None) -> None:
        moving = range(len(ctrl)) if env_ids is None else env_ids
        self._move(ctrl[list(moving)], moving)

    def _move(self, key_qpos: Any, env_ids: Sequence[int]) -> None:
        moved = self.state.key_qpos.copy()
        moved[list(env_ids)] = key_qpos
        self.state = self.state._replace(key_qpos=moved)

    def close(self) -> None:
        self.closed = True


def make_task(num_envs: int = 1, **options: Any) -> PianoTask:
    paper = setup_named("paper").of(TaskConfig)
    config, scene = TaskConfig(**(paper | options)), SceneConfig(hands="none")
    return PianoTask([SONG], config, scene, num_envs, make_simulation=SelfPlayingPiano)


def test_plays_an_episode():
    """The first environment as the score asks, the second nothing."""
    envs = PianoVectorEnv(num_envs=2, task=make_task(2))
    envs.reset(seed=0)
    for _ in range(STEPS):
        goal = envs.task.goals.upcoming.goal[:, 0]
        actions = np.where(goal, 1.0, -1.0) * [[1], [0]] - [[0], [1]]
        observation, reward, terminated, truncated, infos = envs.step(actions)
        pressed = observation[:, envs.observation_layout["key_state"]]
        assert_array_equal(pressed, [goal[0, :88], np.zeros(88)])
        assert reward[0] == (1.0 if goal[0].any() else 0.5)
        assert not terminated.any()
    assert truncated.all()
    assert_allclose(infos["metrics/f1"][0], 1.0)
    assert infos["metrics/recall"][1] < 0.2  # the silent last step is right
    envs.step(np.zeros((2, 89)))  # the next episode
    assert not envs.task.state.key_qpos.any()
    envs.close()
    assert envs.task.simulation.closed


def test_a_wrong_key_and_a_diverged_simulation_end_it():
    task = make_task(2, wrong_press_termination=True)
    task.reset(np.random.default_rng(0).spawn(2), [0, 1])
    ctrl = np.zeros((2, 89))
    ctrl[0, 3] = task.spec.action_high[3]
    assert_array_equal(task.step(ctrl).terminated, [True, False])
    task.simulation.state = task.state._replace(unstable=np.array([False, True]))
    assert_array_equal(task.step(np.zeros((2, 89))).terminated, [False, True])


@pytest.mark.parametrize("make_planner", [PredictiveSampling, ILQG])
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (make_task, "plans in MuJoCo and cannot start from a SelfPlaying"),
        (
            lambda: PianoTask([SONG], TaskConfig(), SceneConfig(hands="apart")),
            "these play apart: choose hands both, right or left",
        ),
    ],
)
def test_planners_of_one_scene_in_mujoco_refuse_others(make_planner, make, message):
    planner = make_planner()
    task = begun(make(), planner)
    with pytest.raises(CadenzaError, match=message):
        planner.act(task.view())
