"""Hands of other kinds, in other places and at other keyboards."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from cadenza.fingering.players import Players, players_at
from cadenza.fingering.search import find_fingering
from cadenza.fingers import SIDES, Finger
from cadenza.hands.reach import Reach
from cadenza.hands.shadow import SHADOW
from cadenza.keyboards.piano import PIANO
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.goal_track import players_of
from melodies import melody
from numbered import numbers
from players import FOUR_FINGERS, TWO_OCTAVES, shadow_hands

FOUR = players_at(FOUR_FINGERS, PIANO, SIDES, hand_spacing=0.3, slides=True)
scale = partial(melody, length=0.5)
OUT_OF_REACH = "out of reach of both hands"


def fingers(score: Score, players: Players) -> list[int]:
    return numbers(find_fingering(score, players)[0])


# Hands that cannot spread their fingers


def test_fingers_that_stand_over_neighbouring_white_keys_play_them():
    rest = PIANO.spacing * np.arange(-1, 2)
    apart = np.maximum(rest - rest[:, None], 0.0).round(4)
    stiff = Reach(rest, least=apart, most=apart, outward=-rest, inward=rest, forearm_width=0.1)
    players = players_at(stiff, PIANO, ["right"], hand_spacing=0.3, slides=True)
    assert fingers(scale(60, 62, 64, 62, 60), players) == [0, 1, 2, 1, 0]


# Hands that do not slide


@pytest.mark.parametrize("spacing", [0.2, 0.3, 0.6])
def test_a_hand_that_does_not_slide_plays_what_is_before_it(spacing):
    players = shadow_hands(hand_spacing=spacing, slides=False)
    everything = scale(*range(21, 109))
    played = {n.pitch: n.finger for n in find_fingering(everything, players)[0].notes}
    for hand, side in enumerate((1, -1)):
        own = [p for p, finger in played.items() if finger and finger.hand == hand]
        away = [side * PIANO.grid_y[p - 21] - spacing / 2 for p in own]
        assert -max(SHADOW.reach.outward) <= min(away) < -0.05
        assert 0.1 < max(away) <= max(SHADOW.reach.inward)


def test_what_it_does_not_reach_is_dropped_and_said_to_be():
    twinkle = load_score("TwinkleTwinkleLittleStar").without_fingers()
    fingered, dropped = find_fingering(twinkle, shadow_hands(slides=False))
    assert {d.reason for d in dropped} == {OUT_OF_REACH}
    assert {n.pitch for n in fingered.notes if n.finger} == {60, 69}
    assert not find_fingering(twinkle, shadow_hands(hand_spacing=0.15, slides=False))[1]


def test_it_plays_with_the_finger_before_the_key():
    """Or, where that is a weak one, with its neighbour."""
    players = shadow_hands(["right"], hand_spacing=0.0, slides=False)
    for finger, rest in enumerate(SHADOW.reach.rest):
        distance = abs(PIANO.grid_y - rest) + PIANO.is_black
        (number,) = fingers(scale(int(distance.argmin()) + 21), players)
        assert number == finger if finger < 3 else finger - 1 <= number <= finger


def test_mirrored_hands_that_do_not_slide():
    players = shadow_hands(slides=False)
    white = [pitch for pitch in range(21, 109) if not PIANO.is_black[pitch - 21]]
    right, left = (fingers(scale(*pitches), players) for pitches in (white, white[::-1]))
    assert right == [f if f < 0 else (f + 5) % 10 for f in left]


def test_forearms_that_touch_whatever_they_do():
    """Mounted too close to each other, they play all the same."""
    for slides in (False, True):
        players = shadow_hands(hand_spacing=0.05, slides=slides)
        assert not find_fingering(scale(60, 64, 67), players)[1]


@pytest.mark.parametrize("dofs", [("tx", "ty"), ("ty",)])
def test_players_are_those_of_the_scene(dofs):
    scene = build_scene(SceneConfig(hands="left", forearm_dofs=dofs, hand_spacing=0.4))
    right, left = players_of(scene).forearms
    assert right is None
    assert left.home == pytest.approx(-0.2)
    assert (left.low < -0.6 and left.high > 0.6) == ("tx" in dofs)


# Other hands and keyboards


def test_a_hand_of_four_fingers():
    everything = Score(tuple(Note(0, 1, pitch) for pitch in range(21, 109)))
    fingered, dropped = find_fingering(everything, FOUR)
    assert [n.finger for n in fingered.notes if n.finger] == [
        *(Finger(1, index) for index in (3, 2, 1, 0)),
        *(Finger(0, index) for index in (0, 1, 2, 3)),
    ]
    assert {d.reason for d in dropped} == {"more than 8 notes at once for both hands"}


def test_fingers_that_a_hand_does_not_have_are_found_anew():
    written = load_score("OdeToJoy")
    assert 4 in {note.finger.index for note in written.notes}
    fingered, dropped = find_fingering(written, FOUR)
    assert not dropped
    for before, after in zip(written.notes, fingered.notes, strict=True):
        assert after.finger == before.finger or before.finger.index == 4
        assert after.finger.index < 4


def test_a_smaller_keyboard_has_its_keys_elsewhere():
    small = players_at(SHADOW.reach, TWO_OCTAVES, SIDES, hand_spacing=0.3, slides=True)
    fingered, dropped = find_fingering(scale(47, 48, 72, 73), small)
    assert [d.note.pitch for d in dropped] == [47, 73]
    assert {d.reason for d in dropped} == {"not on this keyboard"}
    assert [n.finger.hand for n in fingered.notes[1:3]] == [1, 0]
    wide = replace(TWO_OCTAVES, gap=0.03)  # no hand spans an octave of it
    chord = Score((Note(0, 1, 48), Note(0, 1, 60), Note(0, 1, 72)))
    wider = players_at(SHADOW.reach, wide, SIDES, hand_spacing=0.3, slides=True)
    assert not find_fingering(chord, small)[1]
    assert len(find_fingering(chord, wider)[1]) == 1


def test_forearms_in_the_way_are_told():
    """Of hands with four fingers, eight notes at once."""
    score = Score(tuple(Note(0, 1, pitch) for pitch in (41, 42, 43, 44, 45, 46, 47, 51)))
    allegro = players_of(build_scene(SceneConfig(hand="allegro")))
    _, dropped = find_fingering(score, allegro)
    assert [(d.note.pitch, d.reason) for d in dropped] == [
        (44, "the forearms would run into each other")
    ]


@pytest.mark.parametrize(
    "config", [SceneConfig(), SceneConfig(hand="allegro-narrow", keyboard="mini", hand_spacing=0.2)]
)
def test_forearms_are_thought_to_slide_as_far_as_they_do(config):
    scene = build_scene(config)
    players = players_of(scene)
    for hand, prefix in enumerate(("rh", "lh")):
        forearm = players.forearms[hand]
        assert forearm is not None
        low, high = scene.model.joint(f"{prefix}_forearm_tx").range + forearm.home
        assert (forearm.low, forearm.high) == pytest.approx((low, high))
