"""What the search expects hands to lose on their way, against what the planner cuts."""

from __future__ import annotations

import numpy as np
import pytest

from cadenza.agents.planning.presses import let_go_in_time, presses_of
from cadenza.fingers import Fingers
from cadenza.hands.shadow.hand import SHADOW
from cadenza.keyboards.piano import PIANO
from cadenza.music.goals import score_to_goals
from cadenza.music.score import Note, Score
from numbered import finger, numbers
from players import find_fingering, solve

DT = 0.05
FINGERS = Fingers(5)


def steps_cut(score: Score) -> int:
    """Of the first press, by the planner."""
    goals = score_to_goals(score, DT, hands=FINGERS)
    presses = presses_of(goals.keys, goals.fingers, FINGERS)
    rest = np.concatenate([SHADOW.reach.rest, -SHADOW.reach.rest])
    cut = let_go_in_time(presses, PIANO.grid_y[:, None] - rest, DT, SHADOW)
    return presses[0].last - cut[0].last


@pytest.mark.parametrize("fingers", [(0, 4), (1, 1), (1, 2)])
@pytest.mark.parametrize("way", [2, 5, 9, 12, 19, 31])
def test_a_way_costs_what_the_planner_cuts(way: int, fingers: tuple[int, int]) -> None:
    """From one key to another, beyond what it costs to play them with time between."""

    def played(start: float) -> Score:
        one, other = map(finger, fingers)
        return Score(
            (Note(0, 0.5, 55, finger=one), Note(start, start + 0.5, 55 + way, finger=other))
        )

    soon, late = played(0.5), played(1.0)
    lost = solve(soon, ["right"]).cost - solve(late, ["right"]).cost
    assert lost == pytest.approx(steps_cut(soon), abs=0.75)


def test_the_hand_that_need_not_let_go_plays_on() -> None:
    """A leap in a melody, while the other hand has nothing to do, is shared between both."""
    leaps = Score(tuple(Note(i / 4, (i + 1) / 4, 50 + 26 * (i % 2)) for i in range(8)))
    found, _ = find_fingering(leaps)
    assert [number // 5 for number in numbers(found)] == [1, 0] * 4
