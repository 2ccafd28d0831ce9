"""Demonstrations of a few notes, made once."""

import shutil
from pathlib import Path

import pytest

from cadenza.evaluation.collecting.variation import Variation
from demonstrations.made import collected


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """The folder of two episodes, one with noise; nobody changes it."""
    folder = tmp_path_factory.mktemp("demonstrations")
    collected(folder, Variation(noise=0.2, mirror=False), episodes=2)
    return folder


@pytest.fixture
def copied(made, tmp_path):
    """The same, to be damaged."""
    return Path(shutil.copytree(made, tmp_path / "copied"))
