"""iLQG: its parts against other solvers and the simulation itself, and that planning pays."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import solve_discrete_are
from scipy.optimize import lsq_linear
from threadpoolctl import threadpool_limits

from begun import begun
from cadenza.agents.agent import Agent, ZeroAgent
from cadenza.agents.baselines.control_limited_ddp import FeedbackLaw, Model, backward_pass, box_qp
from cadenza.agents.baselines.ilqg import ILQG, ILQGPlanner
from cadenza.agents.planner.config import ILQGConfig
from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.linearisation import Lineariser
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from melodies import TUNE
from numbered import finger
from watched import watched

CHORD = Score(tuple(Note(0.0, 0.3, 72 + 2 * i, finger=finger(i)) for i in range(1, 4)))
SHORT = ILQGConfig(horizon=0.1)


@pytest.fixture(scope="module")
def right_hand():
    return build_scene(SceneConfig(hands="right", physics="fast"))


@pytest.fixture(scope="module")
def waking():
    return build_scene(SceneConfig(hands="right", sleeping_keys=False))


# The box-constrained quadratic programme


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 40), st.floats(0.01, 10))
@example(1762, 12, 6.0)  # once left a rounding beside a limit, and stuck there
def test_box_qp_agrees_with_scipy(seed, size, width):
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((size + 5, size)), rng.standard_normal(size + 5)
    low = rng.uniform(-width, width / 2, size)
    high = low + rng.uniform(0.01, width, size)
    x, free = box_qp(a.T @ a, -a.T @ b, low, high, rng.standard_normal(size))
    expected = lsq_linear(a, b, (low, high), tol=1e-14, method="bvls")
    assert_allclose(x, expected.x, atol=1e-6)
    assert_array_equal(free, (x > low) & (x < high))


def test_box_qp_refuses_what_has_no_minimum():
    with pytest.raises(np.linalg.LinAlgError):
        box_qp(-np.eye(2), np.ones(2), np.full(2, -9.0), np.full(2, 9.0), np.zeros(2))


# The backward pass


def linear_quadratic(steps: int, n: int = 5, m: int = 3) -> Model:
    """The same dynamics and cost at every step."""
    rng = np.random.default_rng(3)
    transition = rng.standard_normal((n, n + m)) * 0.5
    root = rng.standard_normal((n + m + 2, n + m))
    repeated = (np.repeat(part[None], steps, axis=0) for part in (transition, root.T @ root))
    transitions, hessians = repeated
    return Model(transitions, rng.standard_normal((steps, n + m)), hessians)


def unlimited(model: Model, steps: int, m: int = 3) -> FeedbackLaw:
    nowhere = np.full(m, np.inf)
    return backward_pass(model, np.zeros((steps, m)), -nowhere, nowhere, 0.0)


def test_without_limits_the_gain_is_the_riccati_equations():
    n, steps = 5, 200
    model = linear_quadratic(steps)
    a, b = model.transition[0, :, :n], model.transition[0, :, n:]
    q, s, r = model.hessian[0, :n, :n], model.hessian[0, :n, n:], model.hessian[0, n:, n:]
    p = solve_discrete_are(a, b, q, r, s=s)
    gain = -np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a + s.T)
    assert_allclose(unlimited(model, steps).gain[0], gain, rtol=1e-8)


def test_without_limits_the_offsets_minimise_the_whole_cost():
    """All controls at once as one dense least squares problem, from a state of zero."""
    n, m, steps = 5, 3, 6
    model = linear_quadratic(steps)
    policy = unlimited(model, steps)
    by_all = np.zeros((n, steps * m))  # the state's derivatives by all controls
    hessian, gradient = np.zeros((steps * m, steps * m)), np.zeros(steps * m)
    for k in range(steps):
        own = np.zeros((m, steps * m))
        own[:, k * m : (k + 1) * m] = np.eye(m)
        z = np.concatenate([by_all, own])
        hessian += z.T @ model.hessian[k] @ z
        gradient += z.T @ model.gradient[k]
        by_all = model.transition[k] @ z
    expected = -np.linalg.solve(hessian, gradient).reshape(steps, m)
    state = np.zeros(n)
    for k in range(steps):
        control = policy.offset[k] + policy.gain[k] @ state
        assert_allclose(control, expected[k], rtol=1e-8)
        state = model.transition[k] @ np.concatenate([state, control])


def test_controls_at_a_limit_stay_there_and_ignore_the_state():
    steps, limit = 8, np.full(3, 0.1)
    controls = np.random.default_rng(0).uniform(-limit, limit, (steps, 3))
    policy = backward_pass(linear_quadratic(steps), controls, -limit, limit, 0.0)
    new = controls + policy.offset
    assert (np.abs(new) <= limit + 1e-15).all()
    clamped = np.abs(new) >= limit - 1e-12
    assert clamped.any()
    assert not clamped.all()
    assert_array_equal((policy.gain == 0).all(axis=2), clamped)


def test_regularisation_shortens_the_steps():
    model, limit = linear_quadratic(1), np.full(3, 100.0)
    lengths = [
        np.linalg.norm(backward_pass(model, np.zeros((1, 3)), -limit, limit, mu).offset)
        for mu in (0.0, 1.0, 100.0)
    ]
    assert lengths[0] > lengths[1] > lengths[2] > 0


# Derivatives


def pressing(scene: Scene) -> tuple[PlanningSimulation, np.ndarray]:
    """A hand that leans on the keys, and the controls that make it."""
    simulation = PlanningSimulation(scene)
    low, high = scene.action_low[:-1], scene.action_high[:-1]
    ctrl = np.random.default_rng(2).uniform(low, high)
    wrist = scene.actuator_names.index("rh_A_WRJ1")
    ctrl[wrist] = high[wrist] - 0.01  # bent down, and within the limits
    for _ in range(8):
        simulation.step(ctrl[None])
    return simulation, ctrl


@pytest.mark.parametrize("part", ["positions", "velocities", "controls"])
def test_derivatives_over_a_control_step_are_those_of_the_simulation(part, waking):
    simulation, ctrl = pressing(waking)
    assert (simulation.state.key_qpos > 0.01).sum() > 2
    start, joints = simulation.physics_state(0), waking.model.nv
    lineariser = Lineariser(waking, 1, 10, num_threads=2)
    jacobian = lineariser.linearise(start, ctrl[None]).jacobian[0, 1::2]
    rng, size = np.random.default_rng(0), len(ctrl) if part == "controls" else joints
    first = {"positions": 0, "velocities": joints, "controls": 2 * joints}[part]
    assert_array_equal(start[1 : 1 + 2 * joints], simulation.coordinates()[0])
    for _ in range(3):
        direction = np.zeros(2 * joints + len(ctrl))
        direction[first : first + size] = rng.standard_normal(size)
        expected = slope(waking, start, ctrl, direction)
        assert_allclose(jacobian @ direction, expected, atol=3e-3 * np.abs(expected).max(), rtol=0)


def slope(scene: Scene, start: np.ndarray, ctrl: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(5, 2 V) change of the states on the way per change of start and controls."""
    ends, num = [], 2 * scene.model.nv
    for change in (-1e-8, 1e-8):
        state = start.copy()
        state[1 : 1 + num] += change * direction[:num]
        simulation = PlanningSimulation(scene, control_timestep=0.01)
        simulation.set_physics_state(state)
        way = []
        for _ in range(5):
            simulation.step((ctrl + change * direction[num:])[None])
            way.append(simulation.coordinates()[0])
        ends.append(np.array(way))
    return (ends[1] - ends[0]) / 2e-8


def test_geometry_after_each_physics_step_is_that_of_the_simulation(waking):
    simulation, ctrl = pressing(waking)
    seen = Lineariser(waking, 2, 10).linearise(simulation.physics_state(0), np.array([ctrl, ctrl]))
    for k in range(2):
        simulation.step(ctrl[None])
        for name in ("key_qpos", "key_xpos", "fingertip_xpos"):
            there = getattr(simulation.state, name)[0]
            assert_allclose(getattr(seen, name)[k, -1], there, atol=1e-9)
    by_joint = displaced(waking, simulation.state.hand_qpos[0])
    assert_allclose(seen.fingertip_jacobian[1, -1, :, :, waking.hand_qvel], by_joint, atol=1e-6)


def displaced(scene: Scene, hand_qpos: np.ndarray) -> np.ndarray:
    """(10, 3, J) central differences of the fingertips by the hands' joints."""
    columns = []
    for step in 1e-6 * np.eye(len(hand_qpos)):
        simulation = PlanningSimulation(scene, 2)
        simulation.reset(hand_qpos=np.array([hand_qpos - step, hand_qpos + step]))
        columns.append(np.diff(simulation.state.fingertip_xpos, axis=0)[0] / 2e-6)
    return np.moveaxis(np.array(columns), 0, -1)


def test_sleeping_keys_have_no_derivatives(right_hand):
    with pytest.raises(CadenzaError, match="sleeping_keys"):
        Lineariser(right_hand, 1, 1)


def started(
    planner: Agent, scene: Scene, silent: bool = False, score: Score = TUNE, **options: Any
) -> PianoTask:
    config = TaskConfig(initial_buffer_time=0.3 if silent else 0.0, **options)
    return begun(PianoTask([score], config, scene), planner)


@pytest.mark.parametrize(
    ("score", "fingering"), [(TUNE, "auto"), (TUNE, "transport"), (CHORD, "auto")]
)
def test_the_gradient_is_that_of_the_cost(right_hand, score, fingering):
    planner = ILQG(ILQGConfig(horizon=0.05, centred=True))
    task = started(planner, right_hand, score=score, fingering=fingering)
    planner.act(task.view())
    planner = planner.planners[0]
    start = task.simulation.physics_state(0)
    planner.nominal = nominal = 0.9 * planner.nominal  # away from the limits
    gradient = planner.approximate(start).gradient[0, -nominal.shape[1] :]
    rng = np.random.default_rng(1)
    for _ in range(4):
        change = 1e-5 * rng.standard_normal(nominal.shape)
        costs = []
        for sign in (-1, 1):
            planner.nominal = nominal + sign * change
            still = FeedbackLaw(np.zeros(nominal.shape), np.zeros((1, nominal.shape[1], 2 * 111)))
            costs.append(planner.line_search(still, start)[1][0])
        assert_allclose((costs[1] - costs[0]) / 2, gradient @ change[0], rtol=1e-3, atol=1e-9)


# The agent


def perform(agent: Agent, scene: Scene, **options: Any) -> EpisodeResult:
    config = TaskConfig(initial_buffer_time=0.1, **options)
    return play_episode(PianoTask([TUNE], config, scene), agent)


def test_the_next_plan_begins_with_the_last_one_a_step_later(right_hand, monkeypatch):
    for part in ("approximate", "improve"):  # nothing is found that is better
        monkeypatch.setattr(ILQGPlanner, part, lambda *_: None)
    task = started(planner := ILQG(ILQGConfig(horizon=0.15)), right_hand)
    planner.act(task.view())
    planned = planner.planners[0]
    planned.nominal = nominal = np.random.default_rng(0).uniform(-1, 1, (3, 19))
    action = planner.act(task.view())
    assert_allclose(task.spec.unscale_action(action)[0, :-1], nominal[0])
    assert_array_equal(planned.nominal, nominal[[1, 2, 2]])


def test_planning_lowers_its_cost(right_hand, monkeypatch):
    searched = watched(monkeypatch, ILQGPlanner, "line_search")
    planner = ILQG(ILQGConfig(horizon=0.1, iterations=4))
    planner.act(started(planner, right_hand).view())
    costs = [cost for _, (_, cost) in searched]
    first, *_, last = costs
    assert last.min() < 0.9 * first[0]
    for before, after in pairwise(costs):
        assert after[0] == before.min()  # what was chosen costs the same again


def test_planning_pays(right_hand):
    planned, resting = perform(ILQG(SHORT), right_hand), perform(ZeroAgent(), right_hand)
    assert planned.metrics["return"] > resting.metrics["return"] + 3


def test_same_bits_for_any_number_of_threads():
    """Also of linear algebra, which adds up otherwise with two where matrices are large."""
    config = ILQGConfig(horizon=0.1, planning_timestep=0.05, num_step_sizes=2)
    actions = []
    for threads in (1, 2):
        planner = ILQG(config)
        planner.num_threads = threads
        with threadpool_limits(threads):
            task = PianoTask([Score((Note(0.0, 0.1, 60),))])
            first = play_episode(task, planner, stop=lambda: True)
        actions.append(first.episode["action"])
    assert_array_equal(*actions)


@pytest.mark.parametrize("hands", ["left", "none"])
def test_plans_for_other_hands(hands):
    scene = build_scene(SceneConfig(hands=hands, physics="fast"))
    planner = ILQG(SHORT)
    task = started(planner, scene)
    task.step(planner.act(task.view()))
    (action,) = planner.act(task.view())
    assert action.shape == (task.spec.action_size,)
    assert (action >= task.spec.action_low).all()
    assert (action <= task.spec.action_high).all()
