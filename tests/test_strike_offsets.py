"""Lateral accuracy of strikes."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import play_episode
from cadenza.episode import Episode
from cadenza.keyboards.piano import PIANO
from cadenza.music.libraries.library import load_score
from cadenza.music.performance import played_in
from cadenza.music.score import Note
from cadenza.scene.config import SceneConfig
from cadenza.scene.drawing import drawing
from cadenza.scene.scene import build_scene
from cadenza.tasks.piano_task import PianoTask

TOOLS = Path(__file__).parents[1] / "tools"
strike_offsets = runpy.run_path(str(TOOLS / "strike_offsets.py"))["strike_offsets"]
KEYS = {"keys": drawing(build_scene(SceneConfig(hands="none")))["keys"]}
C4, STEPS = 60 - 21, 20
LEFT_OF_C_SHARP = PIANO.centre[C4 + 1, 1] - PIANO.half_size[C4 + 1, 1]
BLACK_FRONT = PIANO.centre[C4 + 1, 0] + PIANO.half_size[C4 + 1, 0]


def offset(x, y, start=0.5, speed=0.0):
    """The offset of C4 struck at `start` [s] by a fingertip that is at y then, and moves.

    The others are 30 mm above the middle of the key.
    """
    tips = np.empty((STEPS, 10, 3))
    tips[:] = x, PIANO.centre[C4, 1], 0.05
    tips[:, 2, 1] = y + speed * (0.05 * np.arange(1, STEPS + 1) - start)
    tips[:, 2, 2] = 0.02
    arrays = {"action": np.zeros((STEPS, 1)), "fingertip_xpos": tips}
    return strike_offsets(Episode("one note", 0.05, arrays, KEYS), [Note(start, 0.8, 60)])


def test_a_fingertip_in_front_of_black_keys_has_the_whole_key():
    assert offset(0.06, PIANO.centre[C4, 1] - 0.002) == pytest.approx(0.002)


def test_a_fingertip_between_black_keys_has_what_they_leave():
    left = PIANO.centre[C4, 1] - PIANO.half_size[C4, 1]  # there is no black key between B and C
    middle = (left + LEFT_OF_C_SHARP) / 2
    assert offset(BLACK_FRONT - 0.01, middle + 0.003) == pytest.approx(0.003)


def test_a_fingertip_is_where_it_is_when_its_key_begins_to_sound():
    at_once = offset(0.06, PIANO.centre[C4, 1] + 0.004, start=0.47, speed=0.5)
    assert at_once == pytest.approx(0.004)


@pytest.mark.parametrize("fingering", ["found", "score"])
def test_the_planner_strikes_twinkle_within_3_mm_whoever_chose_its_fingers(fingering):
    task = PianoTask([load_score("TwinkleTwinkleLittleStar")])
    planner = Planner(PlannerConfig(fingering=fingering))
    episode = play_episode(task, planner, 0).episode
    offsets = strike_offsets(episode, played_in(episode).notes)
    assert np.mean(offsets < 0.003) > 0.8
