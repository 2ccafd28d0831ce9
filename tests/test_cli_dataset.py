"""`cadenza dataset` as a person meets it: killed, resumed, two at once, and wrong input."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cadenza.cli import main
from cadenza.demonstrations.dataset import kept
from cadenza.files import TEMPORARY
from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from refusals import refused_in_a_line

_PATIENCE = 600.0  # [s] a machine may be busy
COLLECT = ("dataset", "collect", "--songs", "songs", "-o", "out", "--least-f1", "0")
QUICK = ("--planner.method", "none", "--jobs", "2")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """With two songs of one note each."""
    for pitch in 60, 64:
        write_midi(Score((Note(0.0, 0.3, pitch),)), tmp_path / "songs" / f"{pitch}.mid")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def started(*others: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "cadenza", *COLLECT, *QUICK, *others],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,
    )


def results(folder: Path) -> dict[str, int]:
    """Finished episodes, and when each was finished."""
    results = (folder / "out" / "runs").glob("*/result.json")
    return {path.parent.name: path.stat().st_mtime_ns for path in results}


@pytest.mark.slow
def test_killed_and_resumed_and_two_at_once(folder):
    killed = started("--episodes", "4")
    end = time.monotonic() + _PATIENCE
    while len(results(folder)) < 2:
        assert killed.poll() is None
        assert time.monotonic() < end
        time.sleep(0.02)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.communicate()
    before = results(folder)
    assert 2 <= len(before) < 8
    both = [started("--episodes", "4") for _ in range(2)]
    output = [command.communicate(timeout=_PATIENCE)[0] for command in both]
    assert [command.returncode for command in both] == [0, 0], output
    assert all("8 of 8 runs finished" in text for text in output)
    after = results(folder)
    assert len(after) == 8
    assert before.items() <= after.items()
    assert len(kept(folder / "out")) == 8
    assert not list((folder / "out").rglob(f"{TEMPORARY}*"))


@pytest.mark.slow
def test_an_episode_is_played_again_to_a_page(folder, capsys):
    main([*COLLECT, *QUICK])
    capsys.readouterr()
    main(["dataset", "play", "out", "1", "-o", "page"])
    about = kept(folder / "out")[1].facts
    output = capsys.readouterr().out
    assert f"\nf1: {about.f1:.4g}\n" in output
    assert f"\nnote_onset_f1: {about.note_onset_f1:.4g}\n" in output
    assert (folder / "page" / "report.html").exists()


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("collect", "--episodes", "0"), "episodes 0"),
        (("collect", "--least-f1", "2"), "least_f1 2"),
        (("collect", "--noise", "-1"), "noise -1"),
        (("collect", "--excerpt", "0"), "excerpt 0"),
        (("collect", "--level", "3"), "recorded as written: leave out --arrange and --level"),
        (("collect", "--arrange", "always"), "recorded as written: leave out --arrange and"),
        (("collect", "--songs", "nothing"), "no song library 'nothing'"),
        (("collect", "--agent", "nobody"), "no agent 'nobody'"),
        (("collect", "--agent", "playback"), "does not plan, nor play any song; choose"),
        (("collect", "--agent", "songs"), "does not plan, nor play any song; choose"),
        (("collect", "--student", "songs"), "so it is no policy"),
        (("collect", "--randomization.mass", "2", "1"), "randomization.mass 2.0 1.0: give"),
        (("collect", "--setup", "arm-allegro"), "needs hands that slide along the keyboard"),
        (("collect", "--hands", "none"), "no hands"),
        (("info", "songs"), "holds no demonstrations"),
        (("play", "songs", "0"), "holds no demonstrations"),
        (("export", "songs", "-o", "new"), "holds no demonstrations"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(folder, words, what, capsys):
    assert what in refused_in_a_line(capsys, "dataset", *words)
    assert [path.name for path in folder.iterdir()] == ["songs"]
