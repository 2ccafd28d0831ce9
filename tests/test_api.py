"""What `import cadenza` offers."""

import gc
import json
import subprocess
import sys
import threading
import tracemalloc
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import cadenza
from cadenza import DomainRandomization, Note, SceneConfig, Score, TaskConfig, TrainingConfig
from cadenza.agents.planner.plan.nominal_trajectory import NominalTrajectory
from cadenza.agents.registry import make_agent
from cadenza.cli import main
from cadenza.episode import load_episode
from cadenza.music.formats.fingering_file import read_fingering
from cadenza.music.formats.midi import read_midi, write_midi
from cadenza.music.performance import played_in
from cadenza.performing.performance import perform
from cadenza.performing.setup import find_player, set_up
from cadenza.sim.mujoco_simulation import MujocoSimulation

ROOT = Path(__file__).parents[1]
TUNE = Score((Note(0.0, 0.25, 60), Note(0.25, 0.5, 64), Note(0.25, 0.6, 67)), title="A tune")


class Still(cadenza.Agent):
    """An agent that does nothing."""

    def act(self, view: cadenza.View) -> np.ndarray:
        return np.zeros((len(view.env_ids), view.task.action_size))


class OneFinger(Still):
    def act(self, view: cadenza.View) -> np.ndarray:
        return super().act(view)[:, :1]


def test_importing_is_quick_and_all_names_are_there():
    heavy = ("mujoco", "scipy", "mir_eval", "av", "mido", "jax", "cadenza.performing")
    code = f"""import sys, cadenza
print([m for m in {heavy} if m in sys.modules], set(cadenza.__all__) - set(dir(cadenza)))
for name in cadenza.__all__:
    getattr(cadenza, name)
print(callable(cadenza.play) and callable(cadenza.plan) and "jax" not in sys.modules)"""
    output = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert output == "[] set()\nTrue\n"
    with pytest.raises(AttributeError, match="no attribute 'dance'"):
        cadenza.dance  # noqa: B018


def test_playing_leaves_what_the_command_line_leaves(tmp_path):
    write_midi(TUNE, tmp_path / "tune.mid")
    song, ours, theirs = tmp_path / "tune.mid", tmp_path / "ours", tmp_path / "theirs"
    performance = cadenza.play(song, "random", seed=3)
    performance.save(ours)
    main(["play", str(song), "--agent", "random", "--seed", "3", "--no-video", "-o", str(theirs)])
    assert {path.name for path in ours.iterdir()} == {path.name for path in theirs.iterdir()}
    for name in ("settings.json", "played.mid"):
        assert (ours / name).read_bytes() == (theirs / name).read_bytes(), name
    metrics = [json.loads((folder / "metrics.json").read_text()) for folder in (ours, theirs)]
    assert metrics[0]["return"] == metrics[1]["return"] == performance.metrics["return"]
    pitches = [note.pitch for note in performance.played.notes]
    assert [note.pitch for note in read_midi(ours / "played.mid").notes] == pitches


@pytest.mark.slow
def test_half_an_hour_needs_less_than_a_gigabyte(tmp_path, monkeypatch):
    """A started Python takes 250 MB with all that is imported; this is what grows with the song."""
    monkeypatch.setattr("cadenza.report.sound.IN_MEMORY", 1 << 20)
    monkeypatch.setattr(MujocoSimulation, "step", lambda *_: None)  # only for speed

    def peak(minutes: int) -> int:
        notes = tuple(Note(second, second + 0.4, 60) for second in range(60 * minutes))
        tracemalloc.start()
        cadenza.play(Score(notes), "zero").save(tmp_path)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(1)  # what is imported when it is first used
    one, two = peak(1), peak(2)
    assert 30 * (two - one) < 500e6


def test_notes_are_kept_as_they_were_struck(tmp_path):
    notes = (Note(0.0, 0.25, 60, 33), Note(0.25, 0.5, 64, 77), Note(0.25, 0.6, 67, 111))
    performance = cadenza.play(Score(notes))
    performance.save(tmp_path)
    kept, struck = read_midi(tmp_path / "played.mid").notes, performance.played.notes
    assert [note.velocity for note in kept] == [note.velocity for note in struck]
    assert [note.start for note in kept] == pytest.approx([n.start for n in struck], abs=1e-3)
    again = load_episode(tmp_path / "episode.npz")
    assert played_in(again) == performance.played


def test_what_was_played_has_the_title_and_the_bars_of_the_song(tmp_path):
    performance = cadenza.play("FurEliseOpening", "random")
    performance.save(tmp_path, page=False)
    played, expected = (read_midi(tmp_path / f"{name}.mid") for name in ("played", "wanted"))
    assert played.title == expected.title == performance.goal.title
    begins = {round(bar.time, 3) for bar in performance.goal.bars}
    for read in played, expected:
        assert {round(bar.time, 3) for bar in read.bars} >= begins
    assert len(played.notes) == len(performance.played.notes)


def test_configurations_are_taken_as_they_are():
    scene = SceneConfig(hands="left")
    performance = cadenza.play(TUNE, "zero", task=TaskConfig(stretch=2), scene=scene)
    assert performance.seconds == pytest.approx(0.65 + 0.6 + 0.5)  # half as fast
    assert performance.settings["scene"]["hands"] == "left"
    assert performance.score == TUNE
    assert cadenza.play(TUNE, "zero").seconds == pytest.approx(0.65 + 0.5)


def test_an_agent_of_ones_own_plays():
    performance = cadenza.play(TUNE, Still())
    assert performance.settings["agent"] == "Still"
    assert performance.misses is None
    np.testing.assert_array_equal(
        performance.episode["key_qpos"], cadenza.play(TUNE, "zero").episode["key_qpos"]
    )
    with pytest.raises(cadenza.CadenzaError, match=r"shape \(1, 1\), but the task .* \(1, 39\)"):
        cadenza.play(TUNE, OneFinger())


def test_no_agent_takes_more_than_two_cores_unasked(monkeypatch):
    monkeypatch.setattr("cadenza.sim.threads.available_cores", lambda: 16)
    for num_threads, used in ((None, 2), (3, 3)):
        with threadpool_limits(16), set_up(TUNE, find_player(), num_threads=num_threads) as setup:
            assert setup.agent.threads == used
            assert max(pool["num_threads"] for pool in threadpool_info()) <= used


def test_the_part_that_was_played_is_a_performance(tmp_path):
    steps_left = iter(range(12))
    with set_up(TUNE, find_player()) as setup:
        performance = perform(setup, stop=lambda: next(steps_left, None) is None)
    assert (performance.episode.num_steps, setup.num_steps) == (13, 23)
    assert performance.metrics["steps"] == 13
    assert len(performance.misses) <= 1
    performance.save(tmp_path)
    assert (tmp_path / "report.html").exists()


def test_a_planner_uses_as_many_threads_as_it_is_told_and_plays_the_same():
    quick = Score(tuple(Note(0.2 * i, 0.2 * i + 0.2, p) for i, p in enumerate((60, 72, 61, 70))))
    actions, threads = [], []
    for number in (1, 2):
        before, seen = threading.active_count(), []
        performance = cadenza.play(
            quick,
            progress=lambda *_, seen=seen: seen.append(threading.active_count()),
            num_threads=number,
        )
        actions.append(performance.episode["action"])
        threads.append(max(seen) - before)
    np.testing.assert_array_equal(*actions)
    assert threads == [0, 2]
    with pytest.raises(cadenza.CadenzaError, match="num_threads 0: choose 1 to"):
        cadenza.play(TUNE, num_threads=0)


def test_a_plan_plays_as_it_was_planned(tmp_path):
    plan = cadenza.plan(TUNE)
    assert plan.actions.shape == (23, 39)
    assert plan.performance.settings["agent"] == "planner"
    assert None not in plan.fingering
    plan.save(tmp_path / "tune.safetensors")
    fingered = read_fingering(tmp_path / "tune.safetensors.fingering", TUNE)
    assert tuple(note.finger for note in fingered.notes) == plan.fingering
    again = cadenza.play(TUNE, "playback", plan=tmp_path / "tune.safetensors")
    assert again.metrics["f1"] == plan.metrics["f1"] > 0.9
    assert again.metrics["return"] == plan.metrics["return"]


def test_a_performance_does_not_keep_the_postures_that_were_planned():
    def postures() -> int:
        gc.collect()
        return sum(isinstance(each, NominalTrajectory) for each in gc.get_objects())

    before = postures()
    performance = cadenza.play(TUNE, make_agent("planner", cadenza.PlannerConfig(method="none")))
    assert performance.track is not None
    assert postures() == before


def test_loading_songs(tmp_path):
    (joy,) = (song for song in cadenza.songs() if song.name == "OdeToJoy")
    assert cadenza.load_song("odetojoy") == cadenza.load_song(joy)
    assert cadenza.play(joy, "zero").score == cadenza.load_song(joy)
    assert gymnasium.make("cadenza/Piano-v0", song=joy).unwrapped.task.scores[0].title == joy.title
    (tmp_path / "broken.mid").write_bytes(b"MThd")
    with pytest.raises(cadenza.CadenzaError, match=r"broken\.mid"):
        cadenza.load_song(tmp_path / "broken.mid")


def test_what_is_repaired_in_a_song_is_a_warning(tmp_path):
    write_midi(Score((Note(0, 1, 60), Note(0, 1, 60))), tmp_path / "twice.mid")
    with pytest.warns(cadenza.CadenzaWarning, match=r"twice\.mid: "):
        assert cadenza.load_song(tmp_path / "twice.mid").remarks


def test_agents_that_belong_to_a_song():
    for name in ("pretrained", "playback"):
        with pytest.raises(cadenza.CadenzaError, match=r"depends on the song: .* cadenza\.play"):
            cadenza.make_agent(name)


def test_the_environments_of_the_documentation_run(capsys):
    blocks = (ROOT / "docs" / "python.md").read_text("utf-8").split("```python")
    (code,) = (block.split("```")[0] for block in blocks if "make_vec" in block)
    exec(compile(code, "python.md", "exec"), names := {})
    assert capsys.readouterr().out.startswith("['Ode to Joy' 'Frère Jacques' ")
    np.testing.assert_allclose(
        names["spec"].scale_action(names["actions"]), names["ctrl"], atol=1e-12
    )


@pytest.mark.slow
def test_what_the_documentation_shows_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = (ROOT / "docs" / "python.md").read_text().split("```")[1].removeprefix("python")
    exec(compile(code, "python.md", "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert {path.name for path in tmp_path.iterdir()} == {
        "joy",
        "scale.safetensors",
        "scale.safetensors.fingering",
    }


def test_a_score_that_is_called_like_a_folder_is_played_as_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / TUNE.title).mkdir()
    (tmp_path / TUNE.title / "plan.safetensors").write_bytes(b"of another song")
    with set_up(TUNE, find_player()) as setup:
        assert (setup.settings["agent"], setup.score) == ("planner", TUNE)


def test_what_a_prompt_shows_is_a_short_line():
    plan = cadenza.plan(TUNE)
    performance = plan.performance
    env = cadenza.PianoEnv(TUNE)
    env.reset(seed=0)
    view = env.task.view()
    library = cadenza.open_library("bundled")
    parts = (performance.score, performance.episode, performance.track, performance.scene)
    for value in (plan, performance, *parts, view, view.task, library):
        assert repr(value).startswith(f"{type(value).__name__}(")
        assert len(repr(value)) <= 160
        assert "\n" not in repr(value)
    assert plan._repr_html_() == performance._repr_html_()


def test_options_show_what_is_not_the_default():
    for kind in (TaskConfig, SceneConfig, TrainingConfig, DomainRandomization):
        assert repr(kind()) == f"{kind.__name__}()"
    task = TaskConfig(stretch=2.0, randomization=DomainRandomization(mass=(0.9, 1.1)))
    changed = "randomization=DomainRandomization(mass=(0.9, 1.1))"
    assert repr(task) == f"TaskConfig(stretch=2.0, {changed})"


def test_songs_show_as_short_lines():
    for song in (*cadenza.songs(), *cadenza.open_library("bundled").songs):
        assert len(repr(song)) < 250


def test_only_what_is_offered_is_listed():
    assert sorted(name for name in dir(cadenza) if not name.startswith("_")) == cadenza.__all__
