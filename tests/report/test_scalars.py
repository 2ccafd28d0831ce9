"""Figures for TensorBoard and Weights & Biases."""

import re
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from cadenza.errors import CadenzaError
from cadenza.installing import install_line
from cadenza.report.scalars import TensorBoard, WeightsAndBiases


def test_a_run_of_weights_and_biases_goes_by_its_id(tmp_path, monkeypatch):
    """And not by the name of its folder, which others have too."""
    asked: list[dict[str, Any]] = []
    logged: list[dict[str, float]] = []
    run = SimpleNamespace(log=logged.append, finish=lambda: None)
    fake = SimpleNamespace(init=lambda **options: asked.append(options) or run)
    monkeypatch.setitem(sys.modules, "wandb", fake)
    scalars = WeightsAndBiases("project", tmp_path / "a" / "run", "0123", {"seed": 1})
    scalars.add({"step": 5, "seconds": 1.0})
    scalars.close()
    assert asked == [
        {
            "project": "project",
            "dir": str(tmp_path / "a" / "run"),
            "id": "0123",
            "resume": "allow",
            "config": {"seed": 1},
        }
    ]
    assert logged == [{"seconds": 1.0, "control_steps": 5}]


def test_nobody_knows_the_name_of_the_next_file(tmp_path):
    """It would be written through a link of that name."""
    for _ in range(3):
        TensorBoard(tmp_path, 0).close()
    names = [path.name for path in tmp_path.iterdir()]
    assert len({name.rsplit(".", 1)[1] for name in names}) == 3


def test_packages_that_are_missing_are_told_with_how_to_install_them(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)  # importing it fails
    with pytest.raises(CadenzaError, match=f"training needs .*{re.escape(install_line('train'))}"):
        TensorBoard(tmp_path, 0)
