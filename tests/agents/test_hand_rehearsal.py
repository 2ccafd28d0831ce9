"""A hand rehearses a second of its plan before it plays it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.fingertip_correction import mending
from cadenza.agents.planner.search.hand_rehearsal import HandRehearsal
from cadenza.agents.planner.search.horizon_cost import HorizonCost, Rollout
from cadenza.keyboards.piano import PIANO
from cadenza.music.libraries.library import load_score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, hand_alone
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

DT = 0.05  # [s]
OFF = 0.03  # [m] of the forearm's controls


class Rehearsed:
    """The right hand before a song, which it rehearses from its beginning."""

    def __init__(self, song: str) -> None:
        task = PianoTask(
            [load_score(song)], TaskConfig(initial_buffer_time=0.5), SceneConfig(hands="right")
        )
        (track,) = task.tracks
        start = task.state.hand_qpos[0]
        self.plan: SongPlan = plan_song(track.with_found_fingers(), start)
        self.scene: Scene = hand_alone(self.plan.scene, "right").scene
        self.tracking = self.plan.nominal.tracking
        self.simulation = PlanningSimulation(self.scene, 1, DT)
        self.simulation.place(start, np.zeros_like(start), np.zeros(88))
        self.trials = HandRollouts(self.scene, DT)
        self.rehearsal = HandRehearsal(self.scene, self.trials, DT)

    def go_astray(self) -> None:
        """Plans with the forearm beside where it should be, and no feedback."""
        ctrl, gain, expected = self.tracking
        off = np.zeros_like(ctrl)
        off[:, -2:] = OFF
        self.tracking = Tracking(ctrl + off, 0.0 * gain, expected)

    def rehearse(self) -> int:
        rows = np.arange(self.rehearsal.steps_seen)
        self.trials.begin_from(self.simulation, -1.0, 1.0)
        part, keys = HandGoals(self.plan, "right"), self.trials.keys
        ahead = HorizonCost(part, rows, PIANO, keys, np.zeros(88)[keys])
        return self.rehearsal.rehearse(self.tracking, rows, ahead)


def test_what_goes_well_is_played_once_and_foreseen() -> None:
    hand = Rehearsed("TwinkleTwinkleLittleStar")
    assert hand.rehearse() == hand.rehearsal.steps_seen
    assert hand.rehearsal.ends == 20
    np.testing.assert_array_equal(hand.rehearsal.ctrl(0), hand.tracking.ctrl[:20])
    for step in range(10):
        qpos, qvel = hand.simulation.state.hand_qpos[0], hand.simulation.state.hand_qvel[0]
        assert hand.rehearsal.foresaw(step, qpos) == (step > 0)
        assert not hand.rehearsal.foresaw(step, qpos + 0.01)
        posture = np.linalg.pinv(hand.rehearsal._servos.joints).T @ np.stack([qpos, qvel], axis=1)
        ctrl = hand.rehearsal.ctrl(step)[0] - hand.tracking.feedback(step, posture)
        hand.simulation.step(hand.rehearsal._servos.clip(ctrl)[None])
    assert hand.rehearsal.ctrl(10).shape == (10, hand.tracking.ctrl.shape[1])


def test_a_finger_that_is_off_its_key_is_put_right(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = Rehearsed("TwinkleTwinkleLittleStar")
    hand.go_astray()
    takes, play = list[Rollout](), hand.rehearsal._play

    def noted(*args: Any) -> Rollout:
        takes.append(play(*args))
        return takes[-1]

    monkeypatch.setattr(hand.rehearsal, "_play", noted)
    hand.rehearse()
    assert takes[0].mistakes > 0
    assert min(take.mistakes for take in takes) < takes[0].mistakes / 2
    assert not np.array_equal(hand.rehearsal.ctrl(0), hand.tracking.ctrl[:20])


def test_rehearsing_leaves_the_plan_as_it_is() -> None:
    hand = Rehearsed("CMajorScaleOneHand")
    before = hand.tracking.ctrl.copy()
    hand.rehearse()
    np.testing.assert_array_equal(hand.tracking.ctrl, before)
    hand.rehearsal.forget()
    assert hand.rehearsal.ends == 0
    assert len(hand.rehearsal.ctrl(7)) == 0


# Where fingertips should have been


class Played:
    """Twinkle, with fingertips just where the plan has them, and keys as it holds them."""

    def __init__(self) -> None:
        self.part = HandGoals(Rehearsed("TwinkleTwinkleLittleStar").plan, "right")
        self.steps = np.arange(30)
        self.tips = self.part.fingertips[self.steps + 1]
        self.sounding = (self.part.mine & self.part.planned)[self.steps]

    def off(self) -> tuple[np.ndarray, np.ndarray]:
        return mending(self.part, self.steps, PIANO, slice(None), self.tips, self.sounding)


def test_who_plays_as_planned_has_nothing_to_mend() -> None:
    off, weight = Played().off()
    assert (off == 0.0).all()
    assert weight.max() == 1.0


def test_a_finger_whose_key_is_silent_should_have_been_deeper() -> None:
    played = Played()
    step, key = np.argwhere(played.sounding)[2]
    finger = played.part.asked[step, key]
    played.sounding[step, key] = False
    off, weight = played.off()
    assert np.argwhere(off).tolist() == [[step, finger, 2]]
    assert off[step, finger, 2] < -0.003
    assert weight[step, finger] == 1.0


def test_a_finger_on_a_key_that_should_be_silent_should_have_been_higher() -> None:
    played = Played()
    step, key = 2, 40  # before anything sounds
    assert played.part.wrong[step, key]
    played.sounding[step, key] = True
    assert (played.off()[0] == 0.0).all()  # no finger is near
    played.tips[step, 3, :2] = PIANO.centre[key, :2]
    off, weight = played.off()
    assert (off[step - 1 : step + 1, 3, 2] > 0.003).all()
    assert (weight[step - 1 : step + 1, 3] == 1.0).all()
    assert (off[[step - 2, step + 1]] == 0.0).all()
