"""The Gymnasium classes: what Gymnasium's own checkers demand, and what users rely on."""

import copy
import json
import pickle
import subprocess
import sys
from contextlib import closing
from dataclasses import asdict, replace
from typing import Any

import av
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RecordVideo
from numpy.testing import assert_allclose, assert_array_equal

import cadenza
from cadenza.errors import CadenzaError
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.libraries.library import songs
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.sim.render import Picture, Renderer
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.env import PianoEnv, PianoVectorEnv
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.reward import Outcome
from numbered import finger

ID = "cadenza/TwinkleTwinkleLittleStar-v0"
SHORT = Score(
    (Note(0.0, 0.1, 60, finger=finger(0)), Note(0.1, 0.25, 62, finger=finger(1))), title="short"
)
SILENT_STEPS = 10  # half a second
SHORT_STEPS = SILENT_STEPS + 6
FAR_AWAY = 1e12  # [m, rad], where MuJoCo takes the state for that of a simulation that diverged


def test_every_bundled_song_is_registered():
    for piece in songs():
        assert f"cadenza/{piece.name}-v0" in gym.registry
    assert cadenza.__version__


def test_gymnasium_imports_the_package_that_is_named():
    make = 'import gymnasium as gym; gym.make("cadenza:cadenza/OdeToJoy-v0").reset(seed=0)'
    subprocess.run([sys.executable, "-c", make], check=True, timeout=60)


def test_gymnasium_checks_the_env_when_it_draws():
    check_env(gym.make(ID, render_mode="rgb_array").unwrapped)


def test_make_takes_options():
    env = gym.make(ID, reduced_action_space=False, n_steps_lookahead=2)
    assert env.action_space.shape == (45,)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert env.unwrapped.observation_layout["goal"] == slice(0, 3 * 89)
    with pytest.raises(CadenzaError, match="unknown option speed: choose from"):
        gym.make(ID, speed=2)


def test_episode_ends_with_the_score():
    env = gym.make("cadenza/Piano-v0", song=SHORT)
    env.reset(seed=0)
    for step in range(SHORT_STEPS):
        _, reward, terminated, truncated, info = env.step(np.zeros(39, np.float32))
        assert not terminated
        assert truncated == (step == SHORT_STEPS - 1)
        terms = [value for name, value in info.items() if name.startswith("reward/")]
        assert reward == pytest.approx(sum(terms))
    assert 0 <= info["metrics/f1"] <= 1
    with pytest.raises(CadenzaError, match="have ended"):
        env.step(np.zeros(39, np.float32))


def test_make_vec_picks_the_batched_env():
    envs = gym.make_vec(ID, num_envs=3, num_threads=2)
    assert isinstance(envs.unwrapped, PianoVectorEnv)
    assert envs.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    observation, _ = envs.reset(seed=0)
    assert observation in envs.observation_space
    result = envs.step(envs.action_space.sample())
    assert result[0] in envs.observation_space
    assert [part.shape for part in result[1:4]] == [(3,)] * 3
    envs.close()


def test_a_score_and_a_start_that_a_reset_names_are_taken_as_they_are():
    """Nothing is drawn then, nor done to the score; as JSON has them, they are the same."""
    env = PianoEnv(
        "OdeToJoy", stretch=2.0, transpose=1, random_stretch=0.2, random_hand_position=0.05
    )
    start = np.linspace(0.0, 0.02, len(env.task.scene.hand_joint_names))
    late = Score((Note(0.1, 0.2, 60, finger=finger(0)), Note(0.2, 0.3, 61)), title="late")
    written = json.loads(json.dumps(asdict(WrittenScore.of(late))))
    for song, begin in ((late, start), (written, start.tolist())):
        observation, info = env.reset(seed=0, options={"score": song, "start": begin})
        assert info["song"] == "late"
        assert env.task.goals.tracks[0].score == late
        assert_array_equal(observation[env.observation_layout["joints"]], start.astype("f4"))
    env.reset()
    assert env.task.goals.tracks[0].score.title != "late"
    assert not np.array_equal(env.task.state.hand_qpos[0], start)


def test_fingers_are_looked_for_where_a_score_that_a_reset_names_gives_none():
    env = PianoEnv(SHORT)
    env.reset(options={"score": SHORT.without_fingers()})
    assert env.task.goals.tracks[0].score.has_fingering


def test_each_environment_is_reset_to_a_score_and_a_start_of_its_own():
    envs = PianoVectorEnv(SHORT, num_envs=3)
    start = np.full(len(envs.task.scene.hand_joint_names), 0.01)
    other = replace(SHORT, title="other")
    options = {"song": [None, 0, None], "score": [other, None, None], "start": [None, start, None]}
    envs.reset(options=options)
    assert [score.title for score in envs.task.goals.scores] == ["other", "short", "short"]
    moved = (envs.task.state.hand_qpos == 0.01).all(axis=1)
    assert moved.tolist() == [False, True, False]
    envs.reset(options={"start": start})
    assert (envs.task.state.hand_qpos == 0.01).all()
    envs.close()


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"score": Score(())}, "nothing to play: the score has no notes"),
        ({"score": Score((Note(0.0, 0.1, 20),))}, "1 of 1 notes are not on the keyboard"),
        ({"score": {"notes": [{"pitch": 60}]}}, "the score: .*missing"),
        ({"score": "OdeToJoy"}, "score 'OdeToJoy': give a Score; a song is named by song"),
        ({"score": SHORT, "song": 0}, "song and score: give one of them"),
        ({"start": [0.0, 1.0]}, r"start of shape \(2,\): give a finite number for each"),
        ({"start": "left"}, "start 'left': give a finite number for each"),
        ({"start": [float("nan")] * 46}, "start not finite"),
        ({"start": [[0.0] * 46] * 2}, "2 starts for 1 environments: give one for each"),
    ],
)
def test_scores_and_starts_that_cannot_be(options, what):
    env = PianoEnv(SHORT)
    env.reset(seed=0)
    with pytest.raises(CadenzaError, match=what):
        env.reset(options=options)


def test_same_seed_same_episode_and_reset_draws_anew():
    env = PianoEnv("OdeToJoy", random_hand_position=0.05)
    first, _ = env.reset(seed=3)
    again, _ = env.reset()
    repeated, _ = env.reset(seed=3)
    assert_array_equal(first, repeated)
    assert (first != again).any()


def scripted(mode: AutoresetMode, steps: int) -> list[tuple]:
    """Two songs of different lengths, so that the environments end at different times."""
    longer = SHORT.with_initial_silence(0.05 * 3)
    envs = PianoVectorEnv(
        [SHORT, longer], num_envs=6, autoreset_mode=mode, trim_silence=False, num_threads=2
    )
    envs.reset(seed=0)
    rng = np.random.default_rng(0)
    return [envs.step(rng.uniform(-1, 1, envs.action_space.shape)) for _ in range(steps)]


def test_autoreset_on_the_next_step():
    results = scripted(AutoresetMode.NEXT_STEP, 2 * SHORT_STEPS)
    ended = np.array([result[3] for result in results])
    assert ended[SHORT_STEPS - 1].any()
    assert not ended[SHORT_STEPS - 1].all()
    for now, (observation, reward, terminated, truncated, info) in enumerate(results):
        fresh = ended[now - 1] if now else np.zeros(6, bool)
        assert (reward[fresh] == 0).all()
        assert (observation[fresh, -46:] == 0).all()  # the joints, which start over
        assert not (terminated | truncated)[fresh].any()
        assert_array_equal(info["_reward/key_press"], ~fresh)
        if ended[now].any():
            assert_array_equal(info["_metrics/f1"], ended[now])


def test_autoreset_on_the_same_step_keeps_the_last_observation_and_metrics():
    next_step = scripted(AutoresetMode.NEXT_STEP, SHORT_STEPS)
    same_step = scripted(AutoresetMode.SAME_STEP, SHORT_STEPS)
    observation, _, _, truncated, info = same_step[-1]
    assert_array_equal(info["_final_obs"], truncated)
    assert_array_equal(info["_final_info"], truncated)
    assert_array_equal(info["final_info"]["metrics/f1"], info["metrics/f1"])
    for i in np.flatnonzero(truncated):
        assert_array_equal(info["final_obs"][i], next_step[-1][0][i])
        assert_array_equal(observation[i, -46:], np.zeros(46))


def test_disabled_autoreset_resets_by_mask():
    envs = PianoVectorEnv(SHORT, num_envs=2, autoreset_mode=AutoresetMode.DISABLED)
    envs.reset(seed=0)
    for _ in range(SHORT_STEPS):
        *_, truncated, _ = envs.step(envs.action_space.sample())
    assert truncated.all()
    with pytest.raises(CadenzaError, match="reset them"):
        envs.step(envs.action_space.sample())
    envs.reset(options={"reset_mask": np.array([True, True])})
    envs.step(envs.action_space.sample())


def test_a_single_environment_is_always_reset():
    env = PianoEnv(SHORT)
    env.reset(seed=0, options={"reset_mask": [False]})
    env.step(np.zeros(39))


def test_pixels():
    env = gym.make(ID, pixels=True)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    picture = observation["pixels"]
    assert picture.shape == (360, 640, 3)
    assert picture.std() > 20  # not an empty picture
    small = {"picture": Picture(64, 36), "autoreset_mode": AutoresetMode.SAME_STEP}
    envs = PianoVectorEnv(SHORT, num_envs=2, pixels=True, **small)
    observation, _ = envs.reset(seed=0)
    assert observation in envs.observation_space
    for _ in range(SHORT_STEPS):
        *_, info = envs.step(envs.action_space.sample())
    assert info["final_obs"][0]["pixels"].shape == (36, 64, 3)


def test_rendered_keys_light_up():
    env = PianoEnv("OdeToJoy", hands="none", render_mode="rgb_array")
    env.reset(seed=0)
    action = -np.ones(89)
    before = env.render().astype(int)
    action[51] = 1  # not what the score asks for: red
    env.step(action)
    change = env.render().astype(int) - before
    reddened = (change[..., 1] < -40) & (change[..., 0] > -40)
    assert 20 < reddened.sum() < 4000


def test_gymnasium_records_a_video(tmp_path):
    env = gym.make("cadenza/Piano-v0", song=SHORT, render_mode="rgb_array")
    with closing(RecordVideo(env, str(tmp_path), episode_trigger=lambda _: True)) as recorded:
        recorded.reset(seed=0)
        for _ in range(SHORT_STEPS):
            recorded.step(recorded.action_space.sample())
    (video,) = tmp_path.glob("*.mp4")
    with av.open(video) as file:
        frames = list(file.decode(video=0))
    assert len(frames) == 1 + SHORT_STEPS
    assert (frames[0].width, frames[0].height) == (640, 360)


@pytest.mark.parametrize(
    ("options", "meant"),
    [({"song": "OdeToJy"}, "OdeToJoy"), ({"sng": "OdeToJoy"}, "song"), ({"hnds": "left"}, "hands")],
)
def test_what_is_misspelt_is_suggested(options, meant):
    for make in (gym.make, gym.make_vec):
        with pytest.raises(CadenzaError, match=rf"did you mean {meant}\?"):
            make("cadenza/Piano-v0", **options)


def test_keys_are_drawn_by_the_goals_when_they_were_pressed(monkeypatch):
    drawn, goals = [], []

    def frame(_self: Renderer, _hand: Any, _keys: Any, sounding: Any, goal: Any) -> np.ndarray:
        drawn.append((sounding.copy(), goal.copy()))
        return np.zeros(1)

    monkeypatch.setattr(Renderer, "__init__", lambda _self, _scene, _picture: None)
    monkeypatch.setattr(Renderer, "frame", frame)
    env = PianoEnv(SHORT, hands="none", render_mode="rgb_array")
    observation, _ = env.reset(seed=0)
    for _ in range(SHORT_STEPS):
        goals.append(observation[:88] > 0)
        observation, *_ = env.step(np.append(np.where(goals[-1], 1.0, -1.0), 0.0))
        env.render()
    assert_array_equal([goal for _, goal in drawn], goals)
    assert any(sounding.any() for sounding, _ in drawn)


def test_seeds_of_some_leave_the_others_as_they_were():
    def pitches(**again: Any) -> list[int]:
        envs = PianoVectorEnv(SHORT, num_envs=2, random_pitch_shift=20)
        envs.reset(seed=[1, 2])
        if again:
            envs.reset(**again)
        envs.reset()
        return [score.notes[0].pitch for score in envs.task.goals.scores]

    mask = np.array([True, False])
    one, other = pitches()
    twice = pitches(seed=None)
    for again in ({"seed": [3, None]}, {"seed": np.array([3, 4]), "options": {"reset_mask": mask}}):
        assert pitches(**again) == pitches(**again)
    assert pitches(seed=[1, None])[0] == one
    assert pitches(seed=[3, None])[1] == twice[1]
    assert pitches(seed=np.array([3, 4]), options={"reset_mask": mask})[1] == other


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_live_a_life_of_their_own(duplicate):
    envs = PianoVectorEnv("OdeToJoy", num_envs=2, num_threads=2, random_pitch_shift=10)
    envs.reset(seed=0)
    envs.step(np.zeros((2, 39)))
    twin = duplicate(envs)
    assert_array_equal(envs.reset(seed=1)[0], twin.reset(seed=1)[0])
    twin.reset(options={"start": [None, np.full(46, FAR_AWAY)]})
    assert_array_equal(twin.step(np.zeros((2, 39)))[2], [False, True])
    assert_array_equal(envs.step(np.zeros((2, 39)))[2], [False, False])


@pytest.mark.parametrize("at", [slice(None), 0, -1], ids=["all", "a joint", "the pedal"])
def test_actions_that_are_no_numbers_end_their_episode_only(at):
    envs = PianoVectorEnv("OdeToJoy", num_envs=2)
    envs.reset(seed=0)
    actions = np.zeros((2, 39))
    actions[0, at] = np.nan
    observation, reward, terminated, _, info = envs.step(actions)
    assert_array_equal(terminated, [True, False])
    assert_array_equal(info["unstable"], [True, False])
    assert np.isfinite(observation).all()
    assert np.isfinite(reward).all()
    *_, terminated, _, info = envs.step(np.zeros((2, 39)))  # the next episode knows nothing of it
    assert not terminated.any()
    assert not info["unstable"].any()


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_gymnasium_s_own_vector_environments(mode: str) -> None:
    # Forking a process in which JAX has started threads may hang.
    context = {"context": "spawn"} if mode == "async" else {}
    envs = gym.make_vec(ID, num_envs=2, vectorization_mode=mode, vector_kwargs=context)
    ours = PianoVectorEnv("TwinkleTwinkleLittleStar", num_envs=2)
    assert_array_equal(envs.reset(seed=3)[0], ours.reset(seed=3)[0])
    actions = np.full((2, 39), 0.5, np.float32)
    assert_array_equal(envs.step(actions)[0], ours.step(actions)[0])
    envs.close()


def reset(num_envs: int = 1, **how: Any) -> None:
    PianoVectorEnv(SHORT, num_envs).reset(**how)


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda: PianoVectorEnv(SHORT).step(np.zeros((1, 39))), "reset.. before step"),
        (lambda: PianoEnv(SHORT, render_mode="human"), "render_mode 'human': choose"),
        (lambda: gym.make("cadenza/Piano-v0"), "no song to play: give song='OdeToJoy'"),
        (lambda: gym.make_vec("cadenza/Piano-v0", num_envs=2), "no song to play"),
        (lambda: PianoEnv(SHORT, task=PianoTask([SHORT])), "has its songs"),
        (lambda: PianoEnv(task=PianoTask([SHORT]), stretch=2), "pass nothing else"),
        (lambda: PianoVectorEnv(num_envs=2, task=PianoTask([SHORT])), "num_envs 2: the task has 1"),
        (lambda: reset(2, seed=[1]), "1 seeds for 2"),
        (lambda: reset(2, seed=[1, "x"]), "seed 'x': give a whole number"),
        (lambda: reset(seed=1.5), "seed 1.5: give a whole number"),
        (lambda: reset(seed=-1), "seed -1: choose 0 or more"),
        (lambda: PianoEnv(SHORT).reset(seed=1.5), "seed 1.5: give a whole number"),
        (lambda: PianoEnv(SHORT).reset(seed=-1), "seed -1: choose 0 or more"),
        (
            lambda: PianoEnv(SHORT, reward_terms={"total": near_middle_c}),
            "reward term 'total': recordings call the sum",
        ),
        (lambda: PianoEnv("Twinkl"), "did you mean TwinkleTwinkleLittleStar?"),
        (lambda: reset(2, options={"reset_mask": [True]}), "reset_mask of shape"),
        (lambda: reset(2, options={"reset_mask": [True, False]}), "the first reset is of all"),
        (
            lambda: reset(options={"songs": 0}),
            "no option 'songs' of reset: choose from randomization, reset_mask, score, song, start",
        ),
        (lambda: PianoEnv(SHORT).reset(options={"songs": 0}), "no option 'songs' of reset"),
        (
            lambda: reset(2, options=[{"step": 1}, None]),
            "options .* of reset: give a dictionary, whose values may be lists",
        ),
        (
            lambda: gym.make(ID, num_envs=2),
            r"num_envs: this is one environment; make several with gymnasium\.make_vec",
        ),
        (lambda: gym.make(ID, autoreset_mode="SameStep"), "autoreset_mode: this is one"),
        (lambda: PianoEnv(SHORT, picture={"width": 64}), r"picture .*: give a cadenza\.sim"),
    ],
)
def test_says_what_is_wrong(use, message):
    with pytest.raises(CadenzaError, match=message):
        use()


def test_seeds_of_gymnasium_and_of_numpy_are_the_same():
    env, envs = PianoEnv(SHORT), PianoVectorEnv(SHORT)
    env.reset(seed=3)
    drawn = env.np_random.random()
    for seed in 3, np.int64(3), np.uint8(3):
        env.reset(seed=seed)
        envs.reset(seed=seed)
        assert env.np_random.random() == envs.np_random.random() == drawn


@pytest.mark.parametrize("kind", [PianoEnv, PianoVectorEnv])
def test_nothing_is_done_with_what_is_closed(kind):
    env = kind(SHORT, render_mode="rgb_array")
    env.reset(seed=0)
    env.close()
    for use in env.reset, env.render, lambda: env.step(env.action_space.sample()):
        with pytest.raises(CadenzaError, match="the environment is closed: make another"):
            use()
    env.close()


def test_a_metric_without_a_value_is_left_out_of_infos():
    env, envs = PianoEnv(SHORT), PianoVectorEnv(SHORT, num_envs=2)
    env.reset(seed=0)
    envs.reset(seed=0)
    still, over = np.zeros(env.action_space.shape, np.float32), False
    while not over:
        *_, over, info = env.step(still)
        *_, infos = envs.step(np.stack([still, still]))
    assert info["metrics/f1"] < 1
    assert "metrics/timing_error" not in info
    assert_array_equal(infos["_metrics/f1"], [True, True])
    assert "metrics/timing_error" not in infos
    assert not any(np.isnan(v).any() for n, v in infos.items() if n.startswith("metrics/"))


def test_what_could_not_be_made_need_not_be_closed():
    begun = PianoVectorEnv.__new__(PianoVectorEnv)
    with pytest.raises(CadenzaError, match="no song named"):
        begun.__init__("no song")  # type: ignore[misc]
    begun.close()


def test_wrong_shape_of_actions():
    envs = PianoVectorEnv(SHORT, num_envs=2)
    envs.reset(seed=0)
    with pytest.raises(CadenzaError, match=r"actions of shape \(39,\): give \(2, 39\)"):
        envs.step(np.zeros(39))
    env = PianoEnv(SHORT)
    env.reset(seed=0)
    with pytest.raises(CadenzaError, match=r"action of shape \(38,\): give \(39,\)"):
        env.step(np.zeros(38))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_infos_name_the_song_of_each_environment(mode):
    envs = PianoVectorEnv([SHORT, OTHER], num_envs=8, autoreset_mode=mode)
    _, infos = envs.reset(seed=0)
    assert set(infos["song"]) == {"short", "other"}
    for _ in range(12):
        before = infos["song"]
        _, _, terminated, truncated, infos = envs.step(np.zeros((8, 39)))
        assert_array_equal(infos["song"], [score.title for score in envs.task.goals.scores])
        assert infos["_song"].all()
        if "final_info" in infos:
            assert_array_equal(infos["final_info"]["song"], before)
        if mode == AutoresetMode.DISABLED and (ended := terminated | truncated).any():
            _, infos = envs.reset(options={"reset_mask": ended})
            assert_array_equal(infos["_song"], ended)


OTHER = Score((Note(0.0, 0.1, 64),), title="other")
BOTH = {"short", "other"}


def test_songs_are_assigned_or_drawn():
    envs = PianoVectorEnv([SHORT, OTHER], num_envs=4, autoreset_mode=AutoresetMode.SAME_STEP)
    drawn = np.array([envs.reset(seed=seed)[1]["song"] for seed in range(8)])
    assert [set(titles) for titles in drawn.T] == [BOTH] * 4
    for song, titles in (
        ("other", ["other"] * 4),
        (0, ["short"] * 4),
        ([1, "short", np.int64(1), 0], ["other", "short", "other", "short"]),
    ):
        observation, infos = envs.reset(seed=0, options={"song": song})
        assert infos["song"].tolist() == titles
        goal = observation[:, envs.observation_layout["goal"]].reshape(4, -1, 89)
        assert (goal[:, SILENT_STEPS, 39] == [title == "short" for title in titles]).all()
    some = {"song": ["other", None, 0, None]}
    partly = np.array([envs.reset(seed=seed, options=some)[1]["song"] for seed in range(8)])
    assert [set(titles) for titles in partly.T] == [{"other"}, BOTH, {"short"}, BOTH]


def test_an_assignment_is_for_one_episode_of_the_environments_that_are_reset():
    envs = PianoVectorEnv([SHORT, OTHER], num_envs=8, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=0, options={"song": "short"})
    last_four = np.arange(8) >= 4
    _, infos = envs.reset(options={"song": "other", "reset_mask": last_four})
    assert infos["song"].tolist() == ["short"] * 4 + ["other"] * 4
    for _ in range(SHORT_STEPS):
        *_, infos = envs.step(np.zeros((8, 39)))
    assert set(infos["song"][:4]) == {"short", "other"}


def test_a_song_is_assigned_by_the_name_that_was_given():
    envs = PianoVectorEnv(["OdeToJoy", "FrereJacques"], num_envs=2)
    infos = envs.reset(options={"song": ["FrereJacques", "OdeToJoy"]})[1]
    assert infos["song"].tolist() == ["Frère Jacques", "Ode to Joy"]
    with pytest.raises(CadenzaError, match="choose an index from 0 to 1, or a title"):
        envs.reset(options={"song": "JingleBells"})


def test_a_single_environment_is_assigned_a_song():
    env = gym.make("cadenza/Piano-v0", song=[SHORT, OTHER])
    for song, title in ((0, "short"), ("other", "other"), (1, "other")):
        for seed in range(3):
            assert env.reset(seed=seed, options={"song": song})[1] == {"song": title}
    first, _ = env.reset(seed=0, options={"song": "short"})
    assert_array_equal(first, PianoEnv(SHORT).reset(seed=0)[0])


@pytest.mark.parametrize(
    ("song", "message"),
    [
        ("shrt", "song 'shrt': choose an index from 0 to 2, or a title: 'short', 'other', 'other'"),
        (3, "song 3: choose an index from 0 to 2"),
        (-1, "song -1: choose"),
        (True, "song True: choose"),
        (1.0, "song 1.0: choose"),
        (SHORT, "song Score.*: choose"),
        ([0, "x"], "song 'x': choose"),
        ([0], "1 songs for 2 environments: give one for each"),
        ("other", r"song 'other': 2 have this title; give an index: \[1, 2\]"),
    ],
)
def test_songs_that_there_are_not(song, message):
    envs = PianoVectorEnv([SHORT, OTHER, OTHER], num_envs=2)
    with pytest.raises(CadenzaError, match=message) as error:
        envs.reset(seed=0, options={"song": song})
    assert "\n" not in str(error.value)


def test_scaling_actions_there_and_back():
    spec = PianoEnv(SHORT).task.spec
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 3, 39))
    ones = np.ones(39)
    assert_allclose(spec.scale_action(-ones), spec.action_low, atol=1e-12)
    assert_allclose(spec.scale_action(7 * ones), spec.action_high, atol=1e-12)
    assert_allclose(spec.unscale_action(spec.scale_action(action)), action, atol=1e-12)
    outside = np.full(39, 1e3)  # in actuator units
    assert_array_equal(spec.unscale_action([-outside, outside]), [[-1.0] * 39, [1.0] * 39])


def near_middle_c(outcome: Outcome) -> np.ndarray:
    return outcome.key_state[:, 39] - outcome.goal_keys.sum(axis=1)


def test_reward_terms_of_one_s_own():
    terms = {"middle_c": near_middle_c, "energy": lambda outcome: np.zeros(len(outcome.ctrl))}
    env = gym.make("cadenza/Piano-v0", song=SHORT, reward_terms=terms)
    envs = gym.make_vec("cadenza/Piano-v0", num_envs=3, song=SHORT, reward_terms=terms)
    plain = PianoEnv(SHORT)
    for each in (env, envs, plain):
        each.reset(seed=0)
    for _ in range(SHORT_STEPS):
        action = np.full(39, 0.3)
        _, reward, _, _, info = env.step(action)
        _, rewards, _, _, infos = envs.step(np.tile(action, (3, 1)))
        _, without, _, _, before = plain.step(action)
        goals = plain.task.goals.between(0, 0, SHORT_STEPS)[0][:, :88].sum(axis=1)
        expected = plain.task.key_state[0, 39] - goals[plain.task.goals.steps_done[0] - 1]
        assert info["reward/middle_c"] == pytest.approx(expected)
        assert info["reward/energy"] == 0
        assert reward == pytest.approx(without + expected - before["reward/energy"])
        assert_array_equal(rewards, [reward] * 3)
        assert_array_equal(infos["reward/middle_c"], [info["reward/middle_c"]] * 3)


def test_a_reward_term_of_the_wrong_shape():
    env = PianoEnv(SHORT, reward_terms={"sum": lambda outcome: outcome.sounding.sum()})
    env.reset(seed=0)
    with pytest.raises(CadenzaError, match=r"'sum' returned values of shape \(\): give .* \(1,\)"):
        env.step(np.zeros(39))


def test_make_takes_configurations_and_tasks():
    config, scene = TaskConfig(stretch=2.0), SceneConfig(reduced_action_space=False)
    env = gym.make(ID, task=config, scene=scene, n_steps_lookahead=3)
    assert env.unwrapped.task.config == TaskConfig(stretch=2.0, n_steps_lookahead=3)
    assert env.action_space.shape == (45,)
    task = PianoTask([SHORT], config, num_envs=2)
    envs = gym.make_vec("cadenza/Piano-v0", num_envs=2, task=task)
    assert envs.unwrapped.task is task
    assert envs.reset(seed=0)[1]["song"].tolist() == ["short", "short"]


def test_stretch_and_transpose():
    slow = PianoEnv(SHORT, stretch=2.0, transpose=-12)
    observation, _ = slow.reset(seed=0)
    goal = observation[slow.observation_layout["goal"]].reshape(11, 89)
    assert_array_equal(np.flatnonzero(goal[SILENT_STEPS]), [39 - 12])
    assert slow.task.goals.num_steps[0] == SILENT_STEPS + 11
    with pytest.raises(CadenzaError, match="cannot transpose by 90"):
        PianoEnv(SHORT, transpose=90)
