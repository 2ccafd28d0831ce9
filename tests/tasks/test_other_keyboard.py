"""A task at a keyboard with fewer keys than a piano."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import cadenza
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner
from cadenza.errors import CadenzaError
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import Note, Score, note_name
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.env import PianoEnv
from cadenza.tasks.piano_task import PianoTask
from report_pages import recording_in

TWO_OCTAVES = replace(PIANO, name="two_octaves", lowest_pitch=48, num_keys=25)
UNREFINED = PlannerConfig(method="none")
KEYBOARD = f"{__name__}:TWO_OCTAVES"
SONG = Score((Note(0.0, 0.1, 48), Note(0.1, 0.3, 72), Note(0.1, 0.3, 60)), title="three notes")


def test_it_plays_itself_from_the_first_key_to_the_last():
    env = PianoEnv(SONG, setup="paper", hands="none", keyboard=KEYBOARD, control_timestep=0.1)
    observation, _ = env.reset(seed=0)
    layout = env.observation_layout
    assert observation[layout["goal"]].shape == (11 * 26,)
    truncated = False
    while not truncated:
        goal = observation[layout["goal"]][:26]
        observation, reward, _, truncated, info = env.step(2 * goal - 1)
        assert_array_equal(observation[layout["key_state"]] > 0.9, goal[:25])
        assert reward == pytest.approx(1.0 if goal.any() else 0.5, abs=0.01)
    assert info["metrics/f1"] == info["metrics/note_onset_offset_f1"] == 1.0


@pytest.mark.parametrize("agent", ["zero", "planner"])
def test_a_performance_on_it_is_saved_with_its_page(agent, tmp_path):
    tune = Score(tuple(Note(0.2 * i, 0.2 * i + 0.2, p) for i, p in enumerate((60, 61, 62))))
    scene = SceneConfig(hands="right", keyboard=KEYBOARD)
    performance = cadenza.play(tune, agent, scene=scene)
    performance.save(tmp_path)
    recording = recording_in((tmp_path / "report.html").read_text())
    assert (recording["keys"], recording["lowest"]) == (25, 48)
    episode = cadenza.load_episode(tmp_path / "episode.npz")
    assert (episode.lowest_pitch, episode["key_activation"].shape[1]) == (48, 25)
    if agent == "planner":
        assert performance.metrics["f1"] > 0.9
        sounded = {note.pitch for note in performance.played.notes}
        assert sounded >= {60, 61, 62}
    else:
        assert performance.played.notes == ()


def test_misses_are_named_by_the_keys_that_it_has():
    keys = tuple(Note(0.0, 0.4, pitch) for pitch in range(60, 71))  # too many for a hand
    performance = cadenza.play(
        Score(keys), Planner(UNREFINED), scene=SceneConfig(hands="right", keyboard=KEYBOARD)
    )
    assert performance.track is not None
    dropped = [note.pitch for note, _ in performance.track.dropped or ()]
    unplayed = {miss.note for miss in performance.misses or () if miss.cause == "no finger"}
    assert unplayed <= {note_name(pitch) for pitch in dropped}
    assert len(unplayed) >= 5


def saved(path: Path, keys: int, **more: np.ndarray) -> Path:
    arrays = {"action": np.zeros((3, 1)), "key_qpos": np.zeros((3, keys))}
    cadenza.Episode("silence", 0.05, arrays | more, {}).save(path)
    return path


def test_recordings_that_do_not_say_are_of_pianos(tmp_path):
    assert cadenza.load_episode(saved(tmp_path / "old.npz", 88)).lowest_pitch == 21


def test_recordings_of_impossible_keyboards_are_refused(tmp_path):
    high = saved(tmp_path / "high.npz", 25, lowest_pitch=np.array(120))
    with pytest.raises(CadenzaError, match="25 keys from pitch 120 on"):
        cadenza.load_episode(high)
    other = saved(tmp_path / "other.npz", 25, key_activation=np.zeros((3, 88), bool))
    with pytest.raises(CadenzaError, match="key_activation is bool of shape"):
        cadenza.load_episode(other)


def test_shifted_songs_stay_on_it():
    config = TaskConfig(random_pitch_shift=40, random_octave_shift=3)
    melody = Score((Note(0.0, 0.1, 55), Note(0.1, 0.2, 65)))
    task = PianoTask([melody], config, SceneConfig(hands="none", keyboard=KEYBOARD), 40)
    task.reset(np.random.default_rng(0).spawn(40), range(40))
    lowest = {min(note.pitch for note in song.notes) for song in task.goals.scores}
    assert min(lowest) == 48
    assert max(lowest) == 62


@pytest.mark.parametrize(("transpose", "wrong"), [(0, 2), (-24, 3)])
def test_notes_that_it_does_not_have_are_refused(transpose, wrong):
    song = Score((*SONG.notes, Note(0.2, 0.3, 74), Note(0.3, 0.4, 47)), title="five notes")
    with pytest.raises(CadenzaError, match=rf"five notes: {wrong} of 5 notes .* 48 to 72"):
        PianoEnv(song, keyboard=KEYBOARD, transpose=transpose)
