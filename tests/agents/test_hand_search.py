"""The receding-horizon search of one hand."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from one_hand import OneHand

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.planner.search import hand_search
from cadenza.agents.planner.search.fingertip_correction import servo_corrections
from cadenza.agents.planner.search.hand_search import HandSearch
from cadenza.agents.planner.search.horizon_cost import HorizonCost
from cadenza.agents.planner.search.rollouts import Rollouts, start_rollouts
from cadenza.agents.planner.search.search_ahead import RESTARTS_PER_WINDOW
from cadenza.agents.rollout import play_episode
from cadenza.fingers import Side
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.piano_task import PianoTask
from melodies import BUFFER, melody
from numbered import finger

HORIZON = 7  # steps


def octaves(side: Side, white: int, black: int, length: float) -> Score:
    """An octave on white keys, from which the hand jumps to one on black keys."""
    low, high = (0, 4) if side == "right" else (9, 5)
    return Score(
        tuple(
            Note(start, end, pitch + up, finger=finger(number))
            for start, end, pitch in ((0.0, 0.4, white), (0.4, 0.4 + length, black))
            for up, number in ((0, low), (12, high))
        )
    )


def search_of(hand: OneHand, **options: Any) -> HandSearch:
    config = PlannerConfig(proposals="none", **options)
    (side,) = hand.plan.scene.sides
    return HandSearch(hand.plan, side, np.random.default_rng(0), config)


def play(hand: OneHand, search: HandSearch) -> None:
    """One step."""
    hand.simulation.step(search.act(*hand.joint_state)[None])


@pytest.mark.parametrize(
    ("side", "white", "black"), [("left", 64, 66), ("right", 60, 61), ("right", 59, 61)]
)
def test_caught_fingers_get_free(side, white, black):
    hand = OneHand(octaves(side, white, black, 2.0), side)
    keys = [black - 21, black - 9]

    def sound() -> bool:
        return bool((hand.simulation.state.key_qpos[0, keys] >= PIANO.sounds_from[keys]).all())

    as_planned = search_of(hand, method="none")
    for _ in range(25):
        play(hand, as_planned)
    assert not sound()
    search, simulated = search_of(hand), []
    search.restart(hand.goals, hand.tracking, 25, np.random.default_rng(0))
    for _ in range(15):
        play(hand, search)
        simulated.append(sound())
    assert any(simulated)


@pytest.mark.slow
@pytest.mark.parametrize(("white", "black"), [(59, 56), (60, 58), (60, 49), (62, 44)])
def test_jumps_from_white_octaves_to_black_ones_land(white, black):
    task = PianoTask([octaves("left", white, black, 1.2)], BUFFER, SceneConfig(hands="left"))
    agent = Planner(PlannerConfig(fingering="score"))
    assert play_episode(task, agent).metrics["f1"] > 0.75


def rollouts_of(hand: OneHand, first: int) -> tuple[Rollouts, HorizonCost, np.ndarray]:
    """Rollouts from step `first` on, after the plan was played so far, their cost and controls."""
    as_planned = search_of(hand, method="none")
    for _ in range(first):
        play(hand, as_planned)
    rollouts = Rollouts(hand.simulator)
    steps = np.arange(first, first + HORIZON)
    horizon = start_rollouts(hand.simulator, hand.simulation, hand.goals, steps, PIANO)
    rollouts.start(horizon)
    return rollouts, horizon, hand.tracking.ctrl[steps]


def test_fingertips_off_their_targets_are_corrected():
    hand = OneHand(melody(60, 64, 67, length=0.4))
    rollouts, horizon, nominal = rollouts_of(hand, 6)
    astray = hand.servos.clip(nominal + 2 * hand.servos.noise)
    before = rollouts.simulate(astray)
    error, weight = horizon.fingertip_errors(np.array(before.fingertips))
    jacobian = hand.simulator.fingertip_jacobian(np.array(before.hand_qpos))
    change = servo_corrections(error, weight, jacobian, hand.servos)
    later = np.minimum(np.arange(HORIZON) + 1, HORIZON - 1)
    after = [rollouts.simulate(hand.servos.clip(astray + k * change[later])) for k in (1, 2)]
    assert min(rollout.cost for rollout in after) < 0.5 * before.cost
    assert min(rollout.mistakes for rollout in after) < before.mistakes


def test_giving_candidates_up_early_changes_no_cost_that_counts():
    hand = OneHand(melody(60, 79, 61, length=0.2))
    rollouts, _, nominal = rollouts_of(hand, 8)
    noise = np.random.default_rng(0).standard_normal((10, 1, nominal.shape[1]))
    spread = np.linspace(0.5, 10.0, len(noise))[:, None, None]  # some are soon far off
    candidates = hand.servos.clip(nominal + spread * hand.servos.noise * noise)
    full = [rollouts.simulate(ctrl) for ctrl in candidates]
    cutoff = float(np.median([rollout.cost for rollout in full]))
    cut = [rollouts.simulate(ctrl, cutoff) for ctrl in candidates]
    kept = [pair for pair in zip(full, cut, strict=True) if np.isfinite(pair[1].cost)]
    assert 0 < len(kept) < len(candidates)
    assert all(before[:3] == after[:3] for before, after in kept)
    assert min(rollout.cost for rollout in full) == min(rollout.cost for rollout in cut)


@pytest.mark.slow
def test_hopeless_music_is_searched_within_bounds(monkeypatch):
    simulated = []
    run = hand_search.HandRollouts.run

    def counted(simulator: hand_search.HandRollouts, *args: Any) -> Iterator[object]:
        for state in run(simulator, *args):
            simulated.append(1)
            yield state

    monkeypatch.setattr(hand_search.HandRollouts, "run", counted)
    leaps = PianoTask([melody(*[40, 90] * 2, length=0.1)], BUFFER, SceneConfig(hands="right"))
    agent = Planner(PlannerConfig(num_candidates=8, iterations=5))
    steps = play_episode(leaps, agent).metrics["steps"]
    share = sum(simulated) / steps / (5 * 8 * HORIZON)
    refined = (hand_search.REFINEMENTS + 1) * hand_search.REFINED_HORIZON / (5 * 8 * HORIZON)
    most = 1.05 + refined / hand_search.BUDGET_SHARE
    restarted = 1 + 2 * RESTARTS_PER_WINDOW  # a restart plays two windows
    assert 0.5 < share / hand_search.BUDGET_SHARE < restarted * most
