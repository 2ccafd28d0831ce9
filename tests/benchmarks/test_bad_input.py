"""Benchmarks and tools say in a line what is wrong with what they are given."""

from __future__ import annotations

import importlib
import runpy
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
BAD = {
    "drills": ["nowhere/best"],
    "learning": ["Nope"],
    "multitask": ["--songs", "100"],
    "physics": ["nowhere.npz"],
    "planners": ["Nope"],
    "related": ["--settings", "Nope"],
    "repertoire": ["Nope"],
    "robustness": ["Nope"],
    "speed": ["nowhere.npz"],
}
BAD_OF_TOOLS = {
    "fit_difficulty": ["play", "Nope", "-o", "rows.jsonl"],
    "fit_fingering": ["Nope", "-o", "rows.jsonl"],
    "fit_jumps": ["play", "jumps.jsonl", "--hand", "Nope"],
    "measure_reach": ["Nope"],
}


@pytest.mark.parametrize("name", BAD)
def test_a_benchmark_says_what_is_wrong(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [name, *BAD[name]])
    with pytest.raises(SystemExit) as stopped:
        importlib.import_module(f"benchmarks.{name}").main()
    assert stopped.value.code == 2
    assert "error: " in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("name", BAD_OF_TOOLS)
def test_a_tool_says_what_is_wrong(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(TOOLS))
    monkeypatch.setattr(sys, "argv", [name, *BAD_OF_TOOLS[name]])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(TOOLS / f"{name}.py"), run_name="__main__")
    assert stopped.value.code == 2
    assert "error: " in capsys.readouterr().err.splitlines()[-1]
