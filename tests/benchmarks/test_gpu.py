"""The benchmark for GPUs, on the CPU."""

import csv
import sys

import pytest

pytestmark = pytest.mark.slow  # it compiles for a minute
pytest.importorskip("mujoco_warp")


def test_writes_a_table(tmp_path, monkeypatch):
    from benchmarks import gpu

    table = tmp_path / "gpu.csv"
    command = ["gpu", "--worlds", "2", "--steps", "3", "--output", str(table)]
    monkeypatch.setattr(sys, "argv", command)
    gpu.main()
    with table.open() as file:
        random, skilled = csv.DictReader(file)
    assert (random["actions"], skilled["actions"]) == ("random", "skilled")
    assert int(random["steps_per_second"]) > 0 < int(skilled["steps_per_second"])
    assert random["unstable"] == random["overflow"] == skilled["overflow"] == "0"
