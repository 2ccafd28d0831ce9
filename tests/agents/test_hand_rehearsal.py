"""A hand rehearses a second of its plan before it plays it."""

import numpy as np
from one_hand import DT, OneHand

from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search import hand_rehearsal
from cadenza.agents.planner.search.hand_rehearsal import HandRehearsal
from cadenza.music.libraries.library import load_score
from watched import watched

OFF = 0.03  # [m] of the forearm's controls


class Rehearsed(OneHand):
    """The right hand before a song, which it rehearses from its beginning."""

    def __init__(self, song: str) -> None:
        super().__init__(load_score(song))
        self.rehearsal = HandRehearsal(self.scene, self.simulator, DT)

    def go_astray(self) -> None:
        """Plans with the forearm beside where it should be, and no feedback."""
        ctrl, gain, expected = self.tracking
        off = np.zeros_like(ctrl)
        off[:, -2:] = OFF
        self.tracking = Tracking(ctrl + off, 0.0 * gain, expected)

    def rehearse(self) -> int:
        steps = np.arange(self.rehearsal.lookahead)
        return self.rehearsal.rehearse(self.goals, self.tracking, steps, self.simulation)


def test_a_plan_that_works_is_rolled_out_once_and_goes_as_rehearsed():
    hand = Rehearsed("TwinkleTwinkleLittleStar")
    assert hand.rehearse() == hand.rehearsal.lookahead
    assert hand.rehearsal.end == 10
    np.testing.assert_array_equal(hand.rehearsal.ctrl(0), hand.tracking.ctrl[:10])
    for step in range(10):
        qpos, qvel, _ = hand.joint_state
        assert hand.rehearsal.goes_as_rehearsed(step, qpos)
        assert not hand.rehearsal.goes_as_rehearsed(step, qpos + 0.01)
        posture = hand.servos.of_joints.T @ np.stack([qpos, qvel], axis=1)
        ctrl = hand.rehearsal.ctrl(step)[0] - hand.tracking.feedback(step, posture)
        hand.simulation.step(hand.servos.clip(ctrl)[None])
    assert hand.rehearsal.ctrl(4).shape == (6, hand.tracking.ctrl.shape[1])


def test_a_finger_that_is_off_its_key_is_put_right(monkeypatch):
    hand = Rehearsed("TwinkleTwinkleLittleStar")
    hand.go_astray()
    rolled_out = watched(monkeypatch, hand_rehearsal, "roll_out")
    hand.rehearse()
    first, *others = (rollout.mistakes for _, rollout in rolled_out)
    assert first > 0
    assert min(others) < first / 2
    assert not np.array_equal(hand.rehearsal.ctrl(0), hand.tracking.ctrl[:10])


def test_rehearsing_leaves_the_plan_as_it_is():
    hand = Rehearsed("CMajorScaleOneHand")
    before = hand.tracking.ctrl.copy()
    hand.rehearse()
    np.testing.assert_array_equal(hand.tracking.ctrl, before)
    hand.rehearsal.reset()
    assert hand.rehearsal.end == 0
    assert len(hand.rehearsal.ctrl(7)) == 0
