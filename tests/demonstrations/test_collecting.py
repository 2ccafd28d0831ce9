"""What is recorded of an episode, and which are kept."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.demonstrations.dataset import kept
from cadenza.demonstrations.recorded_episode import (
    RESULT,
    STEPS,
    played_actions,
    read_facts,
)
from cadenza.evaluation.collecting.collect import PERFORMANCES, episodes, is_complete, record
from cadenza.evaluation.collecting.variation import Variation, excerpt
from cadenza.evaluation.results import FAILED, RUNS
from cadenza.files import locked, sha256_of
from cadenza.keyboards.piano import PIANO
from cadenza.music.libraries.library import open_library
from cadenza.music.score import Note, Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.piano_task import PianoTask
from demonstrations.made import SCORE, collected, demonstrator, differences, jobs

BUT_STRIKES = 0.01  # [m, rad] of the median control, which strikes hardly change


def test_what_was_played_is_played_again_bit_for_bit(made):
    scene = build_scene()
    for episode in kept(made):
        assert differences(episode, scene) == set()


def test_randomized_episodes_are_played_again_bit_for_bit(tmp_path):
    randomization = DomainRandomization(
        mass=(0.8, 1.2), latency=(0.0, 0.02), control_noise=0.02, key_noise=0.1
    )
    collected(tmp_path / "a", Variation(), 2, randomization=randomization)
    for episode in kept(tmp_path / "a"):
        assert differences(episode, build_scene()) == set()
        other = replace(episode.facts.task.randomization, seed=1)
        facts = replace(episode.facts, task=replace(episode.facts.task, randomization=other))
        assert "hand_qpos" in differences(replace(episode, facts=facts), build_scene())


def test_the_label_is_the_correction_and_not_the_noise(made):
    """Without search, the planner answers noise by its plan with feedback, and its strikes."""
    for episode in kept(made):
        steps = episode.steps
        chosen, played = steps["action"][:-1, :-1], played_actions(steps, build_scene())[:, :-1]
        assert np.median(np.abs(chosen - steps["tracked"][:-1])) < BUT_STRIKES
        noise = episode.facts.drawn["noise"]
        assert 0 < noise < 0.2
        assert 0.1 * noise < np.abs(played - chosen).max() / 0.12 < 5 * noise


def test_all_episodes_of_a_song_go_back_to_one_performance(tmp_path):
    variation = Variation(noise=0.4, mirror=False)
    collected(tmp_path / "a", variation, 2, random_stretch=0.0, random_pitch_shift=0)
    (file,) = (tmp_path / "a" / PERFORMANCES).iterdir()
    with np.load(file) as performance:
        action = performance["action"]
    for episode in kept(tmp_path / "a"):
        off = np.abs(episode.steps["action"][:-1] - action)
        assert np.median(off) < BUT_STRIKES < off.max()


def test_a_student_plays_half_of_the_time_and_is_told_what_the_planner_would_play(tmp_path):
    variation = Variation(noise=0.0, mirror=False, student="zero")
    folders = collected(tmp_path / "a", variation, 4)
    still = []
    for episode in kept(tmp_path / "a"):
        steps = episode.steps
        chosen, played = steps["action"][:-1, :-1], played_actions(steps, build_scene())[:, :-1]
        assert np.median(np.abs(chosen - steps["tracked"][:-1])) < BUT_STRIKES
        students = np.abs(played - chosen).max(axis=1) > 1e-6  # beyond rounding
        assert (played[students] == played[students][:1]).all()
        still.extend(students)
    assert len(folders) == 4
    assert 0.1 < np.mean(still) < 0.9


def test_rewards_are_for_the_fingers_that_are_recorded(tmp_path):
    """The piece gives fingers, but the planner has found others."""
    who = demonstrator(Variation(noise=0.0, mirror=False, excerpt=1.5), random_hand_position=0.0)
    (song,) = (s for s in open_library("bundled").songs if s.name == "FurEliseOpening")
    (job,) = episodes(replace(open_library("bundled"), songs=(song,)), who, range(1), 0.0)
    record(job, tmp_path / RUNS / job.spec.name, num_threads=1)
    (episode,) = kept(tmp_path)
    assert episode.score.has_fingering
    with closing(PianoTask([episode.score], episode.facts.task)) as task:
        again = play_episode(task, Playback(played_actions(episode.steps, task.scene)), 0)
    np.testing.assert_allclose(
        again.episode["reward_total"], episode.steps["previous_reward"][1:], atol=1e-4
    )


@pytest.mark.parametrize(("transpose", "there"), [(-5, False), (0, True), (5, True)])
def test_what_is_transposed_afterwards_is_mirrored_only_where_there_are_keys(
    transpose, there, tmp_path
):
    (job,) = jobs(tmp_path / "made", Variation(), 1, transpose=transpose)
    score = Score((Note(0.0, 0.5, 100),))  # its mirror image is 24, three keys from the lowest
    variation = Variation(mirror=True)
    mirrored = {
        variation.draw(score, job.spec.pitches, np.random.default_rng(seed))[1]["mirrored"]
        for seed in range(20)
    }
    assert mirrored == ({False, True} if there else {False})


def test_episodes_differ_and_the_same_one_never_does(made, tmp_path):
    first, second = kept(made)
    assert first.score != second.score  # tempo and transposition
    assert first.facts.start != second.facts.start
    again, _ = collected(tmp_path / made.name, Variation(noise=0.2, mirror=False), 2)
    (same,) = [e for e in (first, second) if e.facts.job["seed"] == read_facts(again).job["seed"]]
    assert sha256_of(again / STEPS) == sha256_of(same.folder / STEPS)


def test_only_good_episodes_are_kept_and_finished_ones_never_made_again(tmp_path):
    noisy = Variation(noise=5.0, mirror=False)
    (folder,) = collected(tmp_path / "a", noisy, least_f1=1.0)
    assert sorted(path.name for path in folder.iterdir()) == [
        "job.json",
        "lock",
        "log.txt",
        RESULT,
    ]
    was = read_facts(folder)
    assert not was.kept
    (job,) = jobs(tmp_path / "a", noisy, 1, least_f1=1.0)
    assert is_complete(job, folder)
    assert was.note_onset_f1 < was.f1
    assert is_complete(replace(job, least_f1=was.f1), folder)
    assert not is_complete(replace(job, least_f1=was.note_onset_f1), folder)
    collected(tmp_path / "a", noisy, least_f1=was.note_onset_f1)
    assert read_facts(folder).kept
    before = (folder / RESULT).stat().st_mtime_ns
    collected(tmp_path / "a", noisy, least_f1=1.0)
    assert (folder / RESULT).stat().st_mtime_ns == before


def test_another_process_is_not_disturbed(tmp_path):
    (job,) = jobs(tmp_path / "a", Variation(), 1)
    folder = tmp_path / "a" / RUNS / job.spec.name
    with locked(folder):
        record(job, folder, num_threads=1)
    assert [path.name for path in folder.iterdir()] == ["lock"]


def test_why_there_is_no_episode(tmp_path):
    (job,) = jobs(tmp_path / "a", Variation(), 1)
    (tmp_path / "a-songs" / "song.mid").write_bytes(b"")
    record(job, tmp_path / "run", num_threads=1)
    assert "song.mid" in (tmp_path / "run" / FAILED).read_text()
    assert not is_complete(job, tmp_path / "run")


@pytest.mark.parametrize("highest", [103, 104])
def test_songs_are_mirrored_where_there_are_keys(highest):
    score = replace(SCORE, notes=(*SCORE.notes, Note(1.0, 1.2, highest)))
    rng = np.random.default_rng(0)
    drawn = [Variation(mirror=True).draw(score, PIANO.pitches, rng) for _ in range(20)]
    mirrored = sum(how["mirrored"] for _, how in drawn)
    assert 3 < mirrored < 17 if highest == 103 else not mirrored
    for played, how in drawn:
        assert played == (score.mirrored if how["mirrored"] else score)
    assert score.mirrored.mirrored == score


def test_black_keys_stay_black():
    for pitch in PIANO.pitches:
        image = 124 - pitch
        if image in PIANO.pitches:
            black = [PIANO.is_black[p - PIANO.lowest_pitch] for p in (pitch, image)]
            assert black[0] == black[1]


def test_excerpts_begin_with_a_note_and_last_as_long_as_asked():
    score = Score(tuple(Note(float(i), i + 0.5, 60 + i) for i in range(20)))
    rng = np.random.default_rng(0)
    begin = set()
    for _ in range(50):
        played, how = Variation(mirror=False, excerpt=4.0).draw(score, PIANO.pitches, rng)
        assert [note.start for note in played.notes] == list(range(4))
        assert played.notes[0].pitch == 60 + how["since"]
        begin.add(how["since"])
    assert {0.0, 15.0} <= begin <= set(map(float, range(16)))


def test_work_for_an_excerpt_is_proportional_to_the_length_of_the_song(monkeypatch):
    """The number of passes over a score's notes does not depend on how many there are."""
    looks = 0
    last = Score.total_time.fget
    assert last is not None

    def noted(score: Score) -> float:
        nonlocal looks
        looks += 1
        return last(score)

    monkeypatch.setattr(Score, "total_time", property(noted))
    names = []
    for count in (20, 400):
        looks = 0
        excerpt(Score(tuple(Note(i / 2, i / 2 + 0.5, 60) for i in range(count))), 4.0, 0.5)
        names.append(looks)
    assert names[0] == names[1] > 0
