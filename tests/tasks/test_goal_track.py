"""Tracks and their goals: computed once for all who need them."""

import pickle
import weakref
from contextlib import closing

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cadenza.agents.agent import ZeroAgent
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.rollout import play_episode
from cadenza.fingers import Finger
from cadenza.learning.observation import GoalTable
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks import goal_track
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from watched import watched

CONFIG = TaskConfig(initial_buffer_time=0.33)
SONG = Score(tuple(Note(0.2 * i, 0.2 * i + 0.2, pitch) for i, pitch in enumerate((60, 64, 67))))
GIVEN = SONG.with_fingers([Finger(0, 0), Finger(0, 2), Finger(0, 4)])
CLUSTER = Score(tuple(Note(0.0, 0.5, pitch) for pitch in range(40, 60)))


def begun(song: Score, **options: object) -> PianoTask:
    task = PianoTask([song], CONFIG, SceneConfig(**options), num_envs=3)  # type: ignore[arg-type]
    task.reset(np.random.default_rng(0).spawn(3), range(3))
    return task


def test_all_share_the_goals_of_a_song(monkeypatch):
    made = watched(monkeypatch, goal_track, "score_to_goals")
    task = begun(SONG, hands="right")
    plan = plan_song(task.view().tracks[1], task.state.hand_qpos[1])
    GoalTable(task.spec, task.tracks)
    task.reset(np.random.default_rng(1).spawn(3), range(3))
    assert plan.goals is task.view().tracks[2].goals
    assert len(made) == 1


def test_goals_are_not_kept_when_nobody_has_them():
    task = begun(SONG, hands="none")
    track, goals = task.tracks[0], weakref.ref(task.tracks[0].goals)
    assert goals() is not None
    del task
    assert goals() is None
    assert_array_equal(track.goals.keys.sum(axis=0)[[39, 43, 46]], [4, 4, 4])


def test_notes_begin_after_the_silence():
    task = begun(SONG, hands="none")
    (track,) = task.tracks
    steps = [track.first_step(note) for note in SONG.notes]
    assert steps == [7, 11, 15]
    assert track.goals.keys[steps, [39, 43, 46]].all()
    assert not track.goals.keys[np.array(steps) - 1, [39, 43, 46]].any()
    assert track.delayed_score.notes[1].start == 0.55


def test_says_which_notes_no_finger_is_there_for():
    (track,) = begun(CLUSTER).tracks
    assert {note for note, _ in track.dropped or ()} == {
        note for note in track.score.notes if note.finger is None
    }
    assert track.fingered() is track
    assert track.with_score(CLUSTER).fingered().score == track.score


@pytest.mark.parametrize(
    ("song", "fingering", "hands", "rewarded"),
    [
        (GIVEN, "auto", "both", "score"),
        (SONG, "auto", "both", "search"),
        (GIVEN, "robot", "both", "search"),
        (GIVEN, "human", "both", "search"),
        (GIVEN, "transport", "both", "transport"),
        (GIVEN, "off", "both", "off"),
        (GIVEN, "auto", "none", "off"),
    ],
)
def test_says_whose_fingers_are_rewarded(song, fingering, hands, rewarded):
    with closing(PianoTask([song], TaskConfig(fingering=fingering), SceneConfig(hands=hands))) as t:
        assert t.tracks[0].rewarded_fingers == rewarded
        metrics = play_episode(t, ZeroAgent(), stop=lambda: True).metrics
    assert metrics["rewarded_fingers"] == rewarded
    assert ("reward/fingering" in metrics) == (rewarded != "off")


def test_can_be_pickled():
    track = begun(SONG).tracks[0]
    assert_array_equal(pickle.loads(pickle.dumps(track)).goals.keys, track.goals.keys)
