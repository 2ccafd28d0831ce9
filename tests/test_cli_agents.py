"""Who plays what in which task, on the command line."""

import base64
import json
import os
import shutil
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cadenza.cli import main
from cadenza.episode import load_episode
from cadenza.learning.policy_folder import save_policy
from cadenza.learning.pretrained import pretrained_folder
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.performing import performance
from cadenza.report.sound import encode_opus
from learnt import from_nothing
from refusals import refused_in_a_line as refused

TUNE = Score((Note(0.0, 0.25, 60), Note(0.25, 0.5, 64), Note(0.25, 0.6, 67)))
OTHER = Score((Note(0.0, 0.3, 62), Note(0.3, 0.6, 65)))
# Presses Ctrl-C, or twice, when it begins or in the third step.
OWN_AGENTS = """
import os, signal
import cadenza
import numpy as np

class Still(cadenza.Agent):
    _step = 0
    def act(self, view):
        self._step += 1
        self.at_step()
        return np.zeros((1, view.task.action_size))
    def at_step(self):
        pass

class Impatient(Still):
    times = 1
    def at_step(self):
        for _ in range(self.times * (self._step == 3)):
            os.kill(os.getpid(), signal.SIGINT)

class MoreImpatient(Impatient):
    times = 2

class NeverBegins(Still):
    def reset(self, env_ids, rngs):
        os.kill(os.getpid(), signal.SIGINT)

class OnlyResets:
    def reset(self, env_ids, rngs):
        pass

not_a_class = 3
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The working folder, with songs and agents."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    write_midi(TUNE, tmp_path / "tune.mid")
    (tmp_path / "own.py").write_text(OWN_AGENTS)
    yield tmp_path
    sys.modules.pop("own", None)


def policy(folder: Path, **options: dict[str, object]) -> Path:
    """One that plays anything at once, and badly: it has learnt another song, and other notes."""
    learnt = from_nothing(replace(TUNE, title="A tune"), **options)
    save_policy(folder, learnt, {})
    return folder


def settings(folder: Path) -> dict:
    return json.loads((folder / "settings.json").read_text())


# Policies


def test_a_policy_plays_the_song_that_it_has_learnt(here, capsys):
    policy(here / "run" / "best")
    main(["play", "--agent", "run/best", "--no-video"])
    assert settings(here / "played" / "A tune" / "run-best")["agent"] == "run/best"
    main(["play", "--agent", "run", "--no-video"])  # a run's folder stands for its best policy
    assert settings(here / "played" / "A tune" / "run")["song"] == "A tune"
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("here")
def test_who_has_learnt_no_song_wants_one(capsys):
    assert refused(capsys, "play") == "cadenza: no song to play: give one; planner has learnt none"
    line = refused(capsys, "play", "--agent", "pretrained")
    assert "choose from MinuetInG, OdeToJoy" in line


@pytest.mark.parametrize("command", ["play", "practice", "info", "plan", "train"])
def test_a_folder_is_no_song(command, here, capsys):
    policy(here / "run")
    line = refused(capsys, command, "run")
    assert "run: is no song; give a piece or a music file" in line
    assert line.endswith("plays it as --agent run)")


def test_the_folder_of_a_policy_may_have_an_equals_sign(here):
    folder = policy(here / "lr=0.1" / "best")
    main(["play", "tune.mid", "--agent", str(folder), "--no-video", "-o", "one"])
    main(["play", "tune.mid", f"--agent={folder}", "--no-video", "-o", "other"])
    assert {settings(here / name)["agent"] for name in ("one", "other")} == {str(folder)}


def test_a_policy_on_another_song_is_a_line_on_stderr(here, capsys):
    policy(here / "run")
    write_midi(OTHER, here / "other.mid")
    main(["play", "other.mid", "--agent", "run", "--no-video"])
    assert capsys.readouterr().err == "run: was trained on 'A tune', not other.mid\n"
    beginning = ["--first-seconds", "0.3", "-o", "beginning"]
    write_midi(replace(TUNE, title="A tune"), here / "again.mid")
    main(["play", "again.mid", "--agent", "run", "--no-video", *beginning])
    assert "was trained on 'A tune' in another arrangement, or a part of it, not" in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize("option", [("--level", "3"), ("--arrange", "always")])
def test_a_song_that_a_policy_has_learnt_is_not_arranged_for_it(option, here, capsys):
    policy(here / "run")
    write_midi(replace(TUNE, title="A tune"), here / "again.mid")
    message = refused(capsys, "play", "again.mid", "--agent", "run", "--no-video", *option)
    assert "run: plays this song as it has learnt it; leave out --arrange and --level" in message


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--stretch", "2", "was trained with stretch 1.0, but here it is 2.0"),
        ("--hands", "right", "was trained with hands both, but here it is right"),
        ("--random-pitch-shift", "2", "with random_pitch_shift 0, but here it is 2"),
    ],
)
def test_what_changes_the_plan_that_a_policy_corrects(option, value, message, here, capsys):
    line = refused(capsys, "play", "OdeToJoy", "--agent", "pretrained", option, value)
    assert line.startswith("cadenza: pretrained: was trained with ")
    assert line.endswith(f"{message}; leave out that option, or train a new policy")
    assert not (here / "played").exists()


@pytest.mark.usefixtures("here")
def test_a_policy_that_corrects_a_plan_plays_no_other_song(capsys):
    folder = pretrained_folder("OdeToJoy")
    line = refused(capsys, "play", "tune.mid", "--agent", folder)
    assert "'Ode to Joy', with residual learning, so it can play nothing else" in line


def test_what_the_user_gives_wins_over_what_the_policy_was_trained_with(here):
    policy(here / "run", task={"initial_buffer_time": 0.1}, scene={"physics": "fast"})
    main(["play", "--agent", "run", "--no-video", "-o", "own"])
    own = settings(here / "own")
    assert (own["task"]["initial_buffer_time"], own["scene"]["physics"]) == (0.1, "fast")
    defaults = ["--initial-buffer-time", "0.5", "--physics", "published"]
    main(["play", "--agent", "run", "--no-video", *defaults, "-o", "given"])
    given = settings(here / "given")
    assert (given["task"]["initial_buffer_time"], given["scene"]["physics"]) == (0.5, "published")
    assert load_episode(here / "given" / "episode.npz").num_steps == 23


def test_a_plan_is_played_in_its_physics_unless_told_otherwise(here, capsys):
    main(["play", "tune.mid", "--agent", "random", "--physics", "fast", "--no-video", "-o", "a"])
    replay = ["play", "tune.mid", "--agent", "playback", "--plan", "a/episode.npz", "--no-video"]
    main([*replay, "-o", "b"])
    assert settings(here / "b")["scene"]["physics"] == "fast"
    assert capsys.readouterr().err == ""
    recorded, replayed = (json.loads((here / f / "metrics.json").read_text()) for f in "ab")
    assert recorded["return"] == replayed["return"]
    main([*replay, "-o", "c", "--physics", "published"])
    assert settings(here / "c")["scene"]["physics"] == "published"
    message = capsys.readouterr().err
    assert message == "a/episode.npz: made in the fast physics, played in the published physics\n"


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--hands", "right", "with hands both, but here it is right"),
        ("--n-steps-lookahead", "3", "with n_steps_lookahead 10, but here it is 3"),
    ],
)
def test_what_a_policy_cannot_observe(option, value, message, here, capsys):
    policy(here / "run")
    assert message in refused(capsys, "play", "--agent", "run", option, value)
    main(["play", "--agent", "run", "--n-seconds-lookahead", "0.5", "--no-video"])  # as many steps


# Songs and folders


def test_a_folder_named_like_a_song_does_not_hide_it(here):
    policy(here / "OdeToJoy")
    main(["play", "OdeToJoy", "--agent", "zero", "--no-video", "-o", "bundled"])
    assert load_episode(here / "bundled" / "episode.npz").song == "Ode to Joy"
    main(["play", "--agent", "OdeToJoy", "--no-video", "-o", "folder"])
    assert load_episode(here / "folder" / "episode.npz").song == "A tune"


def test_two_agents_do_not_overwrite_each_other(here):
    for agent in ("zero", "own:Still", str(policy(here / "run" / "best"))):
        main(["play", "tune.mid", "--agent", agent, "--no-video"])
    assert {path.name for path in (here / "played" / "tune").iterdir()} == {
        "zero",
        "own_Still",
        "run-best",
    }


@pytest.mark.parametrize("name", ["...mid", ".mid", "....mid", "a" * 251 + ".mid", "a\nb.mid"])
def test_results_stay_below_their_folder_whatever_a_file_is_called(name, here):
    shutil.move("tune.mid", name)
    main(["play", f"./{name}", "--agent", "zero", "--no-video"])
    assert {path.name for path in here.iterdir()} == {name, "own.py", "played"}
    (song,) = (here / "played").iterdir()
    assert (song / "zero" / "report.html").exists()


# Agents of one's own


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "nowhere:Still",
            "agent nowhere:Still: cannot import 'nowhere': ModuleNotFoundError: No module named",
        ),
        (":Still", "agent :Still: cannot import ''"),
        ("own:Moving", "agent own:Moving: there is no 'Moving' in own"),
        ("own:not_a_class", "agent own:not_a_class: own:not_a_class is of type int; give a class"),
        (
            "own:OnlyResets",
            "agent own:OnlyResets: is no Agent; derive its class from cadenza.Agent",
        ),
        ("planer", "no agent 'planer': did you mean planner? choose from planner, "),
        ("xyz", "no agent 'xyz': choose from planner, "),
    ],
)
def test_agents_that_there_are_not(name, message, capsys):
    assert message in refused(capsys, "play", "tune.mid", "--agent", name)


@pytest.mark.usefixtures("here")
def test_a_planner_needs_a_thread(capsys):
    line = refused(capsys, "plan", "tune.mid", "--num-threads", "0")
    assert line == "cadenza: num_threads 0: choose 1 to 1024"


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["play", "tune.mid", "--agent", "generalist", "--planner.effort", "1"], "planner.effort"),
        (["play", "tune.mid", "--ilqg.iterations", "2"], "ilqg.iterations"),
        (["play", "--agent", ".", "--planner.effort", "1"], "planner.effort"),
        (["bench", "--agents", "zero", "--planner.horizon", "0.5"], "planner.horizon"),
        (["dataset", "collect", "--generalist.rehearsals", "2"], "generalist.rehearsals"),
    ],
)
def test_options_of_agents_that_do_not_play_are_refused(words, option, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    assert f"--{option}" in capsys.readouterr().err


# Ctrl-C


def interrupted(capsys: pytest.CaptureFixture[str], agent: str) -> str:
    # Shells start what runs in the background with Ctrl-C switched off.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(SystemExit) as stop:
        main(["play", "tune.mid", "--agent", agent, "--no-video", "-o", "part"])
    assert stop.value.code == 130
    return capsys.readouterr().err


def test_ctrl_c_keeps_what_was_played(here, capsys):
    message = interrupted(capsys, "own:Impatient")
    assert "stopped after 0.2 of 1.2 s: the results cover only that part\n" in message
    assert load_episode(here / "part" / "episode.npz").num_steps == 3
    assert json.loads((here / "part" / "metrics.json").read_text())["steps"] == 3
    assert (here / "part" / "report.html").exists()
    assert (here / "part" / "played.mid").exists()
    page = (here / "part" / "report.html").read_text()
    goal = base64.b64decode(page.split('class="goal">')[1].split("<")[0])
    assert 0 < len(goal) < 0.4 * 48_000 / 8  # what should have been heard in 0.15 s, 48 kbit/s


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_being_stopped_while_results_are_written_writes_them_all(number, here, capsys, monkeypatch):
    def encode_and_stop(*arguments: Any, **options: Any) -> bytes:
        if not stopped:
            stopped.append(number)
            signal.raise_signal(number)
        return encode_opus(*arguments, **options)

    stopped: list[int] = []
    monkeypatch.setattr(performance, "encode_opus", encode_and_stop)
    message = interrupted(capsys, "own:Still")
    assert "stopping after writing the results; press Ctrl-C again" in message
    assert "cover only that part" not in message
    assert "</html>" in (here / "part" / "report.html").read_text()


def test_ctrl_c_twice_while_results_are_written_writes_no_more(here, capsys, monkeypatch):
    def stop_twice(*_: Any, **__: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(performance, "synthesize", stop_twice)
    interrupted(capsys, "own:Still")
    assert not (here / "part" / "report.html").exists()


@pytest.mark.parametrize("agent", ["own:MoreImpatient", "own:NeverBegins"])
def test_ctrl_c_twice_or_before_the_first_step_keeps_nothing(agent, here, capsys):
    assert interrupted(capsys, agent).endswith("cadenza: interrupted\n")
    assert os.listdir(here / "part") == []


# Hands and keyboards of one's own


@pytest.mark.parametrize("command", ["play", "plan"])
def test_a_hand_in_the_working_folder(command, here):
    (here / "own.py").write_text("from cadenza.hands.shadow import SHADOW as MINE")
    write_midi(Score((Note(0.0, 0.2, 60),)), here / "note.mid")
    out = ["-o", "out", "--no-video"] if command == "play" else ["-o", "out.safetensors"]
    main([command, "note.mid", "--hand", "own:MINE", "--hands", "right", *out])
    assert any(path.name.startswith("out") for path in here.iterdir())


def test_a_keyboard_of_another_size(here):
    (here / "own.py").write_text(
        "from dataclasses import replace\n"
        "from cadenza.keyboards.piano import PIANO\n"
        "SMALL = replace(PIANO, name='small', lowest_pitch=48, num_keys=25)"
    )
    main(["play", "tune.mid", "--agent", "zero", "--keyboard", "own:SMALL", "-o", "out"])
    assert load_episode(here / "out" / "episode.npz")["key_qpos"].shape[1] == 25
