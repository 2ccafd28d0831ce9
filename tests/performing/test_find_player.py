"""Who plays, and what it knows, without playing anything."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cadenza.agents.agent import ZeroAgent
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.registry import PLANNER
from cadenza.errors import CadenzaError
from cadenza.fingers import LEFT, RIGHT, Finger
from cadenza.music.arrangement import Arrangement, LoadedSong
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.performing.setup import find_player
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

TREBLE = Note(0.0, 1.0, 76, hands=(RIGHT,))
BASS = Note(0.0, 1.0, 40, hands=(LEFT,))


def song(*notes: Note, **arrangement: Any) -> LoadedSong:
    return LoadedSong("song", Score(notes), Arrangement(**arrangement))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"agent": "nobody"}, "nobody"),
        ({"agent": "playback"}, "give both or neither"),
        ({"agent": ZeroAgent(), "plan": Path("plan.npz")}, "give both or neither"),
        ({"agent": ZeroAgent}, "is a class"),
        ({"agent": "pretrained", "song": "nothing"}, "no pretrained policy for 'nothing'"),
        ({"configs": {PLANNER: PlannerConfig(iterations=0)}}, "iterations 0"),
    ],
)
def test_who_cannot_play_is_told(given, message):
    with pytest.raises(CadenzaError, match=message):
        find_player(**given)


def test_the_planner_plays_by_default_with_its_options():
    player = find_player(configs={PLANNER: PlannerConfig(iterations=3)})
    assert (player.name, player.agent.config.iterations) == (PLANNER, 3)
    assert player.known(song(TREBLE)) is None


def test_a_player_goes_to_another_task_and_another_scene():
    policy = find_player("pretrained", "OdeToJoy")
    moved = policy.playing_in(None, SceneConfig(hands="right"))
    assert (moved.task, moved.scene.hands) == (policy.task, "right")
    assert moved.playing_in(TaskConfig(stretch=2.0), None).scene == moved.scene
    with pytest.raises(CadenzaError, match="give a TaskConfig"):
        policy.playing_in("fast", None)  # type: ignore[arg-type]


def test_what_was_learnt_is_known_with_other_fingers_and_from_the_whole_song():
    player = replace(find_player(ZeroAgent()), scene=SceneConfig(hands="right"), song=song(TREBLE))
    fingered = song(replace(TREBLE, finger=Finger(RIGHT, 1)))
    assert player.known(fingered) is fingered
    both = player.known(song(TREBLE, BASS))
    assert both is not None
    assert both.score.notes == (TREBLE,)
    assert player.known(song(TREBLE, BASS, all_notes=True)) is None
    pedalled = LoadedSong("song", Score((TREBLE,), (PedalEvent(0.5, 127),)))
    assert player.known(pedalled) is None
    with pytest.raises(CadenzaError, match="nothing is written for the right hand"):
        player.known(song(BASS))
