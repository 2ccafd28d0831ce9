"""The comparison with the robots before: that rows are measured once."""

import pytest

from benchmarks import related
from cadenza.agents.agent import RandomAgent
from cadenza.evaluation.tables import write_csv
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig


@pytest.fixture(autouse=True)
def short(tmp_path, monkeypatch):
    tune = Score((Note(0.0, 0.3, 72),), (), "A tune")
    setting = related.Setting(
        RandomAgent, SceneConfig(hands="right"), open_loop=True, disturbances=related.DISTURBANCES
    )
    monkeypatch.setattr(related, "PIECES", {"tune": lambda: tune})
    monkeypatch.setattr(related, "SETTINGS", {"waving": setting})
    monkeypatch.setattr(related, "RESULTS", tmp_path / "related.csv")


def test_what_is_known_is_not_measured_again():
    for row in related.rows("waving", 1, known=()):
        write_csv(related.RESULTS, [*related.read(), row])
    table = related.read()
    assert [row["disturbance"] for row in table] == [*related.DISTURBANCES]
    known = {(r["setting"], r["piece"], r["disturbance"], r["seed"]) for r in table[:3]}
    (missing,) = related.rows("waving", 1, known)
    kept = [name for name in missing if not name.endswith("cpu_seconds")]
    assert {n: str(missing[n]) for n in kept} == {n: table[3][n] for n in kept}
