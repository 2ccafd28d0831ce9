"""What is written for each hand, from a file to what is played."""

import warnings
from pathlib import Path

import mido
import pytest

from cadenza.errors import CadenzaError
from cadenza.fingers import LEFT, RIGHT
from cadenza.music.arrangement import Arrangement
from cadenza.music.score import Note, Score
from cadenza.performing.setup import Setup, find_player, set_up
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

CROSSED = (RIGHT, 40), (LEFT, 47), (RIGHT, 76)


@pytest.fixture
def piano(tmp_path):
    """A file of two tracks, of which the right hand's goes below the left hand's."""
    file = mido.MidiFile(type=1)
    for hand, name in enumerate(("RH", "LH")):
        track = mido.MidiTrack([mido.MetaMessage("track_name", name=name)])
        for each, pitch in CROSSED:
            velocity = 64 if each == hand else 0
            track.append(mido.Message("note_on", note=pitch, velocity=velocity, channel=hand))
            track.append(mido.Message("note_off", note=pitch, time=480, channel=hand))
        file.tracks.append(track)
    file.save(tmp_path / "piano.mid")
    return tmp_path / "piano.mid"


def set_up_with(song: Path | Score, all_notes: bool = False, **options) -> tuple[Setup, list[str]]:
    """The setup for the planner, and the warnings."""
    hands = options.pop("hands", "both")
    arrangement = Arrangement(all_notes=all_notes, arrange="off")
    player = find_player().playing_in(TaskConfig(**options), SceneConfig(hands=hands))
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")
        with set_up(song, player, arrangement=arrangement) as setup:
            return setup, [str(each.message) for each in messages]


def played(setup: Setup) -> list[tuple[int, int]]:
    (track,) = setup.task.tracks
    return [(note.finger.hand, note.pitch) for note in track.score.notes if note.finger]


def test_one_hand_plays_what_is_written_for_it(piano):
    setup, messages = set_up_with(piano, hands="right")
    assert played(setup) == [(RIGHT, 40), (RIGHT, 76)]
    assert any("2 notes are written for the right hand; without the other 1" in s for s in messages)
    setup, messages = set_up_with(piano, hands="left")
    assert played(setup) == [(LEFT, 47)]
    assert any("1 note is written for the left hand; without the other 2" in s for s in messages)


def test_without_hands_nothing_is_played_as_written(piano):
    setup, _ = set_up_with(piano, hands="none", hands_as_written=True)
    assert not played(setup)


def test_one_hand_plays_all_notes_on_demand_or_where_nothing_says_whose_they_are(piano):
    setup, messages = set_up_with(piano, hands="right", all_notes=True)
    assert played(setup) == [(RIGHT, 40), (RIGHT, 47), (RIGHT, 76)]
    assert not messages
    bare = Score(tuple(Note(n.start, n.end, n.pitch) for n in setup.score.notes))
    assert [pitch for _, pitch in played(set_up_with(bare, hands="left")[0])] == [40, 47, 76]


def test_hands_play_as_written_on_demand(piano):
    assert [hand for hand, _ in played(set_up_with(piano)[0])] != [hand for hand, _ in CROSSED]
    setup, messages = set_up_with(piano, hands_as_written=True)
    assert played(setup) == list(CROSSED)
    assert not messages


def test_what_the_written_hand_cannot_play_is_told():
    together = ((40, RIGHT), (60, LEFT), (64, LEFT))  # the hands would cross
    song = Score(tuple(Note(0, 1, pitch, hands=(hand,)) for pitch, hand in together))
    setup, messages = set_up_with(song, hands_as_written=True)
    assert sorted(pitch for _, pitch in played(setup)) == [40, 60, 64]
    assert messages == [": 3 notes that the written hand cannot play are left to the other"]


def test_where_nothing_says_so_hands_cannot_play_as_written():
    with pytest.raises(CadenzaError, match="nothing says which hand plays what"):
        set_up_with(Score((Note(0, 1, 60),), title="song"), hands_as_written=True)


def test_a_hand_for_which_nothing_is_written_plays_nothing():
    song = Score((Note(0, 1, 60, hands=(RIGHT,)),), title="song")
    with pytest.raises(CadenzaError, match="song: nothing is written for the left hand"):
        set_up_with(song, hands="left")
