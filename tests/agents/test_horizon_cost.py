"""What rollouts over the look-ahead horizon cost, and where fingertips should have been."""

import numpy as np
import pytest
from one_hand import OneHand

from cadenza.agents.agent import Array
from cadenza.agents.planner.search.horizon_cost import HorizonCost
from cadenza.keyboards.piano import PIANO
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score

CHORD = 64, 67, 72


class Chord:
    """A chord of three notes, with fingertips where they should be."""

    def __init__(self) -> None:
        hand = OneHand(Score(tuple(Note(0.0, 0.5, pitch, 80) for pitch in CHORD)))
        self.goals, keys = hand.goals, hand.plan.goals.keys
        self.steps = np.flatnonzero(keys.any(axis=1))
        self.tips = self.goals.fingertips[self.steps + 1]
        self.horizon = HorizonCost(self.goals, self.steps, PIANO, slice(None), np.zeros(88))
        self.wanted = keys[self.steps]

    def by_finger(self, depth: Array) -> tuple[Array, list[float]]:
        """Costs by finger, and of the steps, if keys do not move within one."""
        paths = np.repeat((depth * PIANO.travel)[:, None], 2, axis=1)
        costs, _, keys = zip(
            *self.horizon.costs(0, paths, self.tips, self.horizon.start), strict=True
        )
        return self.horizon.by_finger(np.array([each.costs for each in keys]), self.tips), costs


def test_costs_of_fingers_are_those_of_the_steps():
    chord = Chord()
    for seed in range(10):
        depth = np.random.default_rng(seed).uniform(0.0, 1.2, chord.wanted.shape)
        by_finger, costs = chord.by_finger(depth)
        assert by_finger.shape == chord.tips.shape[:2]
        np.testing.assert_allclose(by_finger.sum(axis=1), costs)


def test_steps_cost_the_same_one_by_one_and_all_at_once():
    chord = Chord()
    for seed in range(10):
        depth = np.random.default_rng(seed).uniform(0.0, 1.2, (len(chord.steps), 4, 1))
        paths = np.where(chord.wanted[:, None], depth, 0.3 * depth) * PIANO.travel
        horizon, one_by_one = chord.horizon, []
        keys = horizon.start
        for k, path in enumerate(paths):
            one_by_one += horizon.costs(k, path[None], chord.tips[k : k + 1], keys)
            keys = one_by_one[-1][2]
        at_once = horizon.costs(0, paths, chord.tips, horizon.start)
        for one, other in zip(one_by_one, at_once, strict=True):
            assert one[:2] == pytest.approx(other[:2])
            assert all(map(np.array_equal, one[2], other[2]))


def test_a_silent_key_is_the_fault_of_the_finger_that_should_press_it():
    chord, key = Chord(), CHORD[1] - PIANO.lowest_pitch
    depth = chord.wanted.astype(float)
    fine, _ = chord.by_finger(depth)
    depth[:, key] = 0.0
    worse = chord.by_finger(depth)[0] > fine
    finger = chord.goals.finger[chord.steps[0], key]
    assert (worse == (np.arange(worse.shape[1]) == finger)).all()


def test_a_wrong_key_is_the_fault_of_the_finger_over_it():
    chord, finger = Chord(), 4
    depth = chord.wanted.astype(float)
    fine, _ = chord.by_finger(depth)
    chord.tips[:, finger] = PIANO.centre[CHORD[-1] - PIANO.lowest_pitch + 4]
    depth[:, CHORD[-1] - PIANO.lowest_pitch + 4] = 1.0
    worse = chord.by_finger(depth)[0] > fine + 2.0
    assert (worse == (np.arange(worse.shape[1]) == finger)).all()


def test_notes_that_do_not_begin_in_time_and_keys_struck_again_cost_more():
    hand = OneHand(Score((Note(0.0, 0.5, 60),)))
    key, wrong = 60 - 21, 65 - 21
    first, *_, last = np.flatnonzero(hand.plan.goals.keys[:, key])
    steps = np.arange(first, last + 1)
    horizon = HorizonCost(hand.goals, steps, PIANO, slice(None), np.zeros(88))

    def cost(key: int, sounds: str) -> float:
        """Cost of a key of its own, or a wrong one, that sounds where the text has an x."""
        paths = np.zeros((len(sounds), 2, 88))
        paths[:, :, key] = PIANO.travel[key] * (np.array(list(sounds)) == "x")[:, None]
        tips = hand.goals.fingertips[steps + 1]
        return sum(cost for cost, _, _ in horizon.costs(0, paths, tips, horizon.start))

    in_time = cost(key, "xxxxxxxxxx")
    lost = cost(key, ".xxxxxxxxx") - in_time
    assert lost > 0
    assert cost(key, "..xxxxxxxx") - in_time > 2 * lost
    assert cost(key, "xxxxx.xxxx") - in_time > cost(key, "xxxxxxxxx.") - in_time > 0
    assert cost(wrong, "..x.x.....") > cost(wrong, "..xx......") > cost(wrong, "..........")


@pytest.mark.parametrize(
    ("pitch", "moments", "is_down", "least"),
    [(CHORD[0] + 1, slice(1, 3), True, 1.0), (CHORD[0], slice(1, 2), False, 0.0)],
    ids=["a wrong key that is only brushed", "a key that is struck again within a step"],
)
def test_what_happens_within_a_step_is_a_mistake(pitch, moments, is_down, least):
    chord, key = Chord(), pitch - PIANO.lowest_pitch
    path = np.repeat(chord.wanted[1:2] * PIANO.travel, 4, axis=0)
    before, tips = chord.horizon.start._replace(sounding=chord.wanted[1]), chord.tips[1]
    [(clean, none, _)] = chord.horizon.costs(1, path[None], tips[None], before)
    path[moments, key] = PIANO.travel[key] * is_down
    [(wrong, mistakes, _)] = chord.horizon.costs(1, path[None], tips[None], before)
    assert wrong > clean + least
    assert (none, mistakes) == (0, 1)


@pytest.mark.parametrize(("end", "is_lost"), [(0.6, True), (2.0, False)])
def test_a_note_that_is_lost_is_not_struck_again_unless_much_of_it_is_left(end, is_lost):
    hand, key = OneHand(Score((Note(0.0, end, 60),))), 60 - 21
    steps = np.flatnonzero(hand.plan.goals.keys[:, key])[0] + np.arange(4, 10)
    horizon = HorizonCost(hand.goals, steps, PIANO, slice(None), np.zeros(88))
    tips = hand.goals.fingertips[steps + 1]

    def cost(sounds: str) -> tuple[float, int]:
        paths = np.zeros((len(sounds), 2, 88))
        paths[:, :, key] = PIANO.travel[key] * (np.array(list(sounds)) == "x")[:, None]
        costs, mistakes, _ = zip(*horizon.costs(0, paths, tips, horizon.start), strict=True)
        return sum(costs), sum(mistakes)

    (silent, mistakes), (struck, _) = cost("......"), cost(".xxxxx")
    assert (silent < struck) == is_lost == (mistakes == 0)
    error = horizon.fingertip_errors(tips)[0][:, hand.goals.finger[steps[0], key], 2]
    assert (error > 0.005).all() == is_lost  # its finger stays above the key


# Where fingertips should have been


class Played:
    """Twinkle, with fingertips just where the plan has them, and keys as it holds them."""

    def __init__(self) -> None:
        self.goals = OneHand(load_score("TwinkleTwinkleLittleStar")).goals
        self.steps = np.arange(30)
        self.tips = self.goals.fingertips[self.steps + 1]
        self.sounding = (self.goals.keys & self.goals.planned)[self.steps]

    def errors(self) -> tuple[Array, Array]:
        horizon = HorizonCost(self.goals, self.steps, PIANO, slice(None), np.zeros(88))
        paths = np.repeat(self.sounding[:, None] * PIANO.travel, 2, axis=1)
        return horizon.errors_by_sound(self.tips, paths)


@pytest.fixture
def played():
    return Played()


def test_who_plays_as_planned_makes_no_errors(played):
    error, weight = played.errors()
    assert (error == 0.0).all()
    assert weight.max() == 1.0


def test_a_finger_whose_key_is_silent_should_have_been_deeper(played):
    step, key = np.argwhere(played.sounding)[2]
    finger = played.goals.finger[step, key]
    played.sounding[step, key] = False
    error, weight = played.errors()
    assert np.argwhere(error).tolist() == [[step, finger, 2]]
    assert error[step, finger, 2] < -0.003
    assert weight[step, finger] == 1.0


def test_a_finger_on_a_key_that_should_be_silent_should_have_been_higher(played):
    step, key = 2, 40  # before anything sounds
    assert played.goals.wrong[step, key]
    played.sounding[step, key] = True
    assert (played.errors()[0] == 0.0).all()  # no finger is near
    played.tips[step, 3, :2] = PIANO.centre[key, :2]
    error, weight = played.errors()
    assert (error[step - 1 : step + 1, 3, 2] > 0.003).all()
    assert (weight[step - 1 : step + 1, 3] == 1.0).all()
    assert (error[[step - 2, step + 1]] == 0.0).all()


def test_wrong_keys_and_wrong_onsets_near_a_strike_are_its_fault():
    chord, key, other = Chord(), CHORD[0] - PIANO.lowest_pitch, CHORD[-1] + 4 - PIANO.lowest_pitch
    rest = np.repeat(chord.wanted[:, None] * PIANO.travel, 4, axis=1)
    rest[0, :2] = 0.0  # the chord begins in the first step
    strikes = chord.horizon.strikes
    assert not strikes.faults(list(rest)).any()
    for step, moment, wrong in ((1, 1, other), (2, 3, other), (0, 3, other)):
        paths = rest.copy()
        paths[step, moment, wrong] = PIANO.travel[wrong]
        assert (strikes.faults(list(paths)) > 0).all()
    paths = rest.copy()
    paths[2, 2, key] = 0.0  # it is let go of, and struck again
    assert (strikes.faults(list(paths)) == 1).all()
    paths = rest.copy()
    paths[5, 2, key] = 0.0  # long after
    assert not strikes.faults(list(paths)).any()
