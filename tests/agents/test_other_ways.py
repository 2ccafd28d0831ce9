"""Other ways to play a song: of each passage, the one is kept that loses less."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cadenza.agents.planning.other_ways import Passage, Pieced, Way, passages_of
from cadenza.fingering.changes import Costs
from cadenza.fingers import Finger
from cadenza.music.score import Note, Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack

THUMB, INDEX, LEFT_THUMB = 0, 1, 5
SONG = Score(tuple(Note(0.5 * i, 0.5 * i + 0.4, 60 + i % 7, 80, Finger(0, 0)) for i in range(16)))
TRACK = GoalTrack(SONG, (), TaskConfig(initial_buffer_time=0.5), build_scene(), found=True)
STEPS = TRACK.goals.num_steps
STRIKES = [TRACK.first_step(note) for note in SONG.notes]
USUAL = Way(np.full(len(SONG.notes), THUMB), np.zeros((STEPS, 2), np.int8))
EVERYTHING = slice(STEPS)


def with_index(*notes: int) -> Way:
    fingers = USUAL.fingers.copy()
    fingers[list(notes)] = INDEX
    return USUAL._replace(fingers=fingers)


def lost(where: slice, much: float = 1.0) -> np.ndarray:
    loss = np.zeros((STEPS, 2))
    loss[where] = much
    return loss


def judged(passages: list[Passage], hand: int) -> list[int]:
    """The steps in which a hand is."""
    return [
        step for steps, hands in passages if [0, 1][hands].count(hand) for step in range(999)[steps]
    ]


@given(st.sets(st.integers(0, len(SONG.notes) - 1)))
def test_each_note_with_another_finger_is_in_one_passage(notes: set[int]) -> None:
    passages = passages_of(TRACK, USUAL, with_index(*notes))
    for hand in (0, 1):
        steps = judged(passages, hand)
        assert len(steps) == len(set(steps))
        assert {STRIKES[i] for i in notes} <= set(steps)
    assert bool(passages) == bool(notes)


def test_of_each_passage_the_fingers_are_kept_that_lose_less() -> None:
    other = with_index(1, 2, 12)
    early, late = passages_of(TRACK, USUAL, other)
    loss, other_loss = lost(EVERYTHING, 0.1), lost(EVERYTHING, 0.1)
    other_loss[early], other_loss[late] = 0.2, 0.0
    pieced = Pieced(TRACK, USUAL, loss).with_better(other, other_loss)
    assert pieced.way.is_like(with_index(12))
    assert pieced.loss.sum() == pytest.approx(loss.sum() - loss[late].sum())
    assert loss.all()  # is as it was


def test_other_fingers_are_looked_for_only_where_something_is_lost() -> None:
    other_costs = Costs(way=64.0, same_finger=0.0)
    assert Pieced(TRACK, USUAL, lost(slice(0))).with_fingers_by(other_costs).is_like(USUAL)
    everywhere = Pieced(TRACK, USUAL, lost(EVERYTHING)).with_fingers_by(other_costs)
    assert not everywhere.is_like(USUAL)
    at_the_end = Pieced(TRACK, USUAL, lost(slice(STEPS - 3, STEPS)))
    changed = at_the_end.with_fingers_by(other_costs)
    assert all(at_the_end.loss[passage].any() for passage in passages_of(TRACK, USUAL, changed))


def test_of_each_jump_the_time_to_let_go_is_kept_that_loses_less() -> None:
    loss = lost(EVERYTHING, 0.1)
    later = Pieced(TRACK, USUAL, loss).letting_go(1)
    assert (later.later[STRIKES, 0] == 1).all()
    assert not later.later[:, 1].any()  # which plays nothing
    passages = passages_of(TRACK, USUAL, later)
    assert len(passages) == len(STRIKES)
    other_loss = loss.copy()
    other_loss[passages[3]] = 0.0
    other_loss[passages[4]] = 0.2
    pieced = Pieced(TRACK, USUAL, loss).with_better(later, other_loss)
    assert np.flatnonzero(pieced.way.later[STRIKES, 0]).tolist() == [3]
    assert pieced.letting_go(2).is_like(pieced.way)  # nothing is lost there any more


def test_a_hand_lets_go_later_only_where_it_loses_something() -> None:
    third = slice(STRIKES[3] - 1, STRIKES[3] + 1)
    pieced = Pieced(TRACK, USUAL, lost(third))
    assert np.flatnonzero(pieced.letting_go(1).later[STRIKES, 0]).tolist() == [3]
    assert pieced.letting_go(2).is_like(USUAL)  # one step has not been tried
    other_hand = USUAL._replace(fingers=np.full(len(SONG.notes), LEFT_THUMB))
    changed = pieced._replace(way=other_hand).letting_go(1)
    assert changed.later[STRIKES[3]].tolist() == [0, 1]


def test_a_way_gives_the_track_its_fingers() -> None:
    fingers = [note.finger for note in with_index(3, 4).of(TRACK).score.notes]
    assert fingers == [Finger(0, int(i in (3, 4))) for i in range(len(SONG.notes))]
