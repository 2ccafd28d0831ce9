"""Reinforcement of the generalist's networks goes on where it was stopped, and they can play."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cadenza.agents.planner.search.networks.weights import Weights

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_it_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    def rounds_made(rounds: int) -> tuple[int, dict[str, np.ndarray]]:
        tool = ROOT / "tools/reinforce_generalist.py"
        command = [sys.executable, str(tool), "bundled", "-o", str(tmp_path), "--most", "1"]
        environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "JAX_PLATFORMS": "cpu"}
        subprocess.run([*command, "--rounds", str(rounds)], check=True, env=environment)
        with np.load(tmp_path / "checkpoint.npz") as checkpoint:
            made = int(checkpoint["rounds"])
        return made, Weights.load(tmp_path / "weights.npz").arrays

    made, first = rounds_made(1)
    again, same = rounds_made(1)
    assert made == again == 1
    assert all(np.array_equal(first[name], same[name]) for name in first)
    made, later = rounds_made(9)  # in the first eight, only values are learnt
    assert made == 9
    assert any(not np.array_equal(first[name], later[name]) for name in first)
