"""The policies that come with the package."""

from contextlib import closing
from pathlib import Path

import pytest

from cadenza.agents.rollout import play_episode
from cadenza.learning import pretrained
from cadenza.learning.policy_folder import load_policy
from cadenza.music.libraries.library import songs
from cadenza.tasks.piano_task import PianoTask

FOLDERS = sorted(
    path.parent for path in Path(pretrained.__file__).parent.glob("*/policy.safetensors")
)


def test_there_are_three_and_they_are_small():
    assert len(FOLDERS) >= 3
    for folder in FOLDERS:
        assert folder.name in {piece.name for piece in songs()}
        assert sum(path.stat().st_size for path in folder.iterdir()) < 3e6


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_they_play_what_they_have_learnt(folder):
    learnt = load_policy(folder)
    with closing(PianoTask([learnt.score], learnt.task, learnt.scene)) as task:
        metrics = play_episode(task, learnt.agent).metrics
    assert metrics["f1"] >= 0.98
    assert metrics["note_onset_f1"] >= 0.98
