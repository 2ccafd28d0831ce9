"""What the how-to pages tell people to write works, in a package of its own."""

import json
import re
import shutil
import socket
import sys
import threading
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import cadenza
from cadenza.agents.robot.simulated import SimulatedRobot
from cadenza.cli import main
from cadenza.music.formats.midi import write_midi
from cadenza.tasks.unknown_robot import PLAYS, UnknownRobotEnv

PAGES = Path(__file__).parents[1] / "docs" / "how-to"
TUNE = cadenza.Score((cadenza.Note(0.0, 0.25, 60), cadenza.Note(0.25, 0.5, 62)), title="Tune")

Follow = Callable[[str], None]


@pytest.fixture
def follow(tmp_path, monkeypatch):
    """Write and install the modules of a page; the first line of each block names its file."""
    site = tmp_path / "site"
    written = set()

    def follow(page: str) -> None:
        text = (PAGES / f"{page}.md").read_text()
        for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            if named := re.match(r"# (\S+\.py)\n", code):
                path = site / named[1]
                path.parent.mkdir(parents=True, exist_ok=True)
                written.add(named[1].split("/")[0].removesuffix(".py"))
            with path.open("a") as file:
                file.write(code + "\n\n")
        project = tomllib.loads("".join(re.findall(r"```toml\n(.*?)```", text, re.DOTALL)))
        monkeypatch.syspath_prepend(site)
        if not project:
            return
        about = site / f"{project['project']['name']}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {project['project']['name']}\nVersion: 1.0\n"
        )
        groups = project["project"]["entry-points"].items()
        points = (
            f"[{group}]\n" + "".join(f"{name} = {place}\n" for name, place in entries.items())
            for group, entries in groups
        )
        (about / "entry_points.txt").write_text("".join(points))
        monkeypatch.syspath_prepend(site)

    monkeypatch.chdir(tmp_path)
    write_midi(TUNE, tmp_path / "tune.mid")
    yield follow
    for module in written:
        sys.modules.pop(module, None)


def test_a_song_library(follow, capsys):
    follow("song-library")
    Path("site/studies/songs").mkdir()
    write_midi(TUNE, Path("site/studies/songs/thirds.mid"))
    main(["songs"])
    assert capsys.readouterr().out.splitlines()[-1].startswith("studies/thirds ")
    assert cadenza.load_song("studies/thirds").notes == TUNE.notes


def test_an_agent(follow):
    follow("agent")
    main(["play", "tune.mid", "--agent", "waving", "--no-video", "-o", "out"])
    tips = cadenza.load_episode(Path("out/episode.npz"))["fingertip_xpos"][:, 1, 2]
    assert np.ptp(tips) > 0.01
    main(["play", "tune.mid", "--agent", "waving:Beat", "--beat.tempo", "90", "-o", "beat"])
    assert json.loads(Path("beat/settings.json").read_text())["beat"] == {"tempo": 90.0}
    steps = [cadenza.play(TUNE, "waving:StepsEach", seed=seed) for seed in (3, 3, 4)]
    first, again, other = (performance.episode["action"] for performance in steps)
    np.testing.assert_array_equal(first, again)
    assert len(np.unique(first, axis=0)) == 2  # 21 steps
    assert (first != other).any()


def test_a_hand(follow):
    follow("hand")
    assert cadenza.play(TUNE, "zero", scene=cadenza.SceneConfig(keyboard="narrow:NARROW")).episode
    shutil.copy(PAGES.parents[1] / "examples" / "claw.py", "site")
    performance = cadenza.play(TUNE, scene=cadenza.SceneConfig(hand="claw"))
    assert performance.metrics["f1"] > 0.9
    assert performance.episode["fingertip_xpos"].shape[-2:] == (6, 3)


def test_a_learner(follow):
    follow("learner")
    options = ["--num-steps", "200", "--learning-starts", "64", "--log-interval", "50"]
    options += ["--train-freq", "8", "--batch-size", "16", "--no-video"]
    train = ["train", "tune.mid", "--learner", "regression", "--step-size", "0.05", *options]
    main([*train, "-o", "run"])
    rows = [json.loads(line) for line in Path("run/metrics.jsonl").read_text().splitlines()]
    losses = [row["train/loss"] for row in rows if "train/loss" in row]
    assert losses[-1] < losses[0]
    main([*train, "-o", "stopped", "--num-steps", "104"])
    main(["train", "--resume", "stopped", "--num-steps", "200", "--no-video"])
    last = [Path(run, "last/policy.safetensors").read_bytes() for run in ("run", "stopped")]
    assert last[0] == last[1]


def test_a_robot(follow: Follow) -> None:
    follow("robot")
    robot = SimulatedRobot(UnknownRobotEnv(TUNE, robot=1))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other_end:
        other_end.bind(("127.0.0.1", 9750))

        def answer() -> None:
            plays = 0
            while plays <= PLAYS:
                words, sender = other_end.recvfrom(65536)
                message = json.loads(words)
                if "start" in message:
                    robot.start()
                if "action" in message:
                    robot.send(np.array(message["action"]))
                plays += "stop" in message
                state = {"joints": robot.read().tolist(), "messages": robot.messages()}
                other_end.sendto(json.dumps(state).encode(), sender)

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        main(["practice", "tune.mid", "--robot", "udp_robot:Hands", "-o", "hands"])
        thread.join(5.0)
    scores = json.loads(Path("hands/robot.json").read_text())["scores"]
    assert len(scores) == PLAYS + 1
    assert max(sum(each) for each in scores) > sum(scores[0]) or sum(scores[0]) == 2.0
