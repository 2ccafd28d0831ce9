"""Benchmarks and tools say in a line what is wrong with what they are given."""

import runpy
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

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
