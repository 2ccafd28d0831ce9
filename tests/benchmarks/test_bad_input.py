"""Benchmarks and tools say in a line what is wrong with what they are given."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

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
    "tools/measure_reach.py": ["Nope"],
}


@pytest.mark.parametrize("program", BAD)
def test_a_program_says_what_is_wrong(
    program: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [program, *BAD[program]])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(ROOT / program), run_name="__main__")
    assert stopped.value.code == 2
    assert "error: " in capsys.readouterr().err.splitlines()[-1]
