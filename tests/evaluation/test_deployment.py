"""The benchmark's track of robots that nobody knows."""

import json

import numpy as np
import pytest

from cadenza.cli import main
from cadenza.errors import CadenzaError
from cadenza.evaluation.benchmark import definition, deployment, entry
from cadenza.evaluation.benchmark.definition import DEPLOYMENT, frozen, open_set
from cadenza.evaluation.benchmark.entering import enter
from cadenza.evaluation.benchmark.entry import ENTRY, actions_path, read_entry
from cadenza.files import ANY, read_tensors, write_tensors
from cadenza.performing import with_robot
from cadenza.tasks import unknown_robot

SONG = "TwinkleTwinkleLittleStar"
ABOUT = {"songs": DEPLOYMENT, "track": DEPLOYMENT, "about": "learnt from nothing", "by": "us"}


@pytest.fixture
def short(monkeypatch):
    """One song, one robot, one play before the one that counts."""
    monkeypatch.setattr(definition, "_DEPLOYED", (SONG,))
    for module in entry, deployment:
        monkeypatch.setattr(module, "ROBOTS", 1)
    for module in unknown_robot, with_robot, deployment:
        monkeypatch.setattr(module, "PLAYS", 1)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_what_was_practised_is_entered_and_verified(tmp_path, capsys):
    with pytest.raises(CadenzaError, match="was not played on robot 0; cadenza practice"):
        enter(tmp_path, tmp_path / "none", **ABOUT)
    main(["practice", SONG, "--robot", "0", "-o", str(tmp_path / "bench" / "0")])
    folder = tmp_path / "entry"
    enter(tmp_path / "bench", folder, **ABOUT)
    main(["verify", str(folder)])
    assert "verified, practice-with-robots in deployment" in capsys.readouterr().out
    text = json.loads((folder / ENTRY).read_text())
    assert "latency" not in str(text)
    path = actions_path(folder, SONG, 0)
    actions = read_tensors(path, ANY, 2**24)[0]["action"]
    write_tensors(path, {"action": np.roll(actions, 5, axis=0)})
    with pytest.raises(SystemExit):
        main(["verify", str(folder)])


def test_its_songs_are_bundled_and_its_seeds_are_all_robots(tmp_path):
    names = [song.name for song in open_set(DEPLOYMENT).songs]
    assert len(names) == 6
    assert set(names) <= frozen().songs.keys()
    metrics = dict.fromkeys(definition.METRICS, 0.5)
    runs = [{"song": SONG, "seed": 0, "song_digest": "", "metrics": metrics}]
    facts = {"benchmark": 1, "name": "n", "agent": "a", "options": {}, "fingering": "none"}
    facts |= {"versions": {}, "runs": runs, **ABOUT}
    for change, message in (
        ({}, "they are the robots 0 to 9"),
        ({"track": "planning"}, "is a track and its songs"),
    ):
        (tmp_path / ENTRY).write_text(json.dumps(facts | change))
        with pytest.raises(CadenzaError, match=message):
            read_entry(tmp_path)
