"""The reward terms against their published formulas, written out as plain loops."""

from __future__ import annotations

import math
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.keyboards.piano import PIANO
from cadenza.tasks import reward

CLOSE = {"rtol": 1e-9, "atol": 1e-12}
few = settings(max_examples=25, deadline=None)
sizes = st.integers(1, 4)


def arrays(shape: Any, low: float, high: float) -> st.SearchStrategy[np.ndarray]:
    return npst.arrays(float, shape, elements=st.floats(low, high, width=64))


def key_angles(n: int) -> st.SearchStrategy[np.ndarray]:
    """At rest, pressed, and anything between and a little beyond."""
    return arrays((n, PIANO.num_keys), -0.01, 0.1)


def masks(n: int, *more: int) -> st.SearchStrategy[np.ndarray]:
    """Few are on, as in music."""
    few_on = st.sampled_from([True] + 9 * [False])
    return npst.arrays(bool, (n, *more), elements=few_on, fill=st.just(False))


def gaussian(x: float, low: float, high: float, margin: float) -> float:
    """dm_control's tolerance."""
    if low <= x <= high:
        return 1.0
    distance = low - x if x < low else x - high
    return math.exp(-0.5 * (distance / margin * math.sqrt(-2 * math.log(0.1))) ** 2)


@given(st.floats(-3, 3), st.sampled_from([(0.05, 0.5), (0.01, 0.1)]))
def test_tolerance(x: float, bound_and_margin: tuple[float, float]) -> None:
    bound, margin = bound_and_margin
    ours = reward.tolerance(np.array([x]), bound, margin)
    assert_allclose(ours, gaussian(x, 0.0, bound, margin), **CLOSE)


def test_tolerance_is_a_tenth_at_the_margin() -> None:
    x = np.array([-0.5, 0.0, 0.05, 0.55])
    assert_allclose(reward.tolerance(x, 0.05, 0.5), [0.1, 1.0, 1.0, 0.1])


@few
@given(sizes.flatmap(key_angles))
def test_state_and_sounding_of_keys(key_qpos: np.ndarray) -> None:
    state, sounds = reward.key_state(key_qpos), reward.key_activation(key_qpos)
    for index, angle in np.ndenumerate(key_qpos):
        most = PIANO.travel[index[1]]
        clipped = min(max(angle, 0.0), most)
        assert_allclose(state[index], clipped / most, **CLOSE)
        assert sounds[index] == (abs(clipped - most) <= 0.00872665)


@few
@given(st.data(), sizes)
def test_key_press(data: st.DataObject, n: int) -> None:
    key_qpos, goal = data.draw(key_angles(n)), data.draw(masks(n, PIANO.num_keys))
    sounds = data.draw(masks(n, PIANO.num_keys))
    state = reward.key_state(key_qpos)
    ours = reward.key_press(state, sounds, goal)
    for env in range(n):
        near = [
            gaussian(1 - s, 0, 0.05, 0.5) for s, g in zip(state[env], goal[env], strict=True) if g
        ]
        silent = not any(sounds[env, key] and not goal[env, key] for key in range(PIANO.num_keys))
        assert_allclose(ours[env], 0.5 * (sum(near) / max(len(near), 1)) + 0.5 * silent, **CLOSE)


def test_key_press_with_nothing_to_press() -> None:
    nothing = np.zeros((2, PIANO.num_keys), bool)
    wrong = nothing.copy()
    wrong[1, 40] = True
    assert_array_equal(reward.key_press(nothing.astype(float), wrong, nothing), [0.5, 0.0])


def point(key: int, centre: np.ndarray) -> np.ndarray:
    """Where a finger is wanted on a key whose box has this centre."""
    half_length, _, half_height = PIANO.half_size[key]
    return centre + np.array([0.35 * half_length, 0.0, 0.5 * half_height])


def key_centres(n: int) -> st.SearchStrategy[np.ndarray]:
    """Keys a little below where they rest."""
    return arrays((n, PIANO.num_keys, 3), -0.01, 0.0).map(lambda offset: PIANO.centre + offset)


def fingertips(n: int, fingers: int = 10) -> st.SearchStrategy[np.ndarray]:
    """Around the keyboard, some of them right at a key."""
    return arrays((n, fingers, 3), -0.2, 0.2)


def fingers_at_their_keys(
    tips: np.ndarray, centres: np.ndarray, fingers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the pairs that a score wants, and how far off the fingers are."""
    pairs = reward.score_pairs(fingers)
    return pairs.row, reward.press_offsets(tips, centres, pairs)


@few
@given(st.data(), sizes)
def test_fingering_of_the_score(data: st.DataObject, n: int) -> None:
    tips, centres = data.draw(fingertips(n)), data.draw(key_centres(n))
    some = st.sampled_from([-1] * 9 + list(range(10)))
    fingers = data.draw(npst.arrays(np.int8, (n, PIANO.num_keys), elements=some, fill=st.just(-1)))
    row, offset = fingers_at_their_keys(tips, centres, fingers)
    ours = reward.nearness(row, offset, n, otherwise=0.0)
    for env in range(n):
        distances = [
            math.dist(tips[env, fingers[env, k]], point(k, centres[env, k]))
            for k in range(PIANO.num_keys)
            if fingers[env, k] >= 0
        ]
        near = [gaussian(distance, 0, 0.01, 0.1) for distance in distances]
        assert_allclose(np.linalg.norm(offset[row == env], axis=1), distances, **CLOSE)
        assert_allclose(ours[env], sum(near) / len(near) if near else 0.0, **CLOSE)


@pytest.mark.parametrize("key", [0, 1, 39, 87])
def test_a_finger_at_its_key_gets_all(key: int) -> None:
    assert bool(PIANO.is_black[key]) == (key == 1)
    tips, fingers = np.full((1, 10, 3), 9.0), np.full((1, PIANO.num_keys), -1, np.int8)
    fingers[0, key] = 7
    tips[0, 7] = point(key, PIANO.centre[key])
    centres = PIANO.centre[None]
    row_and_offset = fingers_at_their_keys(tips, centres, fingers)
    assert_allclose(reward.nearness(*row_and_offset, 1, otherwise=0.0), [1.0])
    tips[0, 7, 0] += 0.11  # 1 cm of grace, then a tenth at 10 cm
    row_and_offset = fingers_at_their_keys(tips, centres, fingers)
    assert_allclose(reward.nearness(*row_and_offset, 1, otherwise=0.0), [0.1], rtol=1e-6)


@few
@given(st.data(), st.integers(1, 5), st.lists(st.integers(0, 87), unique=True, max_size=5))
def test_optimal_transport(data: st.DataObject, num_fingers: int, keys: list[int]) -> None:
    """No assignment of fingers to keys, or of keys to fingers where they are more, is shorter."""
    tips, centres = data.draw(fingertips(1, num_fingers)), data.draw(key_centres(1))
    goal = np.zeros((1, PIANO.num_keys), bool)
    goal[0, keys] = True
    pairs = reward.transport_pairs(tips, centres, goal, np.arange(num_fingers))
    assert pairs.row.tolist() == [0] * min(num_fingers, len(keys))
    assert set(pairs.key) <= set(keys)
    distance = np.linalg.norm(reward.press_offsets(tips, centres, pairs), axis=1)
    way = [[math.dist(tip, point(k, centres[0, k])) for k in keys] for tip in tips[0]]
    if num_fingers < len(keys):
        sums = (
            sum(way[f][k] for f, k in enumerate(chosen))
            for chosen in permutations(range(len(keys)), num_fingers)
        )
    else:
        sums = (
            sum(way[f][k] for k, f in enumerate(chosen))
            for chosen in permutations(range(num_fingers), len(keys))
        )
    assert_allclose(distance.sum(), min(sums), **CLOSE)


def test_optimal_transport_row_by_row() -> None:
    """Rows without a key to press have no pairs, and are worth what was said."""
    tips, centres = np.zeros((3, 10, 3)), np.tile(PIANO.centre, (3, 1, 1))
    goal = np.zeros((3, PIANO.num_keys), bool)
    goal[1, [3, 50]] = True
    tips[1, 2], tips[1, 8] = point(50, PIANO.centre[50]), point(3, PIANO.centre[3])
    pairs = reward.transport_pairs(tips, centres, goal, np.array([2, 5, 8]))
    assert [values.tolist() for values in pairs] == [[1, 1], [2, 8], [50, 3]]
    offset = reward.press_offsets(tips, centres, pairs)
    assert_allclose(offset, 0.0, atol=1e-12)
    for otherwise in (0.0, 1.0):
        near = reward.nearness(pairs.row, offset, 3, otherwise=otherwise)
        assert_allclose(near, [otherwise, 1.0, otherwise])


def test_optimal_transport_of_nothing() -> None:
    tips, centres, goal = (
        np.zeros((2, 5, 3)),
        np.zeros((2, PIANO.num_keys, 3)),
        np.zeros((2, PIANO.num_keys)),
    )
    nothing = reward.transport_pairs(tips, centres, goal > 0, np.arange(5))
    assert [len(part) for part in nothing] == [0, 0, 0]
    assert reward.press_offsets(tips, centres, nothing).shape == (0, 3)


@few
@given(st.data(), sizes, st.integers(1, 44), st.floats(0, 1))
def test_energy(data: st.DataObject, n: int, actuators: int, coefficient: float) -> None:
    force, velocity = (data.draw(arrays((n, actuators), -20, 20)) for _ in range(2))
    ours = reward.energy(force, velocity, coefficient)
    for env in range(n):
        power = sum(abs(f) * abs(v) for f, v in zip(force[env], velocity[env], strict=True))
        assert_allclose(ours[env], -coefficient * power, **CLOSE)


@pytest.mark.parametrize("down", [True, False])
@pytest.mark.parametrize("goal", [True, False])
def test_sustain(down: bool, goal: bool) -> None:
    expected = gaussian(float(goal) - float(down), 0, 0.05, 0.5)
    assert_allclose(reward.sustain(np.array([down]), np.array([goal])), [expected], **CLOSE)


def test_forearm() -> None:
    assert_array_equal(reward.forearm(np.array([True, False])), [0.0, 0.5])
