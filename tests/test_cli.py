"""The command line as a person meets it."""

import errno
import json
import os
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import av
import mido
import numpy as np
import pytest

import cadenza
from cadenza.agents.planner.planner import SongPlanner
from cadenza.agents.playback import SavedPlan
from cadenza.cli import COMMANDS, GROUPS, main
from cadenza.episode import load_episode
from cadenza.evaluation.run_status import claimed_run
from cadenza.files import ANY, read_tensors, write_json, write_tensors
from cadenza.keyboards.piano import PIANO
from cadenza.music.formats.fingering_file import read_fingering
from cadenza.music.formats.midi import read_midi, write_midi
from cadenza.music.goals import score_to_goals
from cadenza.music.libraries.library import songs
from cadenza.music.metrics import expressive_metrics
from cadenza.music.score import Note, PedalEvent, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import DomainRandomization, TaskConfig, task_identity
from headless import needs_chromium
from numbered import numbers
from refusals import refused, refused_in_a_line
from report_pages import recording_in

DATA = Path(__file__).parent / "data"
TUNE = Score(
    (Note(0.0, 0.25, 60), Note(0.25, 0.5, 64), Note(0.25, 0.6, 67)), (PedalEvent(0.3, 127),)
)
QUICK = ("--agent", "zero", "--no-video")
AT_ONCE = ("--initial-buffer-time", "0")  # with the first note
PERFORMANCE = {
    "episode.npz",
    "metrics.json",
    "played.mid",
    "report.html",
    "settings.json",
    "wanted.mid",
}  # the files of a performance without a video
RUN = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
RUN += "from cadenza.cli import main; main(sys.argv[1:])"


@pytest.fixture
def tune(tmp_path):
    write_midi(TUNE, tmp_path / "tune.mid")
    return tmp_path / "tune.mid"


# Help, and what there is


def test_version(capsys):
    main(["--version"])
    assert capsys.readouterr().out == f"cadenza {cadenza.__version__}\n"


def test_quiet_prints_nothing(tune, tmp_path, capsys):
    main(["play", str(tune), *QUICK, "-q", "-o", str(tmp_path / "played")])
    assert capsys.readouterr() == ("", "")
    assert (tmp_path / "played/report.html").exists()
    assert "no song named" in refused_in_a_line(capsys, "play", "nothing", "--quiet")


def test_bash_completes_commands_and_options(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--tyro-write-completion", "bash", "-"])
    assert not stop.value.code
    script = tmp_path / "completion"
    script.write_text(capsys.readouterr().out)
    complete = """
        source "$1"; shift
        COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
        COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
        $(complete -p cadenza | grep -o -- '-F [^ ]*' | cut -c 4-)
        printf '%s\\n' "${COMPREPLY[@]}"
    """

    def completions(*words: str) -> list[str]:
        command = ["bash", "-c", complete, "bash", str(script), *words]
        return [line.strip() for line in subprocess.check_output(command, text=True).splitlines()]

    assert sorted(completions("cadenza", "pl")) == ["plan", "play"]
    assert "--planner.iterations" in completions("cadenza", "play", "--plan")
    assert completions("cadenza", "dataset", "coll") == ["collect"]


def test_starts_without_the_heavy_libraries():
    heavy = ("mujoco", "scipy", "mir_eval", "av", "mido", "jax", "tqdm")
    code = f"import sys, cadenza.cli; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == "[]\n"


def test_songs(capsys):
    main(["songs"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [piece.name for piece in songs()]
    assert all(piece.title in line for piece, line in zip(songs(), lines, strict=True))


@pytest.mark.parametrize("command", ["", *GROUPS, *COMMANDS])
def test_help_says_what_it_does(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*command.split(), "--help"])
    assert stop.value.code == 0
    output = capsys.readouterr().out
    assert output.startswith(f"usage: cadenza {command}".strip())
    assert output.split("\n\n")[1].endswith((".", "?"))
    assert "Traceback" not in output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "Expected one of {play, plan, film"),
        (["dance"], "Available subcommands: play, plan, film"),
        (["dataset", "colect"], "Available subcommands: collect, info"),
        (["plan"], "Missing from cadenza plan: SONG A song by its name"),
        (["play", "OdeToJoy", "FurElise"], "Unrecognized options: FurElise"),
        (["play", "OdeToJoy", "--seed", "x"], "Error parsing --seed"),
        (["play", "OdeToJoy", "--seed"], "Missing value for argument '--seed'"),
        (["play", "OdeToJoy", "--hands", "three"], "Expected one of ('both', 'apart', 'right'"),
        (["play", "OdeToJoy", "--no_vido"], "Perhaps you meant: --video, --no-video"),
        (["play", "OdeToJoy", "--ilqg.horizon", "9"], "Unrecognized options: --ilqg.horizon"),
    ],
)
def test_a_command_line_that_cannot_be_read(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    line = " ".join(capsys.readouterr().err.replace("│", "").split())
    assert message in line
    assert "--help" in line


def facts(out: str) -> dict[str, str]:
    rows = (line.split("  ", 1) for line in out.split("\n\n")[0].splitlines())
    return {name: value.strip() for name, value in rows}


def test_info_on_a_song(capsys):
    main(["info", "TwinkleTwinkleLittleStar"])
    shown = facts(capsys.readouterr().out)
    assert shown["length"] == "8.0 s, 161 steps"
    assert shown["notes"] == "14"
    assert shown["at once"] == "up to 1 key"
    assert shown["fingering"] == "given for 14 of 14 notes"
    assert shown["hands"] == "as written, 14 notes for the right and 0 for the left"


def test_info_on_the_installation(capsys):
    main(["info"])
    shown = facts(capsys.readouterr().out)
    assert shown["cadenza"] == cadenza.__version__
    assert int(shown["cores"]) >= 1
    assert shown["can draw pictures"].startswith(("yes", "no; "))
    assert shown["agent ilqg"] == "the paper's planner with derivatives"
    assert shown["hand allegro"] == "the Allegro Hand, four fingers"
    assert shown["keyboard piano"] == "the 88 keys of a piano"


@pytest.mark.parametrize("arguments", [["songs"], ["play", "--help"]])
def test_a_reader_that_leaves_early_gets_no_traceback(arguments):
    process = subprocess.Popen(
        [sys.executable, "-u", "-c", RUN, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout
    process.stdout.close()
    assert process.stderr
    assert process.stderr.read() == b""
    assert process.wait(timeout=60) == 1


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        ("songs >&-", 0),
        ("songs <&- >&- 2>&-", 0),
        ("play --help >&-", 0),
        ("info nothing >&- 2>&-", 1),
        ("info nothing 2>/dev/full", 1),
        ("songs >/dev/full", 1),
        ("play --help >/dev/full", 1),
    ],
)
def test_streams_that_cannot_be_written(arguments, status):
    command = f"{shlex.quote(sys.executable)} -m cadenza {arguments}"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert result.returncode == status
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    assert result.stderr.count("\n") <= 1


def test_playing_with_everything_closed(tune, tmp_path):
    """No file of the results is taken for stdout or stderr."""
    command = [sys.executable, "-m", "cadenza", "play", str(tune), *QUICK, "-o", str(tmp_path)]
    closing = f"{shlex.join(command)} <&- >&- 2>&-"
    assert subprocess.run(["bash", "-c", closing], check=False).returncode == 0
    assert json.loads((tmp_path / "metrics.json").read_text())["steps"] == 23
    goal = load_episode(tmp_path / "episode.npz")["goal_keys"]
    assert len(goal) == 23
    assert goal.any(axis=1).argmax() == 10  # after half a second to get into place


def test_one_step_and_one_note(tmp_path, capsys):
    write_midi(Score((Note(0.0, 0.04, 60),)), tmp_path / "note.mid")
    main(["info", str(tmp_path / "note.mid")])
    assert "0.0 s, 1 step\n" in capsys.readouterr().out
    options = ["--agent", "generalist", "--no-video", "-o", str(tmp_path / "out")]
    main(["play", str(tmp_path / "note.mid"), *options])
    assert " of 1 note" in (output := capsys.readouterr().out)
    assert "1 notes" not in output


@pytest.mark.parametrize(
    "words",
    [
        ["play", "{tune}", *QUICK, "-o", "{out}"],
        ["practice", "{tune}", "--effort", "0", "--planner.method", "none", "-o", "{out}"],
        ["plan", "{tune}", "--planner.method", "none", "-o", "{out}/plan.safetensors"],
        ["etude", "-o", "{out}/etude.mid"],
        ["bench", "--agents", "zero", "-o", "{out}"],
    ],
    ids=lambda words: words[0],
)
def test_a_full_disk_is_told_in_a_line(words, tune, tmp_path, monkeypatch, capsys):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    message = refused(capsys, *(word.format(tune=tune, out=tmp_path / "out") for word in words))
    assert message.splitlines()[-1].startswith(f"cadenza: {tmp_path / 'out'}")
    assert message.endswith(
        ": the disk is full; free some space, then give the same command again\n"
    )


def test_a_run_for_which_the_disk_is_full_says_so(tmp_path):
    job = SimpleNamespace(command="cadenza bench", spec=SimpleNamespace(as_json=dict))
    with claimed_run(job, tmp_path, lambda *_: False):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "episode.npz")
    assert "episode.npz: the disk is full; free some" in (tmp_path / "failed.json").read_text()


# Ctrl-C


@pytest.mark.parametrize(
    "module", ["numpy", "cadenza.tasks.registration", "cadenza.cli.train", "cadenza.music.goals"]
)
def test_ctrl_c_while_a_module_is_imported(module):
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Interrupts:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {module!r}:\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupts())\n"
        "from cadenza_command import main\n"
        "main()\n"
    )
    command = [sys.executable, "-c", code, "info", "OdeToJoy"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (130, "")
    assert result.stderr in ("", "cadenza: interrupted\n")


def test_the_command_is_what_ctrl_c_ends_while_it_is_imported():
    with open(Path(__file__).parents[1] / "pyproject.toml", "rb") as file:
        assert tomllib.load(file)["project"]["scripts"] == {"cadenza": "cadenza_command:main"}


# Playing


def perfect_plan(score: Score, path: Path) -> Path:
    """For the piano that plays itself: every key and the pedal as the score wants them."""
    goals = score_to_goals(score, 0.05)
    np.savez(path, action=np.column_stack([goals.keys * PIANO.travel, goals.sustain]))
    return path


def test_a_film_that_cannot_be_is_refused_in_a_line(tune, tmp_path, capsys, monkeypatch):
    main(["play", str(tune), "--agent", "zero", "-o", str(tmp_path / "played")])
    film = ["film", str(tmp_path / "played")]
    for size in ((0, 90), (161, 90), (160, 4000)):
        assert "choose even numbers from 64" in refused_in_a_line(capsys, *film, "--size", *size)
    assert "no camera 'back': choose from player, close" in refused_in_a_line(
        capsys, *film, "--camera", "back"
    )
    message = refused_in_a_line(capsys, "film", tmp_path)
    assert "holds no performance (episode.npz); make one with" in message
    assert "choose a name with one of these endings" in refused_in_a_line(
        capsys, *film, "-o", tmp_path / "a.png"
    )
    assert "nothing to show from 90 s" in refused_in_a_line(capsys, *film, "--start", 90)
    main([*film, "-o", str(tmp_path / "a.flac"), "--start", "0.25", "--seconds", "0.5"])
    with av.open(str(tmp_path / "a.flac")) as file:
        assert file.duration / 1e6 == pytest.approx(0.5, abs=0.001)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "apt install chromium" in refused_in_a_line(capsys, *film)
    broken = tmp_path / "google-chrome"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    assert "cannot draw the film: it has ended" in refused_in_a_line(capsys, *film)  # at once
    broken.unlink()
    main(["play", str(tune), "--agent", "zero", "--video", "-o", str(tmp_path / "again")])
    assert capsys.readouterr().err.startswith("no film: ")  # what was played is there all the same


@needs_chromium
@pytest.mark.slow
@pytest.mark.parametrize("size", [(160, 90), (90, 160)])
def test_a_film_shows_what_was_played(size, tune, tmp_path):
    """By another reader of films: H.264 and AAC, which any player plays."""
    agent = ["--agent", "playback", "--plan", str(perfect_plan(TUNE, tmp_path / "p.npz"))]
    folder = tmp_path / "played"
    main(["play", str(tune), "--hands", "none", *agent, *AT_ONCE, "-o", str(folder)])
    main(["film", str(folder), "--seconds", "0.25", "--score", "--size", *map(str, size)])
    with av.open(str(folder / "video.mp4")) as file:
        video, sound = file.streams.video[0], file.streams.audio[0]
        assert (video.codec.name, sound.codec.name) == ("h264", "aac")
        assert (video.width, video.height) == size
        assert video.average_rate in (30, 60)  # without a graphics card, with one
        pictures = [frame.to_ndarray(format="rgb24") for frame in file.decode(video)]
        file.seek(0)
        samples = np.concatenate([frame.to_ndarray() for frame in file.decode(sound)], axis=1)
    assert len(pictures) == round(0.25 * video.average_rate)
    greys = np.array([picture.mean(axis=2) for picture in pictures])
    assert greys[0].std() > 20  # there is something to see
    assert np.abs(np.diff(greys, axis=0)).max() > 15  # which moves
    assert np.abs(samples).max() > 0.05
    assert samples.shape[1] / sound.rate == pytest.approx(0.25, abs=0.05)


def test_play_leaves_what_it_promises(tune, tmp_path, capsys):
    plan, folder = perfect_plan(TUNE, tmp_path / "plan.npz"), tmp_path / "new" / "folder"
    playing = ("play", tune, "--hands", "none", "--agent", "playback", "--plan", plan)
    arguments = [*playing, "-o", folder, *AT_ONCE]
    main([str(argument) for argument in [*arguments, "--verbose"]])
    output = capsys.readouterr()
    assert output.out.startswith("All ")
    assert "\nf1: 1\n" in output.out
    assert f"Open {folder / 'report.html'}" in output.out
    names = {path.name for path in folder.iterdir()}
    assert names == PERFORMANCE
    assert all(path.stat().st_size for path in folder.iterdir())

    metrics = json.loads((folder / "metrics.json").read_text())
    scores = {"precision", "recall", "f1"}
    scores |= {f"{kind}_{name}" for name in scores for kind in ("sustain", "pooled")}
    scores |= {"note_onset_f1", "note_onset_offset_f1"}
    other = {"return", "reward/key_press", "reward/loudness", "reward/onset_timing", "energy"}
    other |= {"steps", "planning_seconds", "playing_seconds", "rewarded_fingers"}
    assert f"\nreward/key_press: {metrics['reward/key_press']:.4g}\n" in output.out
    expression = expressive_metrics(Score(()), Score(())).keys() - scores
    assert metrics.keys() == scores | other | expression | {"unstable", "timing_error"}
    assert {metrics[name] for name in scores} == {1.0}
    assert (metrics["steps"], metrics["unstable"]) == (13, 0)
    assert 0 < metrics["timing_error"] < 0.05  # keys sound within their steps

    settings = json.loads((folder / "settings.json").read_text())
    assert (settings["seed"], settings["agent"], settings["plan"]) == (0, "playback", str(plan))
    assert settings["scene"]["hands"] == "none"

    played = read_midi(folder / "played.mid")
    notes = [time for n in sorted(played.notes, key=lambda n: n.pitch) for time in (n.start, n.end)]
    assert notes == pytest.approx([0.0, 0.25, 0.25, 0.5, 0.25, 0.6], abs=0.05)  # a step
    assert [(round(e.time, 3), e.value) for e in played.pedal] == [(0.3, 127)]
    assert "<html" in (folder / "report.html").read_text()


def test_nothing_of_another_performance_stays(tune, tmp_path):
    folder = tmp_path / "played"
    main(["play", str(tune), "--agent", "zero", "--no-video", "-o", str(folder)])
    for name in ("misses.json", "video.mp4", "episode-left.npz", "of-the-user.txt"):
        write_json(folder / name, "of before")
    main(["play", str(tune), "--agent", "zero", "--no-video", "-o", str(folder)])
    assert {path.name for path in folder.iterdir()} == PERFORMANCE | {"of-the-user.txt"}


@pytest.mark.parametrize("command", ["play", "practice"])
@pytest.mark.parametrize("name", ["report.html", "settings.json", "episode.npz"])
def test_what_somebody_else_has_written_stays(command, name, tune, tmp_path, capsys):
    write_json(tmp_path / "mine" / name, {"song": "of the user"})
    before = (tmp_path / "mine" / name).read_bytes()
    message = refused(capsys, command, tune, "--no-video", "-o", tmp_path / "mine")
    assert f"holds {name} from something else" in message
    assert (tmp_path / "mine" / name).read_bytes() == before
    assert [path.name for path in (tmp_path / "mine").iterdir()] == [name]


@pytest.mark.parametrize("command", ["play", "practice"])
def test_a_song_is_not_replaced_by_its_performance(command, tune, tmp_path, capsys):
    song = tmp_path / "played.mid"
    song.write_bytes(tune.read_bytes())
    assert "would be replaced" in refused(capsys, command, song, "--no-video", "-o", tmp_path)
    assert song.read_bytes() == tune.read_bytes()


def test_the_episode_has_the_arrays_of_the_published_recordings(tune, tmp_path):
    terms = ["--sustain-term", "--forearm-term"]
    main(["play", str(tune), *QUICK, *AT_ONCE, *terms, "-o", str(tmp_path)])
    episode = load_episode(tmp_path / "episode.npz")
    with np.load(DATA / "episode_a.npz") as recording:
        names = set(recording.files) - {"song", "dt"}
        assert names <= episode.arrays.keys()
        for name in names:
            ours, published = episode[name], recording[name]
            assert ours.ndim == published.ndim, name
            assert ours.dtype.kind == published.dtype.kind, name
    assert len(episode.arrays["key_qpos"]) == 13
    assert episode.scene["shells"]


def figures(folder: Path) -> dict[str, float]:
    """The metrics but for how long it took."""
    metrics = json.loads((folder / "metrics.json").read_text())
    return {name: value for name, value in metrics.items() if not name.endswith("_seconds")}


def test_the_same_seed_plays_the_same(tune, tmp_path):
    folders = [tmp_path / name for name in ("a", "b", "c")]
    for folder, seed in zip(folders, ("7", "7", "8"), strict=True):
        options = ["--seed", seed, "--random-hand-position", "0.05", "--agent", "random"]
        main(["play", str(tune), *options, "-o", str(folder)])
    a, b, c = (load_episode(folder / "episode.npz") for folder in folders)
    assert figures(folders[0]) == figures(folders[1])
    assert a.arrays.keys() == b.arrays.keys()
    for name in a.arrays.keys() - {"metrics"}:  # which tell the seconds, too
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    assert (a["action"] != c["action"]).any()


def test_task_and_scene_options_arrive(tune, tmp_path):
    options = ["--initial-buffer-time", "0.25", "--hands", "left", "--no-reduced-action-space"]
    options += ["--forearm-dofs", "tx", "tz"]
    main(["play", str(tune), *QUICK, *options, "-o", str(tmp_path)])
    episode = load_episode(tmp_path / "episode.npz")
    scene = SceneConfig(hands="left", reduced_action_space=False, forearm_dofs=("tx", "tz"))
    assert episode["actuator_names"].tolist() == list(build_scene(scene).actuator_names)
    assert episode.num_steps == 18


def test_notes_without_a_finger_are_told(tmp_path, capsys):
    low_and_high = Score((Note(0.0, 0.4, 30), Note(0.0, 0.4, 90)))
    write_midi(low_and_high, tmp_path / "far.mid")
    options = ["--arrange", "off", "--hands", "right", "--verbose", "-o", str(tmp_path)]
    main(["play", str(tmp_path / "far.mid"), *options])
    output = capsys.readouterr().out
    (lost,) = json.loads((tmp_path / "misses.json").read_text())
    assert (lost["note"], lost["finger"], lost["time"]) == ("F♯1", -1, 0.5)
    assert "1 note missed: no finger\n" in output
    assert "no finger for 1 note: " + lost["reason"].removeprefix("no finger for it: ") in output
    assert lost["reason"] in str(recording_in((tmp_path / "report.html").read_text()))


def test_the_planners_have_options_of_their_own(tune, tmp_path):
    options = ["--agent", "predictive-sampling", "--predictive-sampling.num-candidates", "3"]
    main(["play", str(tune), *options, "--no-video", "-o", str(tmp_path)])
    settings = json.loads((tmp_path / "settings.json").read_text())
    assert settings["predictive_sampling"]["num_candidates"] == 3
    assert not settings.keys() & {"planner", "ilqg"}  # of who plays only
    assert not (tmp_path / "misses.json").exists()  # they do not say what they had in mind


# Planning


def printed_command(out: str) -> list[str]:
    """The arguments of the command on the last line."""
    program, *arguments = shlex.split(out.strip().splitlines()[-1])
    assert program == "cadenza"
    return arguments


@pytest.mark.parametrize(
    "options",
    [
        ["--stretch", "1.3", "--hands", "right", "--no-reduced-action-space"],
        ["--random-pitch-shift", "5", "--seed", "3", "--physics", "fast"],
    ],
)
def test_a_plan_replays_bit_for_bit(options, tune, tmp_path, capsys):
    path = tmp_path / "a plan.safetensors"
    main(["plan", str(tune), "-o", str(path), *options])
    output = capsys.readouterr().out
    assert "in time (within 50 ms)" in output
    main([*printed_command(output), "--no-video", "-o", str(tmp_path)])
    arrays, facts = read_tensors(path, ANY, 2**20)
    assert arrays["action"].dtype == np.float64
    assert (facts["song"], facts["dt"]) == ("tune", 0.05)
    planned = {name: v for name, v in facts["metrics"].items() if not name.endswith("_seconds")}
    assert figures(tmp_path) == planned


def test_the_fingers_of_a_plan_go_with_the_file(tune, tmp_path):
    path = tmp_path / "plan.safetensors"
    main(["plan", str(tune), "-o", str(path), "--stretch", "2"])
    fingered = read_fingering(f"{path}.fingering", read_midi(tune))
    fingers = numbers(fingered)
    assert min(fingers) >= 0
    arrays, _ = read_tensors(path, ANY, 2**20)
    assert arrays["fingering"][:, 2].tolist() == fingers
    assert arrays["fingering"][:, 1].tolist() == [60, 64, 67]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--initial-buffer-time", "0"], "initial_buffer_time 0.5, but here it is 0.0"),
        (["--stretch", "1.001"], "stretch 1.0, but here it is 1.001"),
        (["--hand-spacing", "0.31"], "hand_spacing 0.3, but here it is 0.31"),
    ],
)
def test_a_plan_made_with_other_options(options, message, tmp_path, tune, capsys):
    path, task = tmp_path / "plan.safetensors", TaskConfig()
    made = {"action": np.zeros((23, 39)), "fingering": np.zeros((3, 3))}
    facts = {
        "song": "",
        "dt": 0.05,
        "metrics": {},
        "options": task_identity(task, SceneConfig(), 0),
    }
    write_tensors(path, made, facts)
    arguments = ("play", tune, "--agent", "playback", "--plan", path, *options, "-o", tmp_path)
    line = refused_in_a_line(capsys, *arguments)
    assert f"{path}: was planned with {message}; use the same value" in line


def test_fingers_that_feel_play_the_same_plan_in_any_physics_and_against_noise():
    nominal = task_identity(TaskConfig(), SceneConfig(), 0)
    plan = SavedPlan(Path(), np.zeros((23, 39)), nominal)
    plan.check(task_identity(TaskConfig(), SceneConfig(touch=True, physics="fast"), 0))
    disturbed = TaskConfig(randomization=DomainRandomization(control_noise=0.1, mass=(0.9, 1.1)))
    assert task_identity(disturbed, SceneConfig(), 0) == nominal


def test_a_plan_is_a_safetensors_file(tune, tmp_path, capsys):
    message = refused_in_a_line(capsys, "plan", tune, "-o", tmp_path / "tune.fingering")
    assert "tune.fingering: a plan is a .safetensors file" in message


def test_a_plan_is_written_as_sheet_music(tune, tmp_path, capsys):
    path, sheet = tmp_path / "plan.safetensors", tmp_path / "sheets" / "tune.musicxml"
    main(["plan", str(tune), "-o", str(path), "--score", str(sheet)])
    assert f"{sheet}: the song has no bars" in capsys.readouterr().out
    fingered = read_fingering(f"{path}.fingering", read_midi(tune))
    assert numbers(cadenza.load_song(sheet)) == numbers(fingered)
    message = refused_in_a_line(capsys, "plan", tune, "--score", tmp_path / "tune.txt")
    assert "tune.txt: sheet music is a .musicxml, .pdf, .svg or .mid file" in message


def test_the_sheet_music_of_a_plan_is_in_its_key_and_tempo(tune, tmp_path):
    how = "--transpose", "3", "--stretch", "2"
    path, sheet = tmp_path / "plan.safetensors", tmp_path / "sheet.mid"
    main(["plan", str(tune), *how, "-o", str(path), "--score", str(sheet)])
    written, tuned = read_midi(sheet), read_midi(tune)
    assert [n.pitch for n in written.notes] == [n.pitch + 3 for n in tuned.notes]
    assert [n.start for n in written.notes] == pytest.approx([2 * n.start for n in tuned.notes])


def test_a_plan_is_drawn_as_sheet_music(tune, tmp_path):
    picture = tmp_path / "tune.svg"
    main(["plan", str(tune), "-o", str(tmp_path / "a.safetensors"), "--score", str(picture)])
    numbers = [
        text.text for text in ElementTree.parse(picture).iter() if text.get("class") == "fing"
    ]
    assert len(numbers) == len(cadenza.load_song(tune).notes)


@pytest.mark.parametrize("text", [None, "0.0 60 R3\n"])
def test_a_plan_may_be_called_like_its_song(text, tune):
    own = tune.with_suffix(".fingering")
    if text is not None:
        own.write_text(text)
    before = cadenza.load_song(tune)
    out = ["-o", str(tune.with_suffix(".safetensors"))]
    main(["plan", str(tune), "--planner.method", "none", *out])
    assert cadenza.load_song(tune) == before  # its fingers have not become those of the plan
    assert (own.read_text() if own.exists() else None) == text
    assert read_fingering(f"{tune.with_suffix('.safetensors')}.fingering", TUNE).has_fingering


def test_half_a_plan_is_not_kept(tune, tmp_path, monkeypatch, capsys):
    clenched = build_scene().action_high
    monkeypatch.setattr(SongPlanner, "act", lambda *_: clenched)
    path = tmp_path / "plan.safetensors"
    options = ("-o", path, "--wrong-press-termination")
    assert "the plan is incomplete" in refused_in_a_line(capsys, "plan", tune, *options)
    assert not path.exists()


def test_a_baseline_plays_and_says_what_it_misses(tmp_path, capsys):
    write_midi(Score((Note(0, 0.5, 72), Note(0.5, 1, 21))), tmp_path / "leap.mid")
    options = ["--hands", "right", "--agent", "icp", "--no-video", *AT_ONCE]
    options += ["--icp.no-rehearse", "-o", str(tmp_path)]
    main(["play", str(tmp_path / "leap.mid"), *options])
    lost = json.loads((tmp_path / "misses.json").read_text())
    assert "A0" in {miss["note"] for miss in lost}
    assert "of 2 notes" in capsys.readouterr().out


# MIDI files as they come


def test_tracks_tempo_changes_and_notes_off_the_keyboard(tmp_path, capsys):
    file = mido.MidiFile(ticks_per_beat=100)
    tempo = mido.MidiTrack([mido.MetaMessage("set_tempo", tempo=1_000_000, time=0)])
    tempo.append(mido.MetaMessage("set_tempo", tempo=250_000, time=100))  # after a second
    right = mido.MidiTrack(
        [
            mido.Message("note_on", note=72, velocity=64, time=0),
            mido.Message("note_off", note=72, time=100),  # 1 s
            mido.Message("note_on", note=76, velocity=64, time=0),
            mido.Message("note_on", note=76, velocity=0, time=200),  # 0.5 s at the new tempo
        ]
    )
    left = mido.MidiTrack(
        [
            mido.Message("note_on", channel=1, note=5, velocity=64, time=0),  # not on a piano
            mido.Message("note_off", channel=1, note=5, time=50),
            mido.Message("note_on", channel=1, note=48, velocity=64, time=0),
            mido.Message("note_off", channel=1, note=48, time=50),
        ]
    )
    file.tracks += [tempo, right, left]
    path = tmp_path / "tracks.mid"
    file.save(path)
    main(["info", str(path)])
    shown = facts(capsys.readouterr().out)
    assert shown["length"] == "1.5 s, 31 steps"
    assert shown["notes"] == "3"
    assert shown["range"] == "C3 to E5 (MIDI 48 to 76)"
    assert "88 keys" in shown["repaired 1"]
    main(["play", str(path), *QUICK, "-o", str(tmp_path / "played")])
    assert "88 keys" in capsys.readouterr().err
    assert load_episode(tmp_path / "played/episode.npz").num_steps == 41


@pytest.mark.parametrize("notes", [[], [5, 120]])
@pytest.mark.parametrize("command", ["info", "play", "plan"])
def test_a_file_without_a_note_to_play(command, notes, tmp_path, capsys):
    track = mido.MidiTrack()
    for note in notes:
        track.append(mido.Message("note_on", note=note, time=0))
        track.append(mido.Message("note_off", note=note, time=100))
    mido.MidiFile(tracks=[track]).save(tmp_path / "silent.mid")
    assert "no notes" in refused_in_a_line(capsys, command, tmp_path / "silent.mid")


# What is wrong is said in a line


@pytest.mark.parametrize("command", ["info", "play", "plan"])
def test_songs_that_there_are_not(command, tmp_path, capsys):
    message = refused_in_a_line(capsys, command, "OdeToJoi")
    assert "did you mean OdeToJoy" in message
    missing, text = tmp_path / "missing.mid", tmp_path / "text.mid"
    assert f"{missing}: there is no such file" in refused_in_a_line(capsys, command, missing)
    text.write_text("Dear piano,\nplay something.\n")
    assert f"{text}: not a MIDI file" in refused_in_a_line(capsys, command, text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--agent", "playback"], "--plan"),
        (["--plan", "x.npz"], "--agent playback"),
        (["--agent", "playback", "--plan", "nowhere.npz"], "nowhere.npz: there is no such file"),
        (["--agent", "zero", "--seed", "-1"], "seed -1"),
        (["--agent", "zero", "--control-timestep", "0.012"], "control_timestep 0.012 s"),
        (["--agent", "zero", "--control-timestep", "nan"], "control_timestep nan"),
        (["--agent", "zero", "--initial-buffer-time", "-1"], "initial_buffer_time -1.0"),
        (["--agent", "zero", "--hand-spacing", "9"], "hand_spacing 9.0 m"),
        (["--agent", "zero", "--forearm-dofs", "tx", "tx"], "forearm_dofs"),
        (["--planner.num-candidates", "1"], "num_candidates 1: choose 4 to 10000"),
        (["--agent", "predictive-sampling", "--predictive-sampling.num-knots", "1"], "num_knots 1"),
    ],
)
def test_options_that_make_no_sense(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert message in refused_in_a_line(capsys, "play", "OdeToJoy", *arguments)


@pytest.mark.parametrize("command", ["info", "play", "arrange", "train"])
def test_an_address_is_no_song(command, capsys):
    url = "https://example.org/song.mid"
    message = refused(capsys, command, url).splitlines()[-1]
    assert message == f"cadenza: {url}: is an address; download the file, and give its path"


@pytest.mark.parametrize("place", ["", "below", "further/below"])
def test_a_file_where_results_should_go(place, tune, tmp_path, capsys):
    (tmp_path / "a file").touch()
    folder = tmp_path / "a file" / place
    message = refused_in_a_line(capsys, "play", tune, *QUICK, "-o", folder)
    assert message.startswith(f"cadenza: {folder}: results cannot be written there (")
    assert message.rstrip().endswith("--output")
    message = refused_in_a_line(capsys, "studio", "--folder", folder)
    assert message.rstrip().endswith("--folder")


def test_a_plan_for_something_else(tune, tmp_path, capsys):
    plan = perfect_plan(TUNE, tmp_path / "plan.npz")
    arguments = ("play", tune, "--agent", "playback", "--plan", plan, "-o", tmp_path)
    assert f"{PIANO.num_keys + 1} actions per step, but this task has 39" in refused_in_a_line(
        capsys, *arguments
    )
    longer = (*arguments, "--hands", "none", "--initial-buffer-time", "0.1")
    assert "13 steps, but the song has 15" in refused_in_a_line(capsys, *longer)


WITHOUT_GRAPHICS = """
import ctypes
load = ctypes.CDLL.__init__
def without_graphics(self, name, *more, **other):
    if any(part in str(name) for part in ("OSMesa", "EGL")):
        raise OSError(f"{name}: no such library")
    load(self, name, *more, **other)
ctypes.CDLL.__init__ = without_graphics
"""


def without_graphics(backend: str, folder: Path, code: str, *arguments: object) -> str:
    """What a process prints where neither EGL nor OSMesa is there."""
    (folder / "sitecustomize.py").write_text(WITHOUT_GRAPHICS)
    folders = [str(folder), os.environ.get("PYTHONPATH", "")]
    env = {**os.environ, "MUJOCO_GL": backend, "PYTHONPATH": os.pathsep.join(folders)}
    command = [sys.executable, "-c", code, *map(str, arguments)]
    result = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "Traceback" not in result.stderr
    return result.stdout + result.stderr


@pytest.mark.parametrize(
    ("backend", "message"),
    [
        ("bogus", "install EGL or OSMesa, or unset MUJOCO_GL"),
        pytest.param("egl", "install EGL, or unset MUJOCO_GL", marks=pytest.mark.slow),
        pytest.param("osmesa", "install OSMesa, or unset MUJOCO_GL", marks=pytest.mark.slow),
        ("off", "disabled by MUJOCO_GL=off"),
    ],
)
def test_info_says_why_a_machine_cannot_draw(backend, message, tmp_path):
    assert message in without_graphics(backend, tmp_path, f"{RUN}", "info")


def test_a_machine_that_cannot_draw_does_all_else(tune, tmp_path):
    make = "import gymnasium as gym; gym.make('cadenza/OdeToJoy-v0').reset(seed=0)"
    play = "play", tune, "--agent", "zero", "-o", tmp_path / "played"
    assert "Open" in without_graphics("bogus", tmp_path, f"{RUN}; {make}", *play)


def test_without_assertions_and_docstrings(tune, tmp_path):
    plan, played = tmp_path / "plan.safetensors", tmp_path / "played"
    lines = (["play", tune, *QUICK, "-o", played], ["plan", tune, "-o", plan], ["play", "--help"])
    words = [[str(word) for word in line] for line in lines]
    code = f"from cadenza.cli import main\nfor line in {words}: main(line)"
    output = subprocess.check_output([sys.executable, "-OO", "-c", code], text=True)
    assert " in time (within 50 ms)" in output
    assert "F1 " not in output  # which is for --verbose
    assert "Fingering in" in output
    assert "--seed" in output
