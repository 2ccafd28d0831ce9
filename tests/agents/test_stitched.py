"""Stitched motions: that they are the same in every octave, repeat, and play simple music."""

import time

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.agents.agent import Agent
from cadenza.agents.baselines.motions import KeyChange, Motions, changes_of, stitched
from cadenza.agents.baselines.plan_follower import PlanFollower
from cadenza.agents.baselines.stitched import Stitched
from cadenza.agents.planner.plan.presses import Press
from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.kinematics import TIP, Kinematics
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View

DT = 0.05
LINE = Score(
    tuple(Note(0.4 * i, 0.4 * (i + 1), pitch) for i, pitch in enumerate((60, 64, 64, 77))),
    (),
    "A line",
)


RIGHT = SceneConfig(hands="right")


def played(agent: Agent, scene: SceneConfig = RIGHT) -> EpisodeResult:
    task = TaskConfig(initial_buffer_time=0.5, repeats="shortened")
    return play_episode(PianoTask([LINE], task, scene), agent)


@pytest.fixture(scope="module")
def motions():
    return Motions(build_scene(RIGHT), DT)


class Kept(Stitched):
    """An agent that keeps its plans."""

    planned: PlanFollower

    def begin(self, view: View, rng: np.random.Generator) -> PlanFollower:
        self.planned = super().begin(view, rng)
        return self.planned


def test_a_line_is_played_with_a_repeated_note_and_a_leap_without_looking():
    agent = Kept()
    result = played(agent)
    assert result.metrics["f1"] > 0.9
    assert result.metrics["note_onset_f1"] == 1.0
    actions = result.episode["action"]
    assert_array_equal(actions[:, :-1], agent.planned.plan.nominal.tracking.ctrl)
    assert_array_equal(actions, played(Stitched()).episode["action"])  # the same bits again


def test_a_motion_is_the_same_in_every_octave(motions):
    low, high = (
        KeyChange(((0, key),), ((0, key),), ((0, key), (2, key + 4)), 0) for key in (27, 51)
    )
    before = len(motions)
    one, other = motions.of(low), motions.of(high)
    assert len(motions) == before + 1
    slide = servos_of(build_scene(RIGHT)).along_keyboard[0]
    assert_array_equal(np.delete(one, slide, axis=1), np.delete(other, slide, axis=1))
    octave = 7 * 0.0235  # seven white keys
    assert_allclose(np.abs(other[:, slide] - one[:, slide]), 2 * octave, atol=1e-9)


def test_fingertips_are_on_the_keys_that_are_held(motions):
    scene = build_scene(RIGHT)
    presses = [Press("right", 1, 39, 8, 14), Press("right", 2, 40, 14, 18)]
    rest = np.zeros(len(scene.actuator_names))
    postures = stitched(presses, motions, rest, 22)
    assert_array_equal(postures[0], rest)
    tips = Kinematics(scene).points(postures)[:, :, TIP]
    for press in presses:
        held = tips[press.first : press.last, press.finger]
        assert_allclose(held[:, 1], scene.keyboard.centre[press.key, 1], atol=0.004)
        top = scene.keyboard.centre[press.key, 2] + scene.keyboard.half_size[press.key, 2]
        assert (held[:, 2] < top + 0.004).all()
    for t in (7, 18):  # before and after
        assert tips[t, presses[t > 7].finger, 2] > 0.03


def test_letting_go_and_striking_soon_after_are_one_change():
    first = Press("right", 1, 39, 2, 6)
    again = Press("right", 1, 39, 7, 9)
    later = Press("right", 0, 36, 20, 22)
    held, other = ((1, 39),), ((0, 36),)
    assert list(changes_of([first, again, later], 30, longest_gap=4)) == [
        (2, KeyChange((), (), held, 0)),
        (6, KeyChange(held, (), held, 1)),
        (9, KeyChange(held, (), (), 0)),
        (20, KeyChange((), (), other, 0)),
        (22, KeyChange(other, (), (), 0)),
    ]


def test_the_time_that_changes_take_grows_with_the_song_and_not_with_its_square():
    def seconds(count: int) -> float:
        presses = [Press("right", i % 5, 30 + i % 11, 4 * i, 4 * i + 3) for i in range(count)]
        begin = time.process_time()
        changes = list(changes_of(presses, 4 * count, longest_gap=4))
        assert len(changes) == count + 1
        return time.process_time() - begin

    short, long = (min(seconds(count) for _ in range(3)) for count in (500, 4000))
    assert long < 30 * short  # and not 64 times


def test_hands_that_do_not_slide_are_told_apart():
    with pytest.raises(CadenzaError, match="add tx"):
        played(Stitched(), SceneConfig(hands="right", forearm_dofs=("ty",)))
