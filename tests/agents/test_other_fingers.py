"""Other fingers: passages are told apart, and of each the fingers are kept that lose less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cadenza.agents.planning.other_fingers import Pieced, fingers_in, passages_of, with_fingers
from cadenza.fingering.changes import Costs
from cadenza.fingers import Finger
from cadenza.music.score import Note, Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack

SCENE = build_scene()
THUMB, INDEX = Finger(0, 0), Finger(0, 1)
SONG = Score(tuple(Note(0.5 * i, 0.5 * i + 0.4, 60 + i % 7, 80, THUMB) for i in range(16)))


def track_of(score: Score) -> GoalTrack:
    return GoalTrack(score, (), TaskConfig(initial_buffer_time=0.5), SCENE, found=True)


def with_index(*those: int) -> GoalTrack:
    """The song, in which some notes are played by another finger."""
    notes = (replace(n, finger=INDEX) if i in those else n for i, n in enumerate(SONG.notes))
    return track_of(replace(SONG, notes=tuple(notes)))


ALL_THUMBS = track_of(SONG)


@given(st.sets(st.integers(0, len(SONG.notes) - 1)))
def test_each_note_with_another_finger_is_in_one_passage(those: set[int]) -> None:
    passages = passages_of(ALL_THUMBS, with_index(*those).score)
    assert [i for passage in passages for i in passage.notes] == sorted(those)
    judged = [step for passage in passages for step in range(10_000)[passage.steps]]
    assert len(judged) == len(set(judged))
    for passage in passages:
        for i in passage.notes:
            sounds = ALL_THUMBS.first_step(SONG.notes[i])
            assert passage.steps.start <= sounds < passage.steps.stop


def test_of_each_passage_the_fingers_are_kept_that_lose_less() -> None:
    other = with_index(1, 2, 12)
    early, late = passages_of(ALL_THUMBS, other.score)
    steps = ALL_THUMBS.goals.num_steps
    loss, other_loss = np.full((steps, 2), 0.1), np.full((steps, 2), 0.1)
    other_loss[early.steps], other_loss[late.steps] = 0.2, 0.0
    pieced = Pieced(ALL_THUMBS, loss).with_better(other.score, other_loss)
    assert pieced.track.score == with_index(12).score
    assert pieced.loss.sum() == pytest.approx(loss.sum() - loss[late.steps].sum())
    assert loss.all()  # is as it was


def test_other_fingers_are_looked_for_only_where_something_is_lost() -> None:
    other_costs = Costs(way=64.0, same_finger=0.0)
    steps = ALL_THUMBS.goals.num_steps
    nothing = Pieced(ALL_THUMBS, np.zeros((steps, 2)))
    assert nothing.others(other_costs).score == SONG
    assert Pieced(ALL_THUMBS, np.ones((steps, 2))).others(other_costs).score != SONG
    lost = np.zeros((steps, 2))
    lost[-3:] = 1.0
    changed = Pieced(ALL_THUMBS, lost).others(other_costs)
    assert all(lost[passage.steps].any() for passage in passages_of(ALL_THUMBS, changed.score))


def test_fingers_are_kept_as_numbers() -> None:
    other = with_index(3, 4)
    assert with_fingers(ALL_THUMBS, fingers_in(other)).score == other.score
