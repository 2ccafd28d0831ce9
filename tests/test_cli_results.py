"""`cadenza results`."""

import os
from pathlib import Path

import pytest

from cadenza.cli import main
from evaluation.made_up import write_bench
from refusals import refused


@pytest.fixture
def bench(tmp_path):
    write_bench(tmp_path / "bench", pieces=3, agents=("planner", "ilqg"), seeds=2)
    return tmp_path / "bench"


def test_a_page_and_tables_are_left_and_agents_told(bench, capsys):
    (bench / "runs" / "begun").mkdir()
    main(["results", str(bench)])
    left = {path.name for path in (bench / "results").iterdir()}
    assert left == {"index.html", "agents.csv", "pieces.csv", "runs.csv"}
    told = capsys.readouterr().out
    assert "planner" in told
    assert "1 run is not finished." in told
    assert told.endswith(f"Open {bench / 'results' / 'index.html'}\n")


def test_folders_may_have_names_that_are_no_text(bench, tmp_path):
    strange = bench.rename(tmp_path / os.fsdecode(b"b\xfc"))
    main(["results", str(strange), "-o", str(tmp_path / "out")])
    assert "b%FC/runs/" in (tmp_path / "out" / "index.html").read_text()


def test_another_folder_and_a_figure(bench, tmp_path):
    main(["results", str(bench), "-o", str(tmp_path / "out"), "--figure", str(tmp_path / "f.svg")])
    assert (tmp_path / "out" / "index.html").exists()
    assert (tmp_path / "f.svg").read_text().startswith("<svg")
    assert not (bench / "results").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "nowhere: holds no runs; give the folder of a bench"),
        (["bench", "--figure", "f.png"], "f.png: the figure is an .svg picture"),
        (["empty"], "empty: no run is finished"),
    ],
)
def test_what_cannot_be_summed_up(bench, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(bench.parent)
    Path("empty", "runs").mkdir(parents=True)
    assert said in refused(capsys, "results", *arguments)
