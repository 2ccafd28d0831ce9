"""Which finger holds which key when, and where the fingertips are for it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.agents.planner.plan.fingertip_targets import targets_of
from cadenza.agents.planner.plan.presses import Press, presses_of
from cadenza.agents.planner.plan.releases import release_in_time
from cadenza.fingers import SIDES
from cadenza.hands.hand import Hand
from cadenza.hands.shadow import SHADOW
from cadenza.keyboards.piano import PIANO
from cadenza.scene.scene import build_scene
from melodies import FINER
from numbered import FIVE


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=50)
def test_presses_are_the_goals(seed):
    rng = np.random.default_rng(seed)
    fingers = np.where(rng.random((30, 88)) < 0.05, rng.integers(0, 10, (30, 88)), -1)
    fingers = np.repeat(fingers, 2, axis=0).astype(np.int8)
    pressing = np.full_like(fingers, -1)
    for press in presses_of(fingers, FIVE):
        assert (pressing[press.first - 1 : press.last - 1, press.key] == -1).all()
        pressing[press.first - 1 : press.last - 1, press.key] = press.finger
    np.testing.assert_array_equal(pressing, fingers)


def places(rest_y: np.ndarray) -> np.ndarray:
    """(88, 10) of forearms that at 0 have their fingertips at `rest_y` (10,)."""
    return PIANO.centre[:, 1, None] - rest_y


def let_go(
    presses: list[Press], there: np.ndarray, dt: float = 0.05, hand: Hand = SHADOW
) -> list[Press]:
    """`release_in_time` at a piano."""
    return release_in_time(presses, there, PIANO.is_black, dt, hand)


def test_a_hand_lets_go_in_time_for_a_jump_only():
    near = [Press("right", 0, 39, 10, 20), Press("right", 1, 41, 20, 30)]
    assert let_go(near, places(np.linspace(0.0, 0.2, 10))) == near
    far = [Press("right", 0, 39, 10, 20), Press("right", 0, 60, 20, 30)]
    cut = let_go(far, places(np.zeros(10)))
    assert 11 <= cut[0].last < 19
    assert cut[1] == far[1]


@pytest.mark.parametrize("finger", [0, 1])
def test_a_hand_can_let_go_later_before_a_jump(finger):
    far = [Press("right", 0, 39, 10, 20), Press("right", finger, 60, 20, 30)]
    near = [Press("right", 0, 39, 10, 20), Press("right", finger, 41, 20, 30)]

    def last(presses: list[Press], later: int) -> int:
        asked = [press._replace(release_delay=later) for press in presses]
        return let_go(asked, places(np.zeros(10)))[0].last

    usual = last(far, 0)
    assert usual < 18
    assert [last(far, later) for later in (1, 9)] == [usual + 1, 19]
    assert last(near, 1) == last(near, 0)


def test_a_hand_holds_what_it_can_hold_together_with_what_it_strikes():
    rest = SHADOW.reach.rest
    there = places(np.concatenate([rest, -rest]))
    octave = [Press("right", 0, 39, 10, 40), Press("right", 4, 51, 20, 30)]
    assert let_go(octave, there) == octave
    mirrored = [Press("left", 5, 51, 10, 40), Press("left", 9, 39, 20, 30)]
    assert let_go(mirrored, there) == mirrored
    twelfth = [octave[0], octave[1]._replace(key=58)]
    assert let_go(twelfth, there)[0].last < 20
    crossing = [octave[0]._replace(finger=4), octave[1]._replace(finger=0)]
    assert let_go(crossing, there)[0].last < 20


def test_a_hand_flies_to_a_single_key_and_comes_down_on_a_chord():
    first = Press("right", 0, 39, 10, 20)
    key = Press("right", 0, 46, 20, 30)
    chord = Press("right", 4, 53, 20, 30)
    there = places(np.array([0.0, 0.02, 0.05, 0.07, 0.1] * 2))
    left, reached = let_go([first, key], there)
    assert (left.jumps_off, reached.jumps_to) == (True, True)
    left_sooner, *landed = let_go([first, key, chord], there)
    assert left_sooner.last < left.last < 20
    assert not any(press.jumps_to for press in landed)


def last_before(
    key: int, other: int, chord: bool = True, later: int = 0, first: int = 10, hand: Hand = SHADOW
) -> int:
    """The end of a press of `key`, before the same finger presses another one."""
    there = places(np.array([0.0, 0.02, 0.05, 0.07, 0.1] * 2))
    presses = [
        Press("right", 1, key, first, 20),
        Press("right", 1, other, 20, 30, release_delay=later),
        Press("right", 3, other + 4, 20, 30, release_delay=later),
    ]
    return let_go(presses[: 2 + chord], there, hand=hand)[0].last


def test_a_finger_takes_longer_to_a_chord_or_onto_a_black_key():
    white, black = 39, 40
    assert (
        last_before(white, white + 2, chord=False) == last_before(black, white, chord=False) == 19
    )
    assert last_before(white, white + 2) == last_before(white, white) == 18
    assert last_before(white, black, chord=False) == last_before(white, black) == 18
    assert [last_before(white, white + 2, later=later) for later in (1, 9)] == [19, 19]
    assert [last_before(white, white + 2, first=first) for first in (16, 17, 18)] == [18, 18, 19]
    hand = replace(SHADOW, jump_times=replace(SHADOW.jump_times, next_key=0.05))
    assert last_before(white, black, hand=hand) == 19


@pytest.mark.parametrize("finger", [1, 2])
def test_a_chord_is_let_go_in_time_to_be_struck_again_unless_that_is_soon(finger):
    def last(first: int) -> int:
        again = [Press("right", finger, 39, 20, 30), Press("right", 4, 44, 20, 30)]
        return let_go([Press("right", 1, 39, first, 19), *again], there)[0].last

    there = places(np.concatenate([SHADOW.reach.rest, -SHADOW.reach.rest]))
    assert [last(first) for first in (10, 15, 16)] == [18, 18, 19]


def let_go_one_by_one(presses: list[Press], there: np.ndarray, dt: float) -> list[Press]:
    """`let_go` of Shadow hands as plain loops, without jumps."""
    ahead, times, reach = round(0.4 / dt), SHADOW.jump_times, SHADOW.reach

    def struck_with(press: Press) -> list[Press]:
        return [p for p in presses if (p.side, p.first) == (press.side, press.first)]

    def place(press: Press) -> float:
        return float(there[press.key, press.finger])

    def jump(press: Press, chord: list[Press]) -> int:
        """States before the chord in which the hand has to be off the press, 0 if it need not."""
        out = 1 if press.side == "right" else -1
        with_it, strike = struck_with(press), chord[0]
        holding = press.last > strike.first + 1
        here = place(press) if holding else np.mean([place(p) for p in with_it])
        way = abs(np.mean([place(p) for p in chord]) - here)
        states = math.ceil(
            round(float(times.seconds(way, len(with_it), len(chord), holding)) / dt, 9)
        )
        spanned = all(
            reach.spans(
                press.finger % 5, p.finger % 5, out * (there[p.key, 0] - there[press.key, 0])
            )
            for p in chord
        )
        return 0 if spanned or not states else max(states - strike.release_delay, 1)

    cut = []
    for press in presses:
        last = press.last
        until = max(p.last for p in struck_with(press)) + ahead
        for head in presses:
            chord = struck_with(head)
            if head is chord[0] and head.side == press.side and press.first < head.first <= until:
                states = jump(press, chord)
                if states and head.first <= press.last + ahead:
                    last = min(last, max(head.first - states, press.first + 1))
        cut.append(press._replace(last=last))
    for i, press in enumerate(cut):
        later = [p for p in cut[i + 1 :] if p.side == press.side]
        moves = [p for p in later if p.finger == press.finger][:1]
        again = [p for p in later if p.key == press.key][:1]
        for after in [p for p in moves if p.key != press.key] + again:
            climbs = PIANO.is_black[after.key] and not PIANO.is_black[press.key]
            fast = after.key == press.key and after.first - press.first < 5
            slow = climbs or (len(struck_with(after)) > 1 and not fast)
            states = max(2 - after.release_delay, 1) if slow else 1
            end = max(after.first - states, press.first + 1)
            cut[i] = cut[i]._replace(last=min(cut[i].last, end))
    return cut


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=50)
def test_letting_go_is_that_of_plain_loops(seed):
    rng = np.random.default_rng(seed)
    fingers = np.full((40, 88), -1, np.int8)
    for _ in range(rng.integers(40)):
        first, key = rng.integers(40), int(np.clip(rng.normal(40, 12), 0, 87))
        fingers[first : first + rng.integers(1, 14), key] = rng.integers(10)
    later = rng.integers(3, size=(41, 2))
    presses = [
        press._replace(release_delay=int(later[press.first, SIDES.index(press.side)]))
        for press in presses_of(fingers, FIVE)
    ]
    rest = SHADOW.reach.rest
    there = places(np.concatenate([rest, -rest]))
    shortened = let_go(presses, there)
    unmarked = [press._replace(jumps_off=False, jumps_to=False) for press in shortened]
    assert unmarked == let_go_one_by_one(presses, there, 0.05)


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("chord", [False, True])
def test_hands_have_as_long_at_a_finer_control_step(far, chord):
    second = [Press("right", 1, 55 if far else 41, 20, 30)]
    presses = [Press("right", 0, 39, 10, 20), *second, *[Press("right", 3, 59, 20, 30)][:chord]]
    presses.append(Press("right", 1, 45, 30, 34))
    finer = [press._replace(first=2 * press.first, last=2 * press.last) for press in presses]
    there = places(np.zeros(10))
    usual = let_go(presses, there)
    fine = let_go(finer, there, FINER)
    for one, other in zip(usual, fine, strict=True):
        assert other.last / 2 - one.last in (0, 0.5)  # whole steps before the next press
        assert one == other._replace(first=one.first, last=one.last)


def test_fingertips_have_as_long_at_a_finer_control_step(right_hand):
    presses = [Press("right", 1, 41, 6, 9), Press("right", 1, 43, 16, 20, jumps_to=True)]
    finer = [press._replace(first=2 * press.first, last=2 * press.last) for press in presses]
    usual = targets_of(right_hand, presses, 25, 0.05)
    fine = targets_of(right_hand, finer, 50, FINER)
    for one, other in zip(usual, fine, strict=True):
        np.testing.assert_allclose(other[::2], one)


def test_hands_in_haste_let_go_later_before_a_jump_only():
    far = [Press("right", 1, 27, 10, 20), Press("right", 1, 51, 20, 30)]
    near = [Press("right", 1, 27, 10, 20), Press("right", 1, 29, 20, 30)]
    hasty = replace(SHADOW, jump_times=SHADOW.jump_times.accelerated(4.0))
    there = places(np.zeros(10))
    assert let_go(far, there, hand=hasty)[0].last > let_go(far, there)[0].last
    assert let_go(near, there, hand=hasty) == let_go(near, there)


def test_in_a_jump_only_heights_are_strict():
    still = Press("right", 1, 41, 5, 8)
    jump = Press("right", 1, 41, 5, 8, jumps_off=True, jumps_to=True)
    scene = build_scene()
    strict, loose = (targets_of(scene, [press], 12, 0.05).sigma[:, 1] for press in (still, jump))
    on_the_way = [3, 4, 8]
    assert (loose[on_the_way, :2] > 4 * strict[on_the_way, :2]).all()
    np.testing.assert_array_equal(loose[:, 2], strict[:, 2])
    np.testing.assert_array_equal(loose[5:8], strict[5:8])


def test_fingertips_are_wanted_at_the_stop_of_their_keys():
    targets = targets_of(build_scene(), [Press("right", 1, 41, 5, 8)], 12, 0.05)
    assert (targets.force[5:8, 1] > 0).all()
    assert not targets.force[[4, 8], 1].any()
    top = 0.0225
    assert (targets.high[5:8, 1, 2] < top + 0.0067).all()  # of the ball, below the key at rest
    assert (targets.low[[4, 8], 1, 2] > top + 0.0067).all()
