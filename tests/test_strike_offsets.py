"""Lateral accuracy of strikes."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from cadenza.episode import Episode
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import Note
from cadenza.scene.config import SceneConfig
from cadenza.scene.drawing import drawing
from cadenza.scene.scene import build_scene

TOOLS = Path(__file__).parents[1] / "tools"
strike_offsets = runpy.run_path(str(TOOLS / "strike_offsets.py"))["strike_offsets"]
KEYS = {"keys": drawing(build_scene(SceneConfig(hands="none")))["keys"]}
C4, STEPS = 60 - 21, 20
LEFT_OF_C_SHARP = PIANO.centre[C4 + 1, 1] - PIANO.half_size[C4 + 1, 1]
BLACK_FRONT = PIANO.centre[C4 + 1, 0] + PIANO.half_size[C4 + 1, 0]


def offset(x, y, start=0.5, speed=0.0, finger=2):
    """The offset of C4 struck at `start` [s] by a fingertip that is at y then, and moves."""
    fingers = np.full((STEPS, 88), -1, np.int8)
    fingers[10:15, C4] = finger
    tips = np.ones((STEPS, 10, 3))
    tips[:, 2, 0] = x
    tips[:, 2, 1] = y + speed * (0.05 * np.arange(1, STEPS + 1) - start)
    arrays = {"action": np.zeros((STEPS, 1)), "goal_fingers": fingers, "fingertip_xpos": tips}
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


def test_a_key_that_no_finger_is_to_press_tells_nothing():
    assert not len(offset(0.06, 0.0, start=0.2))
    assert not len(offset(0.06, 0.0, finger=-1))
