"""Why notes were missed: performances that go wrong in one known way."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import cadenza
from cadenza.agents.planner.misses import Miss, misses_of
from cadenza.agents.planner.plan.nominal_trajectory import NominalTrajectory
from cadenza.agents.planner.plan.presses import Press, presses_of
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.episode import Episode
from cadenza.fingering.search import Dropped
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack
from numbered import FIVE, finger

STEPS, DT = 40, 0.05
C4, D4, C5 = 39, 41, 51
INDEX = 1
# A silent half second, then C4 for half a second, and C5 for another, both with the index finger.
NOTES = ((C4, 10, 20), (C5, 25, 35))
SCORE = Score(
    (Note(0.0, 0.5, 60, finger=finger(INDEX)), Note(0.75, 1.25, 72, finger=finger(INDEX)))
)
FOREARMS = {"bodies": ["rh_forearm", "lh_forearm"]}
SCENE = build_scene()


class Concert:
    """A plan that works and its performance without a mistake; tests spoil it."""

    def __init__(self) -> None:
        self.goal = np.zeros((STEPS, 88), bool)
        fingers = np.full((STEPS, 88), -1, np.int8)
        for key, first, last in NOTES:
            self.goal[first:last, key] = True
            fingers[first:last, key] = INDEX
        self.played = self.goal.copy()
        self.presses = presses_of(fingers, FIVE)
        self.planned = np.zeros((STEPS + 1, 10, 3))  # fingers 4 cm apart, at C4 and then at C5
        for state in range(STEPS + 1):
            key = C4 if state < 22 else C5
            place = PIANO.centre[key, 1] + 0.04 * (np.arange(10) - INDEX)
            place[5:] -= 0.6  # the left hand, far away
            self.planned[state, :, 1] = place
        self.tips = self.planned[1:].copy()
        self.forearms = np.tile([0.15, -0.15], (STEPS, 1))
        self.dropped: tuple[Dropped, ...] = ()
        self.dt = DT
        self.scene = SCENE
        self.events: dict[str, Any] = {}  # of keys, within steps

    def sounds(self, key: int, first: int, last: int) -> None:
        self.played[:, key] = False
        self.played[first:last, key] = True

    def misses(self) -> list[Miss]:
        xpos = np.zeros((STEPS, 2, 3))
        xpos[..., 1] = self.forearms
        arrays: dict[str, Any] = {
            "action": np.zeros((STEPS, 1)),
            "goal_keys": self.goal,
            "key_activation": self.played,
            "sustain_activation": np.zeros(STEPS, bool),
            **self.events,
            "key_qpos": np.where(self.played, PIANO.travel, 0.6 * PIANO.travel),
            "fingertip_xpos": self.tips,
            "body_xpos": xpos,
        }
        self.episode = Episode("A concert", self.dt, arrays, FOREARMS)
        nominal = NominalTrajectory(
            self.presses,
            np.zeros((STEPS + 1, 1)),
            self.planned,
            None,
            np.zeros((STEPS, 1)),  # type: ignore[arg-type]
        )
        config = TaskConfig(initial_buffer_time=0.5)
        track = GoalTrack(SCORE, self.dropped, config, self.scene)
        return misses_of(self.episode, SongPlan(self.scene, track, track.goals, nominal))

    def cut(self, last: int, then: Press | None = None) -> None:
        self.presses[0] = self.presses[0]._replace(last=last)
        self.presses[1:1] = [then] if then else []


@pytest.fixture
def concert():
    return Concert()


def test_nothing_is_missed_where_nothing_is(concert):
    assert concert.misses() == []


@pytest.mark.parametrize("agent", ["planner", "generalist"])
def test_a_performance_of_a_step_or_two_may_miss_its_note(agent):
    tiny = Score((Note(0.0, 0.03, 60),))
    performance = cadenza.play(tiny, agent, task=TaskConfig(initial_buffer_time=0.0))
    assert [miss.what for miss in performance.misses or ()] == ["never sounded"]


def test_a_step_late_and_a_step_short_are_in_time(concert):
    concert.sounds(C4, 11, 19)
    assert concert.misses() == []


def test_what_is_in_time_does_not_depend_on_the_control_step(concert):
    concert.dt = 0.025
    concert.sounds(C4, 12, 18)
    assert concert.misses() == []
    concert.sounds(C4, 13, 18)
    assert [miss.what for miss in concert.misses()] == ["75 ms late"]


@pytest.mark.parametrize(
    ("steps", "what", "sounded"),
    [
        ((0, 0), "never sounded", False),
        ((12, 20), "100 ms late", False),
        ((20, 24), "never sounded", False),
        ((10, 17), "let go 150 ms early", True),
    ],
)
def test_what_became_of_a_note(concert, steps, what, sounded):
    concert.sounds(C4, *steps)
    (miss,) = concert.misses()
    assert (miss.time, miss.note, miss.finger) == (0.5, "C4", finger(INDEX))
    assert (miss.what, miss.sounded) == (what, sounded)


def silent(concert: Concert) -> None:
    concert.sounds(C4, 0, 0)


def dropped(concert: Concert) -> None:
    silent(concert)
    del concert.presses[0]
    concert.dropped = (Dropped(SCORE.notes[0], "too far from what is held by both hands"),)


def other_hand(concert: Concert) -> None:
    silent(concert)
    del concert.presses[0]


def jump(concert: Concert) -> None:
    silent(concert)
    concert.cut(12)


def next_note(concert: Concert) -> None:
    silent(concert)
    concert.cut(12, Press("right", INDEX, D4, 13, 15))


def neighbour(concert: Concert) -> None:
    silent(concert)
    concert.sounds(D4, 11, 15)
    concert.tips[10:12, INDEX, 1] = PIANO.centre[D4, 1]


def beside(concert: Concert, steps: slice = slice(5, 25), by: float = -0.04) -> None:
    silent(concert)
    concert.tips[steps, INDEX, 1] += by


def finger_in_the_way(concert: Concert) -> None:
    beside(concert)  # the thumb is there


def other_hand_in_the_way(concert: Concert) -> None:
    beside(concert, by=0.015)
    concert.tips[10, 7] = concert.tips[10, INDEX] + (0, 0.01, 0.01)


def forearms(concert: Concert) -> None:
    beside(concert, by=0.015)
    concert.forearms[10] = (0.07, -0.07)


def planned_beside(concert: Concert) -> None:
    beside(concert, by=0.02)
    concert.planned[1:] = concert.tips


def late(concert: Concert) -> None:
    beside(concert, slice(5, 12), by=0.0165)


def fast(concert: Concert) -> None:
    concert.planned[5:10, :, 1] -= 0.1
    beside(concert, by=0.0165)


def elsewhere(concert: Concert) -> None:
    beside(concert, by=0.0165)


REASONS: dict[Callable[[Concert], None], tuple[str, str]] = {
    dropped: ("no finger", "no finger for it: too far from what is held by both hands"),
    other_hand: ("no finger", "no finger for it: its hand does not play"),
    jump: ("finger needed elsewhere", "too early to sound, as planned: the hand had to jump"),
    next_note: ("finger needed elsewhere", "as planned: its finger had to press D4"),
    neighbour: ("neighbouring key struck", "the finger pressed D4 instead"),
    finger_in_the_way: ("collided", "the finger beside it"),
    other_hand_in_the_way: ("collided", "a finger of the other hand"),
    forearms: ("collided", "the other forearm"),
    planned_beside: ("out of reach", "the plan has it 9 mm away"),
    late: ("too fast to get there", "the finger was 5 mm away"),
    fast: ("too fast to get there", "planned at 1.0 m/s"),
    elsewhere: ("finger beside the key", "the finger was 5 mm away"),
    silent: ("key not pressed far enough", "60 % of its way"),
}


@pytest.mark.parametrize("spoil", REASONS, ids=lambda spoil: spoil.__name__)
def test_why_a_note_did_not_sound(spoil, concert):
    spoil(concert)
    (miss,) = concert.misses()
    cause, words = REASONS[spoil]
    assert (miss.note, miss.what, miss.cause) == ("C4", "never sounded", cause)
    assert words in miss.reason


@pytest.mark.parametrize("spoil", [other_hand_in_the_way, forearms])
def test_hands_at_pianos_of_their_own_are_not_in_each_others_way(spoil, concert):
    concert.scene = build_scene(SceneConfig(hands="apart"))
    spoil(concert)
    assert [miss.cause for miss in concert.misses()] == ["finger beside the key"]


def test_a_key_that_has_sounded_for_long_was_not_struck_instead(concert):
    neighbour(concert)
    concert.sounds(D4, 0, 15)
    assert [miss.cause for miss in concert.misses()] != ["neighbouring key struck"]


def test_a_key_that_does_not_come_up_between_notes(concert):
    concert.goal[15] = False
    concert.presses[:1] = [Press("right", INDEX, C4, 11, 16), Press("right", INDEX, C4, 17, 21)]
    (miss,) = concert.misses()
    assert (miss.time, miss.what, miss.cause) == (0.8, "not struck again", "key not released")


@pytest.mark.parametrize(("silence", "num_misses"), [(0.019, 1), (0.021, 0)])
def test_a_key_that_comes_up_too_shortly_is_not_struck_again(concert, silence, num_misses):
    concert.goal[15, C4] = concert.played[15, C4] = False
    concert.presses[:1] = [Press("right", INDEX, C4, 11, 16), Press("right", INDEX, C4, 17, 21)]
    onset, offset, velocity = np.full((3, STEPS, 88), np.nan)
    onset[[10, 25], [C4, C5]], offset[[20, 35], [C4, C5]] = 0.01, 0.01
    offset[15, C4], onset[16, C4] = 0.05 + 0.01 - silence, 0.01
    velocity[~np.isnan(onset)] = 80
    concert.events = {"key_onset": onset, "key_offset": offset, "key_velocity": velocity}
    misses = [(miss.time, miss.what, miss.cause) for miss in concert.misses()]
    assert misses == [(0.8, "not struck again", "key not released")] * num_misses


@pytest.mark.parametrize(
    ("planned", "by", "cause"),
    [
        (16, 0.0, "finger needed elsewhere"),
        (21, 0.03, "finger beside the key"),
        (21, 0.0, "key not held down"),
    ],
)
def test_why_a_note_was_let_go_early(planned, by, cause, concert):
    concert.sounds(C4, 10, 15)
    concert.cut(planned)
    concert.tips[15:, INDEX, 1] += by
    (miss,) = concert.misses()
    assert (miss.what, miss.cause) == ("let go 250 ms early", cause)


def test_with_one_hand_only(concert):
    silent(concert)
    concert.planned = concert.planned[:, :5]
    concert.tips[:, 5:] = 0.0
    concert.scene = build_scene(SceneConfig(hands="right"))
    (miss,) = concert.misses()
    assert miss.cause == "key not pressed far enough"
