"""The search of one hand that plays ahead and restarts."""

import sys
from types import ModuleType

import numpy as np
import pytest
from one_hand import DT, OneHand

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.search import search_ahead
from cadenza.agents.planner.search.hand_process import HandProcess
from cadenza.agents.planner.search.hand_search import HandSearch
from cadenza.agents.planner.search.search_ahead import HandState, RestartingSearch, SearchAhead
from cadenza.errors import CadenzaError
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import Note, Score
from cadenza.scene.scene import hand_alone
from melodies import melody
from watched import watched

SONG = melody(60, 62, 64, 65)
STEPS = 40
HELD = slice(37, 40)  # steps in which the last note sounds


def search_of(hand: OneHand) -> HandSearch:
    return HandSearch(hand.plan, "right", np.random.default_rng(0), PlannerConfig())


def ahead_of(hand: OneHand) -> SearchAhead:
    alone = hand_alone(hand.plan.scene, "right")
    return SearchAhead(RestartingSearch(search_of(hand), DT), hand.plan, alone, DT)


def play(hand: OneHand, ahead: SearchAhead, steps: range) -> np.ndarray:
    """The keys (T, K) that sound after each step."""
    sounding = []
    for step in steps:
        hand.simulation.step(ahead.act(HandState(step, *hand.joint_state))[None])
        sounding.append(hand.simulation.state.key_qpos[0] >= PIANO.sounds_from)
    return np.array(sounding)


def test_where_no_note_goes_wrong_it_plays_as_step_by_step():
    hand, alone = OneHand(SONG), OneHand(SONG)
    search, ahead = search_of(alone), ahead_of(hand)
    for step in range(STEPS):
        ctrl = ahead.act(HandState(step, *hand.joint_state))
        expected = search.act(*alone.joint_state)
        np.testing.assert_array_equal(ctrl, expected)
        hand.simulation.step(ctrl[None])
        alone.simulation.step(expected[None])


@pytest.mark.parametrize("push", [0.003, 0.03])
def test_a_hand_that_is_pushed_comes_back_or_goes_on_from_where_it_is(push):
    hand = OneHand(SONG)
    ahead = ahead_of(hand)
    play(hand, ahead, range(13))
    qpos, qvel, keys = hand.joint_state
    hand.simulation.set_joints(qpos + push, qvel, keys)
    sounding = play(hand, ahead, range(13, STEPS))[-3:]
    assert sounding[:, 65 - 21].all()
    assert sounding.sum() == len(sounding)


def test_it_goes_back_where_a_note_goes_wrong_and_no_more_often_than_it_may(monkeypatch):
    out_of_reach = Score(
        tuple(Note(0.2 * i, 0.2 * i + 0.2, (45, 88)[i % 2]) for i in range(8)),
    )
    hand, went_back = OneHand(out_of_reach), watched(monkeypatch, HandSearch, "restore")
    play(hand, ahead_of(hand), range(STEPS))
    windows = STEPS / 10
    most = search_ahead.RESTARTS + windows * search_ahead.RESTARTS_PER_WINDOW
    assert windows < len(went_back) <= windows + most  # once in each to where the window ends


@pytest.mark.parametrize("pushed", [False, True])
def test_another_process_finds_the_same_bits(pushed):
    """Even where it has looked further ahead than the scene when that is pushed."""
    here, there, process = OneHand(SONG), OneHand(SONG), HandProcess()
    process.search(there.plan, "right", np.random.default_rng(0), PlannerConfig())
    assert process.is_ready()
    alone = hand_alone(there.plan.scene, "right")
    ahead, elsewhere = ahead_of(here), SearchAhead(process, there.plan, alone, DT)
    for step in range(STEPS):
        if pushed and step == STEPS // 3:
            for hand in here, there:
                qpos, qvel, keys = hand.joint_state
                hand.simulation.set_joints(qpos + 0.03, qvel, keys)
        ctrl = ahead.act(HandState(step, *here.joint_state))
        action = elsewhere.act(HandState(step, *there.joint_state))
        np.testing.assert_array_equal(action, ctrl)
        here.simulation.step(ctrl[None])
        there.simulation.step(ctrl[None])


def test_a_process_that_is_lost_is_told_in_one_line(monkeypatch):
    monkeypatch.setattr(sys, "executable", "true")  # a process that ends at once
    hand, process = OneHand(SONG), HandProcess()
    process.search(hand.plan, "right", np.random.default_rng(0), PlannerConfig())
    assert not process.is_ready()
    with pytest.raises(CadenzaError, match=r"right hand ended unexpectedly.*--num-threads 1"):
        process.act(HandState(0, *hand.joint_state))


class Unknown:
    """Something of a module that only this process has."""


@pytest.mark.parametrize("scene", [Unknown(), lambda: None])
def test_what_only_this_process_knows_is_searched_for_here(scene, monkeypatch, capfd):
    """Such as a hand of a notebook, or one that a script has registered."""
    nowhere = ModuleType("nowhere")
    monkeypatch.setattr(Unknown, "__module__", "nowhere")
    monkeypatch.setattr(nowhere, "Unknown", Unknown, raising=False)
    monkeypatch.setitem(sys.modules, "nowhere", nowhere)
    hand, process = OneHand(SONG), HandProcess()
    plan = hand.plan._replace(scene=scene)
    process.search(plan, "right", np.random.default_rng(0), PlannerConfig())
    assert not process.is_ready()
    assert capfd.readouterr().err == ""
