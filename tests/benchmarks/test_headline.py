"""The paper's headline figure, of benches whose pieces a table describes."""

import csv
import sys
from pathlib import Path

import pytest

from benchmarks import headline
from evaluation.made_up import result, write_result


@pytest.fixture
def benches(tmp_path):
    metrics = {"f1": 0.9, "note_onset_f1": 0.8, "onset_error_median": 0.004}
    for split, names in {"valid": ["a"], "train": ["b", "c"]}.items():
        for name in names:
            content = result(f"{split}/{name}.mid", "planner", 0, metrics)
            write_result(tmp_path / f"bench-{split}", name, content)
    return [str(tmp_path / f"bench-{split}") for split in ("valid", "train")]


def draw(benches: list[str], folder: Path, pieces: str, patch: pytest.MonkeyPatch) -> None:
    table = folder / "index.csv"
    lines = [f"{name},Nocturne {name},Field,op. 1,CC BY 4.0,somewhere" for name in pieces]
    table.write_text("\n".join(["id,title,composer,opus,licence,source", *lines]))
    words = [*benches, "--index", str(table), "-o", str(folder / "out")]
    patch.setattr(sys, "argv", ["headline", *words])
    headline.main()


def test_splits_are_drawn_apart_and_pieces_have_their_titles_and_sources(
    benches, tmp_path, monkeypatch
):
    draw(benches, tmp_path, "abc", monkeypatch)
    out = tmp_path / "out"
    assert "Nocturne a" in (out / "headline-valid.svg").read_text()
    assert "Nocturne b: F1 0.900" in (out / "headline-train.svg").read_text()
    with (out / "headline.csv").open() as file:
        rows = list(csv.DictReader(file))
    found = [(row["split"], row["title"], row["licence"], row["onset_error"]) for row in rows]
    assert found == [
        ("valid", "Nocturne a", "CC BY 4.0", "4.0"),
        ("train", "Nocturne b", "CC BY 4.0", "4.0"),
        ("train", "Nocturne c", "CC BY 4.0", "4.0"),
    ]


def test_a_piece_that_the_table_lacks_is_named(benches, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit):
        draw(benches, tmp_path, "ab", monkeypatch)
    assert "c: is not in the table" in capsys.readouterr().err
