"""Notes that say when and how loud: what is observed of their onsets, and how it is rewarded."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.keyboards.piano import PIANO
from cadenza.music.score import NUM_KEYS, Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

ID = "cadenza/Piano-v0"
ONSET_PARTS = ("goal_onset", "goal_velocity", "key_onset", "key_velocity")
REWARDED = {"onset_goals": True, "onset_timing_coefficient": 1.0, "loudness_coefficient": 1.0}
C, E = 60 - PIANO.lowest_pitch, 64 - PIANO.lowest_pitch
DT = 0.05


def song(*notes: tuple[float, int, int]) -> Score:
    """Short notes that begin at a time [s], with a pitch and a velocity, and one at the end."""
    end = Note(0.4, 0.44, 80, velocity=80)
    return Score((*(Note(t, t + 0.04, pitch, velocity=v) for t, pitch, v in notes), end))


class Onset(NamedTuple):
    """A key that begins to sound in a step, and falls silent in it at `offset`."""

    step: int
    time: float
    velocity: float = 80.0
    key: int = C
    offset: float = math.nan


class PlayedPiano:
    """Keys begin to sound as they are told, and then sound until the end of the next step."""

    def __init__(self, scene: Scene, num_envs: int, **_: Any) -> None:
        self.zeros = self.state = State.at_rest(scene, num_envs)
        self.onsets: Sequence[Onset] = ()
        self.steps = np.zeros(num_envs, int)

    def reset(self, env_ids: Sequence[int], hand_qpos: np.ndarray) -> None:
        self.steps[list(env_ids)] = 0
        self.state = self.zeros

    def step(self, ctrl: np.ndarray, env_ids: Sequence[int] | None) -> None:
        state = self.zeros.copy()
        for env in range(len(ctrl)) if env_ids is None else env_ids:
            for step, time, velocity, key, offset in self.onsets:
                if step in (self.steps[env], self.steps[env] - 1):
                    state.key_qpos[env, key] = PIANO.travel[key]
                if step == self.steps[env]:
                    state.key_onset[env, key], state.key_offset[env, key] = time, offset
                    state.key_speed[env, key] = PIANO.speed(velocity)
            self.steps[env] += 1
        self.state = state

    def close(self) -> None:
        pass


def begin(score: Score, *onsets: Onset, num_envs: int = 1, **options: Any) -> PianoTask:
    silence = {"trim_silence": False, "initial_buffer_time": 0.0}
    config, scene = TaskConfig(**(silence | options)), SceneConfig(hands="none")
    task = PianoTask([score], config, scene, num_envs, make_simulation=PlayedPiano)
    task.simulation.onsets = onsets
    task.reset(np.random.default_rng(0).spawn(num_envs), range(num_envs))
    return task


def rewards(score: Score, *onsets: Onset, steps: int = 5) -> tuple[list[float], list[float]]:
    """What each step of the first environment earns for timing, and for loudness."""
    task = begin(score, *onsets, **REWARDED)
    terms = [task.step(np.zeros((1, NUM_KEYS + 1))).terms for _ in range(steps)]
    return tuple([float(each[name][0]) for each in terms] for name in ("onset_timing", "loudness"))


def seen(task: PianoTask, part: str) -> np.ndarray:
    """(steps, K) a part of the first environment's observation."""
    values = task.observation()[0, task.spec.observation_layout[part]]
    return values.reshape(-1, NUM_KEYS)


# What is observed


def test_notes_say_when_and_how_loud_from_the_last_step_on():
    task = begin(
        song((0.02, 60, 127), (0.13, 64, 40)),
        onset_goals=True,
        n_steps_lookahead=2,
        repeats="shortened",
    )
    expected = {0: (C, 0.4, 1.0), 2: (E, 0.6, 40 / 127)}  # by step: the key, and what is seen
    for step in range(5):
        time, velocity = np.zeros((2, 4, NUM_KEYS))
        for row, of in enumerate(range(step - 1, step + 3)):
            if of in expected:
                key, time[row, key], velocity[row, key] = expected[of][0], *expected[of][1:]
        assert_allclose(seen(task, "goal_onset"), time, atol=1e-6)
        assert_allclose(seen(task, "goal_velocity"), velocity, atol=1e-6)
        task.step(np.zeros((1, NUM_KEYS + 1)))


def test_keys_say_when_they_sounded_in_the_last_step_and_how_loud():
    task = begin(song((0.0, 60, 80)), Onset(1, 0.03, 50.0), onset_goals=True)
    for onset, velocity in ((0.0, 0.0), (0.0, 0.0), (0.6, 50 / 127), (0.0, 0.0)):
        assert_allclose(seen(task, "key_onset")[0, C], onset, atol=1e-6)
        assert_allclose(seen(task, "key_velocity")[0, C], velocity, atol=1e-6)
        task.step(np.zeros((1, NUM_KEYS + 1)))


def test_a_piano_that_plays_itself_shows_what_the_simulation_says():
    silence = {"initial_buffer_time": 0.0}
    env = gym.make(ID, song=song((0.0, 60, 80)), hands="none", **silence, **REWARDED)
    env.reset(seed=0)
    layout, task = env.unwrapped.observation_layout, env.unwrapped.task
    action = -np.ones(NUM_KEYS + 1, np.float32)
    action[C] = 1.0
    observation, *_, info = env.step(action)
    onset, speed = task.state.key_onset[0, C], task.state.key_speed[0, C]
    assert_allclose(observation[layout["key_onset"]][C], onset / DT, rtol=1e-6)
    assert_allclose(observation[layout["key_velocity"]][C], PIANO.velocity(speed) / 127, rtol=1e-6)
    assert_allclose(info["reward/onset_timing"], in_time(onset), rtol=1e-9)
    assert_allclose(info["reward/loudness"], as_loud(PIANO.velocity(speed) - 80), rtol=1e-9)


def test_without_the_option_nothing_is_observed_or_rewarded_and_the_rest_is_the_same():
    """To the bit."""
    plain = gym.make(ID, song="TwinkleTwinkleLittleStar", onset_goals=False)
    more = gym.make(ID, song="TwinkleTwinkleLittleStar", **REWARDED)
    published = {"goal": 979, "fingering": 10, "key_state": 88, "pedal": 1, "joints": 46}
    layout = plain.unwrapped.observation_layout
    assert {name: part.stop - part.start for name, part in layout.items()} == published
    parts = more.unwrapped.observation_layout
    assert parts.keys() - layout.keys() == set(ONSET_PARTS)
    (before, _), (other, _) = plain.reset(seed=0), more.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(20):
        for name, part in layout.items():
            assert_array_equal(before[part], other[parts[name]])
        action = rng.uniform(-1, 1, 39)
        before, reward, *_, info = plain.step(action)
        other, _, *_, infos = more.step(action)
        terms = {name: value for name, value in info.items() if name.startswith("reward/")}
        assert terms.keys() == {"reward/key_press", "reward/fingering", "reward/energy"}
        assert terms.items() <= infos.items()
        assert infos.keys() - info.keys() == {"reward/onset_timing", "reward/loudness"}
        assert reward == sum(terms.values())


# What is rewarded


def in_time(error: float) -> float:
    """1 up to 6 ms, a tenth at 50 ms."""
    return 0.1 ** ((max(abs(error) - 0.006, 0) / 0.044) ** 2)


def as_loud(error: float) -> float:
    """1 up to 10.8, a tenth at 35.8."""
    return 0.1 ** ((max(abs(error) - 10.8, 0) / 25) ** 2)


DUE = song((0.07, 60, 80))  # 20 ms after the beginning of step 1


@pytest.mark.parametrize(
    ("onset", "error"),
    [
        (Onset(1, 0.02), 0.0),
        (Onset(1, 0.026), 0.006),
        (Onset(1, 0.04), 0.02),
        (Onset(1, 0.0), -0.02),
        (Onset(2, 0.001), 0.031),  # steps are nothing that one hears
        (Onset(2, 0.02), 0.05),
        (Onset(0, 0.045), -0.025),
    ],
)
def test_a_note_earns_by_how_far_its_onset_is_off(onset, error):
    timing, loudness = rewards(DUE, onset)
    expected = np.zeros(5)
    expected[onset.step] = 1.0
    assert_allclose(timing, expected * in_time(error), atol=1e-9)
    assert_allclose(loudness, expected, atol=1e-9)


@pytest.mark.parametrize("velocity", [90, 100, 44.2, 1])
def test_a_note_earns_by_how_far_its_velocity_is_off(velocity):
    timing, loudness = rewards(DUE, Onset(1, 0.02, velocity))
    assert_allclose(timing, [0, 1, 0, 0, 0], atol=1e-9)
    assert_allclose(loudness, [0, as_loud(velocity - 80), 0, 0, 0], atol=1e-9)


NOTHING, PERFECT = [0] * 5, [0, 1, 0, 0, 0]
IN_TIME, TWICE = Onset(1, 0.02), Onset(1, 0.02, offset=0.01)
AGAIN, NEAR = song((0.0, 60, 80), (0.12, 60, 80)), song((0.0, 60, 40), (0.1, 60, 80))
EARNED: dict[str, tuple[Score, tuple[Onset, ...], list[float], list[float]]] = {
    "two steps late": (DUE, (Onset(3, 0.0),), NOTHING, NOTHING),
    "of another key": (DUE, (Onset(1, 0.02, key=E),), NOTHING, NOTHING),
    "the first near a note counts, however well the second fits": (
        *(DUE, (Onset(0, 0.01, 30), TWICE, Onset(2, 0.01))),
        *([in_time(-0.06), 0, 0, 0, 0], [as_loud(-50), 0, 0, 0, 0]),
    ),
    "struck again later": (DUE, (IN_TIME, Onset(2, 0.02)), PERFECT, PERFECT),
    "struck again at once": (DUE, (IN_TIME, Onset(2, 0.0)), PERFECT, PERFECT),
    # A key that was silent, and falls silent again before its last onset, sounded twice.
    "twice within a step": (DUE, (TWICE,), NOTHING, NOTHING),
    "twice, and late": (DUE, (TWICE, Onset(3, 0.0)), NOTHING, NOTHING),
    "anew, once it has fallen silent": (
        *(AGAIN, (Onset(1, 0.0), Onset(2, 0.02, offset=0.01))),
        *([0, in_time(0.05), 1, 0, 0], [0, 1, 1, 0, 0]),
    ),
    "the nearer of two notes": (NEAR, (Onset(1, 0.04),), [0, in_time(0.01), 0, 0, 0], PERFECT),
    "both of a chord": (
        *(song((0.07, 60, 80), (0.07, 64, 80)), (IN_TIME, Onset(1, 0.04, 100, key=E))),
        *([0, 1 + in_time(0.02), 0, 0, 0], [0, 1 + as_loud(20), 0, 0, 0]),
    ),
}


@pytest.mark.parametrize("what", EARNED)
def test_what_onsets_earn(what):
    score, onsets, *expected = EARNED[what]
    assert_allclose(rewards(score, *onsets), expected, atol=1e-9)


def test_a_weight_scales_its_term():
    options = {"onset_timing_coefficient": 0.0, "loudness_coefficient": 0.5}
    task = begin(DUE, Onset(1, 0.02), **options)
    steps = [task.step(np.zeros((1, NUM_KEYS + 1))) for _ in range(2)]
    assert "onset_timing" not in steps[1].terms
    assert steps[1].terms["loudness"] == [0.5]
    assert steps[1].reward == sum(steps[1].terms.values())


def test_environments_play_their_notes_at_their_own_steps():
    """The second begins a step later, and the first begins anew."""
    task = begin(DUE, Onset(1, 0.02), num_envs=2, **REWARDED)
    ctrl = np.zeros((2, NUM_KEYS + 1))
    task.step(ctrl, [0])
    assert task.step(ctrl).terms["onset_timing"][0] == 1
    assert_array_equal(task.step(ctrl).terms["onset_timing"], [0, 1])
    task.reset([np.random.default_rng(0)], [0])
    task.step(ctrl)
    assert_array_equal(task.step(ctrl).terms["onset_timing"], [1, 0])


def test_terms_of_ones_own_are_given_the_errors():
    def late(outcome: Any) -> np.ndarray:
        return np.nansum(outcome.onset_errors.time, axis=1)

    scene = SceneConfig(hands="none")
    task = PianoTask(
        [DUE],
        TaskConfig(trim_silence=False, initial_buffer_time=0.0),
        scene,
        reward_terms={"late": late},
        make_simulation=PlayedPiano,
    )
    task.simulation.onsets = (Onset(2, 0.001),)
    task.reset([np.random.default_rng(0)], [0])
    values = [task.step(np.zeros((1, NUM_KEYS + 1))).terms["late"][0] for _ in range(4)]
    assert_allclose(values, [0, 0, 0.031, 0], atol=1e-9)
