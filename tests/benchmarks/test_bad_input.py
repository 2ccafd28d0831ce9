"""Benchmarks and tools say what they do, and in a line what is wrong with what they are given."""

import runpy
import sys
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score

ROOT = Path(__file__).parents[2]
BAD = {
    "benchmarks/drills.py": ["nowhere/best"],
    "benchmarks/learning.py": ["Nope"],
    "benchmarks/multitask.py": ["--songs", "100"],
    "benchmarks/physics.py": ["nowhere.npz"],
    "benchmarks/planners.py": ["Nope"],
    "benchmarks/related.py": ["--settings", "Nope"],
    "benchmarks/repertoire.py": ["Nope"],
    "benchmarks/robustness.py": ["Nope"],
    "benchmarks/speed.py": ["nowhere.npz"],
    "tools/fit_difficulty.py": ["play", "Nope", "-o", "rows.jsonl"],
    "tools/fit_fingering.py": ["Nope", "-o", "rows.jsonl"],
    "tools/fit_jumps.py": ["play", "jumps.jsonl", "--hand", "Nope"],
}

WRONG = {
    ("benchmarks/repertoire.py", "--seeds", "0"): "'0' is no number of 1 or more",
    ("benchmarks/repertoire.py", "--method", "magic"): "invalid choice: 'magic'",
    ("benchmarks/planners.py", "Nope", "--steps", "0"): "'0' is no number of 1 or more",
    ("benchmarks/physics.py", "plan.npz"): "plan.npz: no recorded episode, but a plan",
    ("tools/fit_jumps.py", "fit", "cut.jsonl"): "cut.jsonl, line 2: not JSON",
    ("tools/fit_jumps.py", "fit", "empty.jsonl"): "empty.jsonl: holds no jumps",
    ("tools/fit_jumps.py", "fit", "jumps.jsonl", "--hand", "allegro"): "of another hand",
    ("tools/fit_difficulty.py", "fit", "cut.jsonl"): "cut.jsonl, line 2: not JSON",
    ("tools/fit_fingering.py", "debug", "-o", "cut.jsonl"): "cut.jsonl, line 2: not JSON",
    ("tools/fit_fingering.py", "debug", "-o", "x", "--most", "0"): "no songs to play",
}


@pytest.mark.parametrize("program", BAD)
def test_a_program_says_what_is_wrong(program, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert "error: " in last_line_of(program, BAD[program], monkeypatch, capsys)


@pytest.mark.parametrize("command", WRONG, ids=" ".join)
def test_it_says_this(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    row = '{"hand": "shadow", "seconds": 8.0, "costs": {}, "song": "", "f1": 1, "onsets": 1}\n'
    Path("jumps.jsonl").write_text(row)
    Path("cut.jsonl").write_text(row + row[:20])
    Path("empty.jsonl").write_text("")
    np.savez("plan.npz", action=np.zeros((3, 47)))
    assert WRONG[command] in last_line_of(command[0], command[1:], monkeypatch, capsys)


def last_line_of(
    program: str,
    arguments: Sequence[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> str:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    monkeypatch.setattr(sys, "argv", [program, *arguments])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(ROOT / program), run_name="__main__")
    assert stopped.value.code in (1, 2)  # argparse ends with 2
    return capsys.readouterr().err.splitlines()[-1]


TOOLS = ROOT / "tools"
ELSEWHERE = {"check_lerobot"}  # needs a package that is none of ours
SHARED = {"openings", "strike_offsets"}  # modules of the others
NAMES = sorted({path.stem for path in TOOLS.glob("*.py")} - ELSEWHERE - SHARED)


@pytest.mark.parametrize("name", NAMES)
def test_a_tool_asked_for_help_does_nothing_else(name, tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(TOOLS))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    monkeypatch.setenv("MUJOCO_GL", "egl")  # a tool would turn drawing off for other tests, too
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(TOOLS / f"{name}.py"), run_name="__main__")
    assert stopped.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: {name}")
    assert not list(tmp_path.iterdir())


def test_notes_are_counted_over_folders(tmp_path, monkeypatch, capsys):
    written = Score(tuple(Note(time, time + 0.5, 60) for time in range(4)))
    brushed = Note(0.1, 0.14, 61)
    for folder, notes in (("a", (*written.notes, brushed)), ("b", written.notes[1:])):
        (tmp_path / folder).mkdir()
        write_midi(written, tmp_path / folder / "wanted.mid")
        write_midi(Score(notes), tmp_path / folder / "played.mid")
    monkeypatch.syspath_prepend(str(TOOLS))
    monkeypatch.setattr(sys, "argv", ["count_notes", str(tmp_path)])
    runpy.run_path(str(TOOLS / "count_notes.py"), run_name="__main__")
    printed = " ".join(capsys.readouterr().out.split())
    assert f"25.0 extra 0.0 missed {tmp_path / 'a'}" in printed
    assert "8 written notes, 7 played in time; per 100:" in printed
    assert "a key beside a right one 1 12.5 shorter than 60 ms 1 12.5" in printed
    assert "key never sounds 1 12.5" in printed


def test_what_is_the_same_in_all_songs_has_no_weight_in_their_difficulty(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    tool = runpy.run_path(str(TOOLS / "fit_difficulty.py"))
    features = np.random.default_rng(0).uniform(0.0, 3.0, (20, 8))
    features[:, 6] = 0.0  # no fingers cross
    weights = tool["fitted_model"](features, 2.0 * np.log1p(features[:, 0]) - 3.0).weights
    assert weights.crossings == 0
    assert weights.notes == max(astuple(weights)) > 0
