"""The comparison with the robots before: that rows are measured once, and printed as tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import related
from benchmarks.table import write_table
from cadenza.agents.agent import RandomAgent
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig


@pytest.fixture(autouse=True)
def short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tune = Score((Note(0.0, 0.3, 72),), (), "A tune")
    setting = related.Setting(
        "hands that wave",
        RandomAgent,
        SceneConfig(hands="right"),
        open_loop=True,
        disturbances=related.ALL,
    )
    monkeypatch.setattr(related, "PIECES", {"tune": lambda: tune})
    monkeypatch.setattr(related, "SETTINGS", {"waving": setting})
    monkeypatch.setattr(related, "RESULTS", tmp_path / "related.csv")


def test_what_is_known_is_not_measured_again() -> None:
    for row in related.rows("waving", 1, known=()):
        write_table(related.RESULTS, [*related.read(), row])
    table = related.read()
    assert [row["disturbance"] for row in table] == [
        disturbance.name for disturbance in related.ALL
    ]
    known = {(r["setting"], r["piece"], r["disturbance"], r["seed"]) for r in table[:3]}
    (missing,) = related.rows("waving", 1, known)
    kept = [name for name in missing if not name.endswith("cpu_seconds")]
    assert {n: str(missing[n]) for n in kept} == {n: table[3][n] for n in kept}


def test_tables_show_means(monkeypatch: pytest.MonkeyPatch) -> None:
    base = {"setting": "waving", "piece": "tune", "note_onset_f1": "0.5", "music_seconds": "2"}
    base |= {"prepare_cpu_seconds": "0.5", "cpu_seconds": "1"}
    table = [
        base | {"disturbance": each.name, "f1": f1}
        for each, f1 in (
            (related.NOTHING, "0"),
            (related.NOTHING, "1"),
            (related.STRONG, "4"),
        )
    ]
    lines = list(related.tables(table))
    assert lines[-1] == "| hands that wave | 0.500 · 0.500 |  | 4.000 · 0.500 |  |"
    setting = replace(related.SETTINGS["waving"], open_loop=False)
    monkeypatch.setitem(related.SETTINGS, "waving", setting)
    assert "| hands that wave | 0.500 | 0.500 | 0.500 | 0.25 | 0.50 |" in related.tables(table)
