"""Plans of whole songs in windows, controls that follow them, and how rollouts correct those."""

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan import nominal_trajectory
from cadenza.agents.planner.plan.nominal_trajectory import MotionPlanner
from cadenza.agents.planner.plan.tracking import Tracking, discretised, track
from cadenza.agents.planner.planner import Planner
from cadenza.agents.planner.search.fingertip_correction import CONTROL_TOLERANCE, control_update
from cadenza.agents.rollout import play_episode
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene, hand_alone
from cadenza.scene.servos import servos_of
from cadenza.tasks.piano_task import PianoTask
from melodies import BUFFER, COARSER, FINER, melody, whole_plan
from watched import watched


@pytest.fixture
def short_windows(monkeypatch):
    monkeypatch.setattr(nominal_trajectory, "_FIRST_WINDOW", 1.0)
    monkeypatch.setattr(nominal_trajectory, "_MAX_WINDOW", 1.5)
    monkeypatch.setattr(nominal_trajectory, "_OVERLAP", 1.5)


def test_windows_plan_what_the_whole_song_at_once_does(request):
    held = (Note(0.0, 1.9, 60), Note(2.4, 4.8, 67))
    leaps = [  # but none that the hand cannot reach from what it holds
        note
        for note in melody(*[64, 79, 67, 84, 72, 71] * 3, length=0.3).notes
        if note.pitch <= 72 or not any(each.start <= note.start < each.end for each in held)
    ]
    score = Score((*held, *leaps))
    at_once = whole_plan(score).nominal
    request.getfixturevalue("short_windows")
    windows = whole_plan(score).nominal
    assert windows.num_steps == at_once.num_steps > 90
    assert windows.presses == at_once.presses
    holding = np.zeros(windows.fingertips.shape[:2], bool)
    for press in windows.presses:
        holding[press.first : press.last, press.finger] = True
    apart = np.linalg.norm(windows.fingertips - at_once.fingertips, axis=2)
    assert np.median(apart[holding]) < 0.0005
    ways = [np.linalg.norm(np.diff(n.fingertips, n=2, axis=0), axis=2) for n in (windows, at_once)]
    assert ways[0][19::30].max() < 1.05 * ways[1].max()  # no jerk where windows meet


@pytest.mark.usefixtures("short_windows")
def test_windows_begin_with_what_was_found_for_the_same_steps(monkeypatch):
    solved = watched(monkeypatch, nominal_trajectory, "solve_postures")
    whole_plan(melody(*[64, 79, 67, 84, 72, 71] * 3, length=0.3))
    begins = [given[6] - given[2] for given, _ in solved]
    improved = [later - given[2] for given, later in solved]
    assert len(begins) > 2
    assert not begins[0].any()
    overlap = 30  # steps
    for begin, before in zip(begins[1:], improved, strict=False):
        np.testing.assert_allclose(begin[1 : overlap + 1], before[-overlap:], atol=1e-12)
        assert not begin[overlap + 1 :].any()


@pytest.mark.usefixtures("short_windows")
def test_a_long_song_is_planned_as_it_is_played():
    score = melody(*[60, 62, 64, 65, 67] * 5, length=0.3)
    task = PianoTask([score], BUFFER, SceneConfig(hands="right"))
    agent, planned = Planner(PlannerConfig(method="none")), []

    def progress(stage: str, done: int, _: int) -> None:
        if stage == "playing":
            planned.append(agent.planners[0].plan.nominal.num_steps - done)

    performance = play_episode(task, agent, progress=progress)
    assert planned[0] == 19  # the first window is shorter
    assert min(planned[:-14]) > 12  # what the search looks ahead
    assert max(planned) < 70
    assert agent.planners[0].plan.complete
    assert performance.metrics["f1"] > 0.9


@pytest.fixture
def first_guess(monkeypatch):
    """Makes plans of the first guess, without solving anything, and of hands that keep still."""

    def still(_: object, reference: NDArray[np.float64], *__: object) -> Tracking:
        steps, servos = len(reference) - 1, reference.shape[1]
        shapes = (steps, servos), (steps, servos, 2), (steps + 1, servos, 2)
        return Tracking(*map(np.zeros, shapes))

    monkeypatch.setattr(nominal_trajectory, "solve_postures", lambda *given: given[2])
    monkeypatch.setattr(nominal_trajectory, "track", still)


@pytest.mark.usefixtures("first_guess")
def test_windows_let_go_later_where_the_whole_song_does(request):
    score = melody(*[48, 79] * 8, length=0.3)
    usual = whole_plan(score).nominal
    later = np.zeros((usual.num_steps, 1), np.int8)
    later[usual.num_steps // 2 :] = 1
    at_once = whole_plan(score, later).nominal
    request.getfixturevalue("short_windows")
    windows = whole_plan(score, later).nominal
    assert windows.presses == at_once.presses
    held = [
        press.last - plain.last for press, plain in zip(at_once.presses, usual.presses, strict=True)
    ]
    assert held[:-1] == [later[press.first - 1, 0] for press in at_once.presses[1:]]


@pytest.mark.usefixtures("first_guess")
@pytest.mark.parametrize("dt", [0.01, FINER, COARSER])
def test_windows_last_as_long_at_any_control_step(dt, right_hand):
    start = np.zeros(len(right_hand.hand_joint_names))

    def ends(seconds: float) -> list[float]:
        keys = np.zeros((round(seconds / dt), 88), bool)
        fingers = np.full(keys.shape, -1, np.int8)
        plans = MotionPlanner(right_hand, dt).plans(fingers, start)
        return [plan.num_steps * dt for plan in plans]

    assert ends(6.5) == pytest.approx([6.5])
    assert ends(80.0) == pytest.approx([2.5, 10.0, 36.0, 62.0, 80.0])


@pytest.mark.usefixtures("first_guess")
def test_memory_of_a_long_song_is_that_of_its_plan():
    scene = build_scene()
    servos = hand_alone(scene, "left").servos
    followed = list[Tracking]()

    def peak_and_plan(steps: int) -> tuple[int, int]:
        keys, fingers = np.zeros((steps, 88), bool), np.full((steps, 88), -1, np.int8)
        keys[10::4, 40], fingers[10::4, 40] = True, 2
        start = np.zeros(len(scene.hand_joint_names))
        tracemalloc.start()
        for plan in MotionPlanner(scene, 0.05).plans(fingers, start):
            followed[:] = [plan.tracking.of(servos)]
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        arrays = plan.postures, plan.fingertips, *plan.tracking
        return most, sum(values.nbytes for values in arrays)

    (short, short_plan), (long, long_plan) = map(peak_and_plan, (2400, 7200))
    assert long - short < 1.2 * (long_plan - short_plan)


@pytest.mark.parametrize("dt", [FINER, COARSER])
def test_hands_glide_as_fast_at_any_control_step(dt, right_hand):
    start = np.zeros(len(right_hand.hand_joint_names))

    def speed(dt: float) -> float:
        keys = np.zeros((round(2.4 / dt), 88), bool)
        for key, begin, end in ((45, 0.6, 0.9), (55, 1.4, 1.8)):
            keys[round(begin / dt) : round(end / dt), key] = True
        fingers = np.where(keys, np.int8(1), np.int8(-1))
        *_, plan = MotionPlanner(right_hand, dt).plans(fingers, start)
        (slide,) = servos_of(right_hand).along_keyboard
        return float(np.diff(plan.postures[:, slide]).std() / dt)

    assert speed(dt) == pytest.approx(speed(0.05), rel=0.15)


def test_postures_are_such_that_their_controls_reach_them(right_hand):
    """A thumb on black keys needs the hand further in than on white ones, as soon as it strikes."""
    keys = np.zeros((60, 88), bool)
    for i, key in enumerate((39, 40, 41, 42)):  # C4, C#4, D4, D#4
        keys[20 + 8 * i : 24 + 8 * i, key] = True
    fingers = np.where(keys, np.int8(0), np.int8(-1))
    start = np.zeros(len(right_hand.hand_joint_names))
    *_, plan = MotionPlanner(right_hand, 0.05).plans(fingers, start)
    inwards = servos_of(right_hand).names.index("forearm_ty")
    lacking = np.abs(plan.postures - plan.tracking.expected[:, :, 0])[:, inwards]
    assert lacking[keys.any(axis=1).nonzero()[0] + 1].max() < 0.005


# Tracking


def test_servos_follow_as_their_figures_say(right_hand):
    """The tracker's own prediction against the simulation, in the air."""
    servos = servos_of(right_hand)
    middle = 0.5 * (servos.low + servos.high)
    sway = 0.1 * (servos.high - servos.low) * np.sin(np.arange(41) * 0.3)[:, None]
    sway[:, [name.startswith("forearm") for name in servos.names]] *= 0.1
    reference = np.clip(middle + sway - sway[0], servos.low, servos.high)
    start = np.stack([reference[0], np.zeros(len(servos.low))], axis=1)
    tracking = track(servos, reference, start, np.zeros((40, len(servos.low))), 0.05)
    assert np.abs(tracking.expected[5:, :, 0] - reference[5:]).max() < 0.01
    assert (servos.low <= tracking.ctrl).all()
    assert (tracking.ctrl <= servos.high).all()


def test_a_forearm_follows_a_jump_without_delay():
    servos = servos_of(build_scene(SceneConfig(hands="right")))
    (slide,) = servos.along_keyboard
    reference = np.tile(np.clip(0.0, servos.low, servos.high), (16, 1))
    reference[:, slide] = 0.1 * (1 - np.cos(np.pi * np.clip((np.arange(16) - 5) / 5, 0, 1)))
    start = np.stack([reference[0], np.zeros(len(servos.low))], axis=1)
    expected = track(servos, reference, start, np.zeros((15, len(servos.low))), 0.05).expected
    assert np.abs(expected[:, slide, 0] - reference[:, slide]).max() < 0.005


DT, STEPS, FINGERS = 0.05, 6, 5


@pytest.fixture(scope="module")
def alone():
    return hand_alone(build_scene(SceneConfig()), "right").scene


def test_least_squares_over_all_steps_at_once(alone):
    servos, rng = servos_of(alone), np.random.default_rng(0)
    count = len(servos.low)
    off = 0.01 * rng.standard_normal((STEPS, FINGERS, 3))
    weight = rng.random((STEPS, FINGERS))
    motion = 0.05 * rng.standard_normal((STEPS, FINGERS, 3, count))
    gain = 0.2 * rng.random((STEPS, count, 2))
    step, push = discretised(servos, DT)

    def led_to(change: np.ndarray) -> np.ndarray:
        """(STEPS, FINGERS, 3) where changes (STEPS, A) take fingertips: step by step."""
        state, there = np.zeros((count, 2)), []
        for t in range(STEPS):
            ctrl = change[t] - (gain[t] * state).sum(axis=1)
            state = np.einsum("aij,aj->ai", step, state) + push * ctrl[:, None]
            there.append(motion[t] @ state[:, 0])
        return np.array(there)

    response = np.array(
        [led_to(unit.reshape(STEPS, count)).ravel() for unit in np.eye(STEPS * count)]
    ).T
    root = np.repeat(np.sqrt(weight), 3, axis=1).ravel() / CONTROL_TOLERANCE
    rows = np.concatenate([root[:, None] * response, np.diag(np.tile(1 / servos.noise, STEPS))])
    targets = np.concatenate([root * off.ravel(), np.zeros(STEPS * count)])
    expected = np.linalg.lstsq(rows, targets, rcond=None)[0].reshape(STEPS, count)
    update = control_update(off, weight, motion, gain, servos, DT)
    np.testing.assert_allclose(update, expected, atol=1e-9)
