"""The programs in tools/: that all say what they do, and what no other test looks at."""

import runpy
import sys
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score

TOOLS = Path(__file__).parents[1] / "tools"
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
