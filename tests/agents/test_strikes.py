"""Strikes in time and as loud as written, against the physics of the keys."""

from dataclasses import replace

import numpy as np
import pytest

import cadenza
from cadenza.agents.planner.plan.strike_model import StrikeModel, planned_strikes
from cadenza.agents.planner.planner import Planner
from cadenza.agents.planner.search.strikes import strike_costs
from cadenza.agents.rollout import play_episode
from cadenza.episode import Episode
from cadenza.keyboards.piano import PIANO
from cadenza.music.goals import score_to_goals
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

DT = 0.05
SILENCE = 0.5  # [s] before the song


def scale(starts: list[float], velocities: list[int]) -> Score:
    """The white keys from middle C on, one after the other."""
    pitches = [60, 62, 64, 65, 67, 65, 64, 62, 60, 62, 64, 65, 67, 65, 64, 62]
    return Score(
        tuple(
            Note(start, start + 0.15, pitch, velocity)
            for start, pitch, velocity in zip(starts, pitches, velocities, strict=False)
        )
    )


def played(score: Score) -> Episode:
    """What the planner plays, with repeated notes in time."""
    task = PianoTask([score], TaskConfig(initial_buffer_time=SILENCE, repeats="shortened"))
    return play_episode(task, Planner()).episode


def onsets_and_speeds(episode: Episode, score: Score) -> tuple[np.ndarray, np.ndarray]:
    """(N,) each of the notes of `score`: seconds late, and MIDI velocity, of the nearest onset."""
    late, velocity = [], []
    for note in score.notes:
        key = note.pitch - PIANO.lowest_pitch
        steps = np.flatnonzero(np.isfinite(episode["key_onset"][:, key]))
        times = steps * DT + episode["key_onset"][steps, key] - SILENCE - note.start
        nearest = np.abs(times).argmin()
        late.append(times[nearest])
        velocity.append(episode["key_velocity"][steps[nearest], key])
    return np.array(late), np.array(velocity)


def test_a_fingertip_of_the_model_passes_the_depth_in_time_and_as_fast():
    model = StrikeModel(time_constant=0.05, dt=DT)
    time, speed, depth = np.array([0.01, 0.03, 0.045]), np.array([0.1, 0.3, 0.2]), np.full(3, 0.006)
    before, after = model.heights(time, speed, depth)

    def height(t: np.ndarray) -> np.ndarray:
        reached = (1 - np.exp(-t / 0.05)) / (1 - np.exp(-DT / 0.05))
        return before + (after - before) * reached

    np.testing.assert_allclose(height(time), -depth)
    np.testing.assert_allclose((height(time - 1e-6) - height(time + 1e-6)) / 2e-6, speed, rtol=1e-5)


def test_the_response_of_the_model_is_its_derivative():
    model = StrikeModel(time_constant=0.05, dt=DT)
    time, speed, depth = np.array([0.02]), np.array([0.2]), np.array([0.006])
    lower = np.stack(model.heights(time, speed, depth), axis=1)[0]
    slightly = 1e-6
    for changed in np.eye(2):
        later = time + slightly * changed[0]
        faster = speed * 2.0 ** (slightly * changed[1])
        moved = lower - np.stack(model.heights(later, faster, depth), axis=1)[0]
        response = model.response(time, speed, depth)[0] @ moved
        np.testing.assert_allclose(response, slightly * changed, atol=1e-9)


def test_strikes_are_within_their_steps():
    score = scale([0.0, 0.249, 0.5251], [30, 80, 127])
    strikes = planned_strikes(score_to_goals(score, DT).onsets, build_scene(SceneConfig()), DT)
    assert strikes.step.tolist() == [0, 4, 10]
    assert ((strikes.time > 0) & (strikes.time < DT)).all()
    assert abs(strikes.time[2] - 0.0251) < 0.01
    np.testing.assert_allclose(PIANO.velocity(strikes.speed), [30, 80, 127])


def test_fingers_that_are_too_slow_do_not_strike():
    onsets = score_to_goals(scale([0.0], [80]), DT).onsets
    assert not len(planned_strikes(onsets, build_scene(SceneConfig(hand="allegro")), DT).step)


def test_repeated_notes_are_each_heard():
    """Eighths in octaves and thirds, with less than 0.1 s in which their keys can come up."""
    notes = tuple(
        Note(start, start + 0.18, pitch)
        for start in np.arange(0, 3, 0.25).tolist()
        for pitch in (36, 48, 60, 64)
    )
    assert cadenza.play(Score(notes)).metrics["note_onset_f1"] > 0.97


@pytest.fixture(scope="module")
def sixteenths():
    """Even notes of 125 ms, which do not lie on control steps, in a crescendo."""
    starts, velocities = (0.125 * np.arange(16)).tolist(), np.linspace(40, 95, 16).astype(int)
    score = scale(starts, velocities.tolist())
    return score, played(score)


def test_even_notes_that_lie_between_control_steps_are_played_evenly(sixteenths):
    late, _ = onsets_and_speeds(sixteenths[1], sixteenths[0])
    assert np.median(np.abs(np.diff(late))) < 0.01  # on the grid of control steps: 0.025
    assert np.median(np.abs(late - np.median(late))) < 0.008


def test_a_crescendo_becomes_louder(sixteenths):
    score, episode = sixteenths
    _, velocity = onsets_and_speeds(episode, score)
    written = np.array([note.velocity for note in score.notes])
    assert np.corrcoef(velocity, written)[0, 1] > 0.8
    assert np.median(np.abs(velocity - written)) < 8


def test_a_soft_note_is_softer_than_a_loud_one():
    score = scale([0.5], [40])
    loud = replace(score, notes=tuple(replace(note, velocity=100) for note in score.notes))
    soft_velocity, loud_velocity = (
        onsets_and_speeds(played(each), each)[1][0] for each in (score, loud)
    )
    assert soft_velocity + 30 < loud_velocity


def test_repeated_notes_without_gaps_are_in_time_and_as_loud_as_written():
    velocities = [60, 80, 50, 70, 90, 65, 75, 55]
    starts = 0.33 * np.arange(len(velocities))
    notes = tuple(
        Note(start, start + 0.33, 60, velocity)
        for start, velocity in zip(starts.tolist(), velocities, strict=True)
    )
    score = Score(notes)
    late, velocity = onsets_and_speeds(played(score), score)
    assert np.max(np.abs(late - np.median(late))) < 0.012
    assert np.mean(np.abs(velocity - velocities)) < 8


def test_a_strike_costs_more_the_further_it_is_off():
    errors = np.array([0.0, 0.005, 0.01, 0.02, 0.03, 0.045, np.nan])
    outcome = np.column_stack([errors, np.zeros(len(errors))])
    costs = strike_costs(outcome, np.zeros_like(outcome))
    assert costs[0] == 0.0
    assert (np.diff(costs) > 0).all()
