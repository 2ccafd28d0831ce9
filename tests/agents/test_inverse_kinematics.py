"""Postures by least squares."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import minimize

from cadenza.agents.planner.plan import inverse_kinematics
from cadenza.agents.planner.plan.fingertip_targets import targets_of
from cadenza.agents.planner.plan.inverse_kinematics import (
    PostureEvaluation,
    PostureLinearisation,
    PostureProblem,
    solve_postures,
)
from cadenza.agents.planner.plan.kinematic_terms import (
    ForearmsApart,
    HandLinksApart,
    LinksApart,
    PosedHands,
    TipsBehindBlackKeys,
    TipsInBoxes,
)
from cadenza.agents.planner.plan.link_collisions import LinkCollisions
from cadenza.agents.planner.plan.nominal_trajectory import MotionPlanner
from cadenza.agents.planner.plan.presses import Press
from cadenza.agents.planner.plan.rest_poses import rest_posture
from cadenza.hands.forearm import WIDTH
from cadenza.hands.hand import Hand
from cadenza.hands.shadow import SHADOW
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import servos_of


def test_forearms_of_hands_that_play_close_together_do_not_touch():
    scene = build_scene()
    keys, fingers = np.zeros((40, 88), bool), np.full((40, 88), np.int8(-1))
    for first, (left, right) in enumerate(((39, 43), (37, 45), (39, 43))):  # C4 and E4, and apart
        for key, hand in (left, 1), (right, 0):
            steps = slice(10 + 10 * first, 20 + 10 * first)
            keys[steps, key] = True
            fingers[steps, key] = scene.fingers.per_hand * hand + 2
    *_, plan = MotionPlanner(scene, 0.05).plans(fingers, np.zeros(len(scene.hand_joint_names)))
    right, left = (i for i, name in enumerate(servos_of(scene).names) if name == "forearm_tx")
    mounted = scene.config.hand_spacing
    apart = mounted + plan.postures[:, right] - plan.postures[:, left]
    assert apart.min() > WIDTH


def test_links_keep_apart_by_their_radii(right_hand):
    """Against the distance of two segments as found by a general minimiser."""
    servos = servos_of(right_hand)
    rng = np.random.default_rng(0)
    postures = rng.uniform(servos.low, servos.high, (20, len(servos.low)))
    kinematics = Kinematics(right_hand)
    links, pairs = kinematics.links(postures), LinkCollisions(right_hand.hand).within_hand
    overlaps = pairs.overlaps(links.points[:, 0])
    step = 1e-6 * rng.standard_normal(len(servos.low))
    moved = pairs.overlaps(kinematics.links(postures + step).points[:, 0])
    deep = np.flatnonzero(overlaps.depth < -0.002)
    assert len(deep) > 5
    for i in deep:
        row, pair = overlaps.row[i], overlaps.pair[i]
        finger, link = overlaps.finger[:, i], overlaps.link[:, i]
        ends = tuple(links.points[row, 0, f, k : k + 2] for f, k in zip(finger, link, strict=True))
        nearest = minimize(distance_of_segments, [0.5, 0.5], ends, bounds=[(0, 1), (0, 1)])
        distance = np.sqrt(nearest.fun / 1e4)
        assert distance - pairs.min_distance[pair] == pytest.approx(overlaps.depth[i], abs=1e-5)
        slope = links.along(row, finger, link, overlaps.at[:, i], overlaps.away[:, i]).sum(axis=0)
        there = (moved.row == row) & (moved.pair == pair)
        assert moved.depth[there] - overlaps.depth[i] == pytest.approx(slope @ step, rel=1e-2)


@pytest.mark.parametrize("count", [1, 2])
def test_a_thumb_meets_only_fingers_that_are_there(count):
    hand = SimpleNamespace(fingers=SHADOW.fingers[:count], thumb_meets=2)
    shape = 1, count, len(hand.fingers[0].links) + 1, 3
    points = 0.01 * np.random.default_rng(0).standard_normal(shape)
    overlaps = LinkCollisions(cast(Hand, hand)).within_hand.overlaps(points)
    assert set(overlaps.finger.ravel().tolist()) <= set(range(count))


def distance_of_segments(x: np.ndarray, *ends: np.ndarray) -> float:
    """Of points part of the way along two segments, squared [cm^2]."""
    a, b = ends
    gap = a[0] + x[0] * (a[1] - a[0]) - b[0] - x[1] * (b[1] - b[0])
    return float(1e4 * np.sum(gap**2))


def close_hands(right: float, left: float) -> tuple[PostureProblem, np.ndarray]:
    """Three postures after the first, of hands that are this far from where they are mounted."""
    scene = build_scene()
    servos, rng = servos_of(scene), np.random.default_rng(3)
    rest = rest_posture(servos)
    guess = rest + 0.05 * rng.uniform(size=(4, len(rest))) * (servos.high - servos.low)
    guess[:, servos.along_keyboard] = right, left  # forearms are mounted 0.3 m apart
    targets = targets_of(scene, [Press("right", 1, 41, 1, 3)], 4, 0.05)
    kinematics = Kinematics(scene)
    problem = PostureProblem(kinematics, targets, guess, guess[0], 0.05)
    return problem, guess + 1e-3 * rng.standard_normal(guess.shape)


def evaluated(
    problem: PostureProblem, postures: np.ndarray, known: PostureLinearisation | None = None
) -> PostureEvaluation:
    return problem.evaluation(postures, problem.linearisation(postures, known))


@pytest.mark.parametrize("number", range(5))
def test_terms_have_the_jacobian_of_their_residuals(number):
    """The gradient of their squares against finite differences, of hands that interlock."""
    scene = build_scene()
    servos, rng = servos_of(scene), np.random.default_rng(5)
    (slide, _), collisions = servos.along_keyboard, LinkCollisions(scene.hand)
    box = rng.uniform(-0.1, 0.1, (3, 2, 5, 3))
    term = (
        TipsInBoxes(box, box + 0.01, np.full_like(box, 0.002)),
        TipsBehindBlackKeys(np.full((3, 2, 5), 1.0)),
        LinksApart(collisions.within_hand),
        HandLinksApart(collisions),
        ForearmsApart(slide, scene.config.hand_spacing),
    )[number]
    here = rest_posture(servos) + 0.1 * rng.standard_normal((3, len(servos.low)))
    here[:, servos.along_keyboard] = -0.08, 0.1
    kinematics = Kinematics(scene)

    def at(postures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        by_hand = postures.reshape(3, 2, -1)
        return term(PosedHands(np.arange(3), by_hand, kinematics.links(postures)))

    residual, jacobian = at(here)
    assert residual.any()
    change = rng.standard_normal(here.shape)
    moved = [0.5 * (at(here + sign * 1e-6 * change)[0] ** 2).sum() for sign in (1, -1)]
    weighted = residual.reshape(3, -1, residual.shape[-1], 1) * jacobian
    slope = (weighted.sum(axis=2).reshape(here.shape) * change).sum()
    assert (moved[0] - moved[1]) / 2e-6 == pytest.approx(slope, rel=1e-3)


@pytest.fixture
def _exactly(monkeypatch):
    monkeypatch.setattr(
        inverse_kinematics, "_REAL", np.dtype(float)
    )  # differences lack digits else


@pytest.mark.usefixtures("_exactly")
def test_hands_give_way_to_each_other_as_the_gradient_says():
    """Of postures that interlock, against finite differences of what they cost."""
    problem, here = close_hands(-0.08, 0.1)
    now = evaluated(problem, here)
    assert now.linearisation.close.tolist() == [0, 1, 2]
    _, gradient = problem.normal_equations(here, now)
    change = np.random.default_rng(4).standard_normal((3, here.shape[1]))
    moved = [
        evaluated(problem, here + sign * 1e-6 * np.pad(change, ((1, 0), (0, 0)))).cost.sum()
        for sign in (1, -1)
    ]
    slope = (gradient.reshape(3, -1) * change).sum()
    assert (moved[0] - moved[1]) / 2e-6 == pytest.approx(slope, rel=1e-4)


@pytest.mark.usefixtures("_exactly")
def test_only_postures_that_have_moved_are_linearised_anew():
    problem, here = close_hands(-0.06, 0.085)
    known = evaluated(problem, here).linearisation
    assert known.close.tolist() == [0, 1, 2]  # the forearms
    there = here + 1e-5 * np.random.default_rng(4).standard_normal(here.shape)
    assert evaluated(problem, there, known).linearisation is known
    there[2] += 0.02
    some, anew = evaluated(problem, there, known), evaluated(problem, there)
    assert (some.linearisation.at == known.at).all(axis=(1, 2)).tolist() == [True, False, True]
    assert some.cost == pytest.approx(anew.cost, rel=1e-6)
    assert some.gradient == pytest.approx(anew.gradient, abs=1e-5 * np.abs(anew.gradient).max())
    assert known.gradient[0] != pytest.approx(
        anew.gradient[0], abs=1e-5 * np.abs(anew.gradient).max()
    )
    (bands, _), (bands_anew, _) = (problem.normal_equations(there, at) for at in (some, anew))
    assert bands == pytest.approx(bands_anew, abs=1e-3 * bands_anew.max())


def test_postures_are_found_where_single_precision_does_not_do(monkeypatch, right_hand):
    """Where LAPACK says that a matrix of floats is not positive definite."""
    servos = servos_of(right_hand)
    guess = np.tile(rest_posture(servos), (12, 1))
    targets = targets_of(right_hand, [Press("right", 1, 41, 5, 8)], 12, 0.05)

    def found() -> np.ndarray:
        kinematics = Kinematics(right_hand)
        return solve_postures(kinematics, targets, guess, guess[0], 0.05)

    def not_positive_definite(band: np.ndarray, own: np.ndarray, **_: Any) -> Any:
        return band, own, 1

    usual = found()
    monkeypatch.setattr(inverse_kinematics.lapack, "spbsv", not_positive_definite)
    assert found() == pytest.approx(usual, abs=1e-3)
