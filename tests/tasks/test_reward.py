"""The reward terms against their published formulas, written out as plain loops, and compiled."""

import math
from itertools import permutations
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.keyboards.piano import PIANO
from cadenza.tasks import reward

CLOSE = {"rtol": 1e-9, "atol": 1e-12}
NUM_KEYS = PIANO.num_keys
PRESS = reward.press_offset(PIANO.half_size)
few = settings(max_examples=25, deadline=None)
sizes = st.integers(1, 4)


def arrays(shape: Any, low: float, high: float) -> st.SearchStrategy[np.ndarray]:
    return npst.arrays(float, shape, elements=st.floats(low, high, width=64))


def key_angles(n: int) -> st.SearchStrategy[np.ndarray]:
    """At rest, pressed, and anything between and a little beyond."""
    return arrays((n, NUM_KEYS), -0.01, 0.1)


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


@few
@given(sizes.flatmap(key_angles))
def test_state_and_sounding_of_keys(key_qpos):
    state = reward.key_state(key_qpos, PIANO.travel)
    sounds = reward.key_activation(key_qpos, PIANO.sounds_from)
    for index, angle in np.ndenumerate(key_qpos):
        most = PIANO.travel[index[1]]
        clipped = min(max(angle, 0.0), most)
        assert_allclose(state[index], clipped / most, **CLOSE)
        assert sounds[index] == (abs(clipped - most) <= 0.00872665)


@few
@given(st.data(), sizes)
def test_key_press(data, n):
    key_qpos, goal = data.draw(key_angles(n)), data.draw(masks(n, NUM_KEYS))
    sounds = data.draw(masks(n, NUM_KEYS))
    state = reward.key_state(key_qpos, PIANO.travel)
    ours = reward.key_press(state, sounds, goal)
    for env in range(n):
        near = [
            gaussian(1 - s, 0, 0.05, 0.5) for s, g in zip(state[env], goal[env], strict=True) if g
        ]
        silent = not any(sounds[env, key] and not goal[env, key] for key in range(NUM_KEYS))
        assert_allclose(ours[env], 0.5 * (sum(near) / max(len(near), 1)) + 0.5 * silent, **CLOSE)


@few
@given(st.data(), sizes)
def test_graded_key_press(data, n):
    state = reward.key_state(data.draw(key_angles(n)), PIANO.travel)
    sounds, goal = data.draw(masks(n, NUM_KEYS)), data.draw(masks(n, NUM_KEYS))
    ours = reward.graded_key_press(state, sounds, goal)
    for env in range(n):
        worth = [state[env, k] / 2 + sounds[env, k] / 2 for k in range(NUM_KEYS) if goal[env, k]]
        wrong = sum(sounds[env, k] and not goal[env, k] for k in range(NUM_KEYS))
        right = 1 - wrong / (len(worth) + wrong) if wrong else 1.0
        assert_allclose(ours[env], 0.5 * (sum(worth) / max(len(worth), 1)) + 0.5 * right, **CLOSE)


@pytest.mark.parametrize("key_press", [reward.key_press, reward.graded_key_press])
def test_key_press_with_nothing_to_press(key_press):
    nothing = np.zeros((2, NUM_KEYS), bool)
    wrong = nothing.copy()
    wrong[1, 40] = True
    assert_array_equal(key_press(nothing.astype(float), wrong, nothing), [0.5, 0.0])


def point(key: int, centre: np.ndarray) -> np.ndarray:
    """The target of a finger on a key whose box has this centre."""
    half_length, _, half_height = PIANO.half_size[key]
    return centre + np.array([0.35 * half_length, 0.0, 0.5 * half_height])


def key_centres(n: int) -> st.SearchStrategy[np.ndarray]:
    """Keys a little below where they rest."""
    return arrays((n, NUM_KEYS, 3), -0.01, 0.0).map(lambda offset: PIANO.centre + offset)


def fingertips(n: int, fingers: int = 10) -> st.SearchStrategy[np.ndarray]:
    """Around the keyboard, some of them right at a key."""
    return arrays((n, fingers, 3), -0.2, 0.2)


def fingerings(n: int, fingers: int = 10) -> st.SearchStrategy[np.ndarray]:
    """Few keys have a finger, and one finger may have two keys."""
    some = st.sampled_from([-1] * 9 + list(range(fingers)))
    return npst.arrays(np.int8, (n, NUM_KEYS), elements=some, fill=st.just(-1))


@few
@given(st.data(), sizes)
def test_fingering_of_the_score(data, n):
    tips, centres = data.draw(fingertips(n)), data.draw(key_centres(n))
    fingers = data.draw(fingerings(n))
    ours = reward.score_fingering(tips, centres, PRESS, fingers)
    for env in range(n):
        distances = [
            math.dist(tips[env, fingers[env, k]], point(k, centres[env, k]))
            for k in range(NUM_KEYS)
            if fingers[env, k] >= 0
        ]
        near = [gaussian(distance, 0, 0.01, 0.1) for distance in distances]
        assert_allclose(ours[env], sum(near) / len(near) if near else 0.0, **CLOSE)


@pytest.mark.parametrize("key", [0, 1, 39, 87])
def test_a_finger_at_its_key_gets_all(key):
    assert bool(PIANO.is_black[key]) == (key == 1)
    tips, fingers = np.full((1, 10, 3), 9.0), np.full((1, NUM_KEYS), -1, np.int8)
    fingers[0, key] = 7
    tips[0, 7] = point(key, PIANO.centre[key])
    centres = PIANO.centre[None]
    assert_allclose(reward.score_fingering(tips, centres, PRESS, fingers), [1.0])
    tips[0, 7, 0] += 0.11  # 1 cm of grace, then a tenth at 10 cm
    assert_allclose(reward.score_fingering(tips, centres, PRESS, fingers), [0.1], rtol=1e-6)
    tips[0, 7, 0] -= 0.06
    assert_allclose(reward.score_fingering(tips, centres, PRESS, fingers, 0.04), [0.1], rtol=1e-6)


@few
@given(st.data(), st.integers(1, 5), st.lists(st.integers(0, 87), unique=True, max_size=5))
def test_optimal_transport(data, num_fingers, keys):
    """No assignment of fingers to keys, or of keys to fingers where they are more, is shorter."""
    tips, centres = data.draw(fingertips(1, num_fingers)), data.draw(key_centres(1))
    goal = np.zeros((1, NUM_KEYS), bool)
    goal[0, keys] = True
    (assigned,) = reward.keys_by_transport(tips, centres, PRESS, goal, slice(0, num_fingers))
    given_away = assigned[assigned >= 0].tolist()
    assert len(set(given_away)) == len(given_away) == min(num_fingers, len(keys))
    assert set(given_away) <= set(keys)
    way = [[math.dist(tip, point(k, centres[0, k])) for k in range(NUM_KEYS)] for tip in tips[0]]
    if num_fingers < len(keys):
        sums = (
            sum(way[f][k] for f, k in enumerate(chosen))
            for chosen in permutations(keys, num_fingers)
        )
    else:
        sums = (
            sum(way[f][k] for k, f in zip(keys, chosen, strict=True))
            for chosen in permutations(range(num_fingers), len(keys))
        )
    ours = sum(way[f][k] for f, k in enumerate(assigned) if k >= 0)
    assert_allclose(ours, min(sums), **CLOSE)


def test_optimal_transport_row_by_row():
    """Rows without a key to press have no pairs, and are worth 1."""
    tips, centres = np.zeros((3, 10, 3)), np.tile(PIANO.centre, (3, 1, 1))
    goal = np.zeros((3, NUM_KEYS), bool)
    goal[1, [3, 50]] = True
    tips[1, 2], tips[1, 8] = point(50, PIANO.centre[50]), point(3, PIANO.centre[3])
    tips[1, 8, 1] += 0.11
    keys = reward.keys_by_transport(tips, centres, PRESS, goal, slice(2, 9))
    assert np.argwhere(keys >= 0).tolist() == [[1, 2], [1, 8]]
    assert keys[1, [2, 8]].tolist() == [50, 3]
    ours = reward.transport_fingering(tips, centres, PRESS, keys)
    assert_allclose(ours, [1.0, 0.55, 1.0], rtol=1e-6)


def test_jax_compiles_the_terms():
    """All that a step is rewarded for, in single precision."""
    n, rng = 3, np.random.default_rng(0)
    down, angles = rng.random(n) < 0.5, rng.uniform(-0.01, 0.1, (n, NUM_KEYS))
    for term, *arguments in (
        (reward.key_state, angles, PIANO.travel),
        (reward.key_activation, angles, PIANO.sounds_from),
        (reward.key_press, rng.random((n, NUM_KEYS)), *(rng.random((2, n, NUM_KEYS)) < 0.01)),
        (
            reward.graded_key_press,
            rng.random((n, NUM_KEYS)),
            *(rng.random((2, n, NUM_KEYS)) < 0.01),
        ),
        (reward.score_fingering, *around_keys(rng, n), rng.integers(-1, 10, (n, NUM_KEYS))),
        (reward.transport_fingering, *around_keys(rng, n), rng.integers(-1, NUM_KEYS, (n, 10))),
        (reward.energy, *rng.normal(size=(2, n, 38)), np.array(0.005)),
        (reward.sustain, down, ~down),
        (reward.forearm, down),
        (reward.onset_timing, some(rng, n, 0.02), np.array(0.5)),
        (reward.loudness, some(rng, n, 20.0), np.array(0.5)),
    ):
        compiled = jax.jit(term)(*map(jnp.asarray, arguments))
        assert_allclose(compiled, term(*arguments), rtol=1e-4, atol=1e-6, err_msg=term.__name__)


def some(rng: np.random.Generator, n: int, scale: float) -> np.ndarray:
    """Errors of the onsets of few keys."""
    errors = rng.normal(scale=scale, size=(n, NUM_KEYS))
    return np.where(rng.random((n, NUM_KEYS)) < 0.1, errors, np.nan)


def around_keys(rng: np.random.Generator, n: int) -> tuple[np.ndarray, ...]:
    """Fingertips, centres of keys, and where from there fingers are wanted."""
    return rng.uniform(-0.1, 0.1, (n, 10, 3)), np.tile(PIANO.centre, (n, 1, 1)), PRESS


@few
@given(st.data(), sizes, st.integers(1, 44), st.floats(0, 1))
def test_energy(data, n, actuators, coefficient):
    force, velocity = (data.draw(arrays((n, actuators), -20, 20)) for _ in range(2))
    ours = reward.energy(force, velocity, coefficient)
    for env in range(n):
        power = sum(abs(f) * abs(v) for f, v in zip(force[env], velocity[env], strict=True))
        assert_allclose(ours[env], -coefficient * power, **CLOSE)


@pytest.mark.parametrize("down", [True, False])
@pytest.mark.parametrize("goal", [True, False])
def test_sustain(down, goal):
    expected = gaussian(float(goal) - float(down), 0, 0.05, 0.5)
    assert_allclose(reward.sustain(np.array([down]), np.array([goal])), [expected], **CLOSE)


def test_forearm():
    assert_array_equal(reward.forearm(np.array([True, False])), [0.0, 0.5])


@few
@given(st.data(), sizes, st.floats(0, 2))
def test_onset_timing_and_loudness(data, n, coefficient):
    for term, most, bound, margin in (
        (reward.onset_timing, 0.1, 0.006, 0.044),
        (reward.loudness, 126.0, 10.8, 25.0),
    ):
        errors = data.draw(arrays((n, NUM_KEYS), -most, most))
        errors = np.where(data.draw(masks(n, NUM_KEYS)), errors, np.nan)
        ours = term(errors, coefficient)
        for env in range(n):
            near = [gaussian(abs(e), 0, bound, margin) for e in errors[env] if not math.isnan(e)]
            assert_allclose(ours[env], coefficient * sum(near), **CLOSE)


def test_keys_are_as_far_down_in_double_precision_after_they_were_in_single():
    """A program within another remembers what it met, and the keyboard outlives both."""
    inner = jax.jit(lambda angles: reward.key_state(angles, PIANO.travel))
    outer = jax.jit(lambda angles: inner(angles))
    for double in (False, True):
        with jax.enable_x64(double):
            angles = jnp.asarray(PIANO.travel / 3)
            assert_allclose(outer(angles), 1 / 3, rtol=1e-15 if double else 1e-6)
