"""Playing by plans that are corrected as they are played."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

import cadenza
from begun import begun
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.agents.rollout import EpisodeResult, play_episode, play_episodes
from cadenza.errors import CadenzaError
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.tasks.piano_task import PianoTask
from melodies import BUFFER, COARSER, FINER, melody
from numbered import finger
from watched import watched


def perform(
    score: Score, config: PlannerConfig | None = None, seed: int = 0, hands: str = "both"
) -> EpisodeResult:
    task = PianoTask([score], BUFFER, SceneConfig(hands=hands))  # type: ignore[arg-type]
    return play_episode(task, Planner(config), seed)


# What is heard


def test_twinkle_is_played():
    """The published policy, trained for a day, reaches .994; the paper's planner .13."""
    assert perform(load_score("TwinkleTwinkleLittleStar")).metrics["f1"] > 0.97


@pytest.mark.parametrize("dt", [FINER, COARSER])
def test_other_control_steps_play_as_well(dt):
    task = PianoTask(
        [melody(60, 64)], replace(BUFFER, control_timestep=dt), SceneConfig(hands="right")
    )
    assert play_episode(task, Planner()).metrics["f1"] > 0.97


@pytest.mark.slow
@pytest.mark.parametrize("dt", [FINER, COARSER])
def test_twinkle_is_played_at_other_control_steps(dt):
    task = PianoTask([load_score("TwinkleTwinkleLittleStar")], replace(BUFFER, control_timestep=dt))
    assert play_episode(task, Planner()).metrics["f1"] > 0.97


def test_a_plan_that_is_not_refined_plays_a_melody():
    assert perform(melody(60, 62, 64, 65, 67), PlannerConfig(method="none")).metrics["f1"] > 0.85


@pytest.mark.parametrize("hands", ["left", "right"])
def test_one_hand_plays_alone(hands):
    assert perform(melody(55, 57, 59, 60), hands=hands).metrics["f1"] > 0.9


def test_black_keys_and_chords_with_the_full_hand():
    chord = Score(tuple(Note(0.0, 1.0, p) for p in (48, 54, 66, 70, 73)))
    task = PianoTask([chord], BUFFER, SceneConfig(reduced_action_space=False))
    assert play_episode(task, Planner()).metrics["recall"] > 0.7


def test_same_bits_for_any_number_of_threads_and_of_environments(right_hand):
    score = Score((Note(0.0, 0.15, 60), Note(0.15, 0.35, 84)))  # too far, so that it samples
    agent = Planner()
    agent.num_threads = 1
    alone = [play_episode(PianoTask([score], BUFFER, right_hand), agent, seed) for seed in (3, 4)]
    agent.num_threads = 2
    task = PianoTask([score], BUFFER, right_hand, num_envs=2)
    together = play_episodes(task, agent, [3, 4])
    for ours, theirs in zip(together, alone, strict=True):
        np.testing.assert_array_equal(ours.episode["action"], theirs.episode["action"])
        assert_same_metrics(ours, theirs)
    assert (alone[0].episode["action"] != alone[1].episode["action"]).any()


def assert_same_metrics(a: EpisodeResult, b: EpisodeResult) -> None:
    for name in a.metrics.keys() - {"planning_seconds", "playing_seconds"}:
        assert a.metrics[name] == b.metrics[name], name


def test_episodes_of_several_songs_end_when_their_songs_do():
    short, long = melody(72), melody(72, 76, 74)
    task = PianoTask([short, long], BUFFER, SceneConfig(hands="right"), num_envs=3)
    results = play_episodes(task, Planner(PlannerConfig(method="none")), [0, 1, 2])
    steps = {result.metrics["steps"] for result in results}
    assert steps == {19, 35}
    for result in results:
        assert result.episode.num_steps == len(result.episode["goal_keys"])
        assert result.metrics["f1"] > 0.85


def test_a_hand_alone_moves_as_it_does_beside_the_other(monkeypatch):
    """The simulations that it plans with are never put right while nothing is disturbed."""
    placed = watched(monkeypatch, PlanningSimulation, "set_joints")
    perform(melody(60, 64, 67, 72))
    assert len(placed) <= 1


def test_notes_without_a_finger_are_listed():
    cluster = Score(tuple(Note(0.0, 0.5, p) for p in range(40, 60)))
    agent = Planner()
    task = begun(PianoTask([cluster], BUFFER), agent)
    agent.act(task.view())
    track = agent.planners[0].plan.track
    assert track is task.goals.tracks[0]
    assert len(track.dropped or ()) == sum(note.finger is None for note in track.score.notes) > 9


def test_fingers_of_the_score_are_taken_on_request():
    score = replace(
        melody(60, 62),
        notes=(Note(0, 0.4, 60, finger=finger(2)), Note(0.4, 0.8, 62, finger=finger(1))),
    )
    agent = Planner(PlannerConfig(fingering="score"))
    agent.act(begun(PianoTask([score], BUFFER), agent).view())
    assert [press.finger for press in agent.planners[0].plan.nominal.presses] == [2, 1]


def test_a_piano_without_hands_is_refused():
    task = PianoTask([melody(60)], BUFFER, SceneConfig(hands="none"))
    with pytest.raises(CadenzaError, match="hands"):
        play_episode(task, Planner())


def test_planning_reports_its_progress():
    reported: list[tuple[str, int, int]] = []
    cadenza.play(
        melody(60, 62, 64),
        scene=SceneConfig(hands="right"),
        progress=lambda *stage: reported.append(stage),
    )
    assert [stage for stage, _ in groupby(reported, lambda step: step[0])] == [
        "fingers",
        "postures",
        "playing",
    ]
    assert [(done, of) for stage, done, of in reported if stage == "fingers"] == [
        (1, 3),
        (2, 3),
        (3, 3),
    ]
    assert all(0 <= done <= total for _, done, total in reported)


def test_planning_can_be_interrupted():
    def interrupt(stage: str, *_: int) -> None:
        if stage == "postures":
            raise KeyboardInterrupt

    task = PianoTask([melody(60, 62, 64)], BUFFER, SceneConfig(hands="right"))
    with pytest.raises(KeyboardInterrupt):
        play_episode(task, Planner(), progress=interrupt)
    assert task.goals.steps_done[0] == 0


def test_a_thumb_strikes_in_time_without_a_search():
    notes = [
        replace(note, finger=finger(0))
        for note in melody(60, 62, 64, 65, 64, 62, 60, length=0.5).notes
    ]
    score = Score(tuple(replace(note, end=note.end - 0.2) for note in notes))
    config = PlannerConfig(method="none", fingering="score")
    episode = perform(score, config, hands="right").episode
    first = np.flatnonzero(np.diff(episode["goal_keys"].any(axis=1).astype(int)) == 1) + 1
    sounding = episode["key_activation"][first] & episode["goal_keys"][first].astype(bool)
    assert sounding.any(axis=1).sum() >= 6
