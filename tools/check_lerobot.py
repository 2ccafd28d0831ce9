"""Loads an export with the real LeRobot package, which is none of our dependencies.

cadenza dataset export demonstrations --format lerobot --video-cameras back -o exported
python -m venv /tmp/lerobot && /tmp/lerobot/bin/pip install 'lerobot>=0.4,<0.5'
HF_HUB_OFFLINE=1 /tmp/lerobot/bin/python tools/check_lerobot.py exported
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from lerobot.datasets.lerobot_dataset import LeRobotDataset


def check(folder: Path) -> None:
    info = json.loads((folder / "meta/info.json").read_text())
    dt = 1 / info["fps"]
    ahead = {"action": [0.0, dt, 2 * dt]}  # chunks of actions, as its policies ask for
    dataset = LeRobotDataset(
        "cadenza/demonstrations",
        root=folder,
        delta_timestamps=ahead,
        video_backend="pyav",  # its own needs FFmpeg on the machine
    )
    assert len(dataset) == info["total_frames"]
    assert dataset.num_episodes == info["total_episodes"]
    for index in (0, len(dataset) // 2, len(dataset) - 1):
        frame = dataset[index]
        for name, feature in info["features"].items():
            shape = [3, *feature["shape"]] if name == "action" else feature["shape"]
            if feature["dtype"] == "video":
                shape = [3, *feature["shape"][:2]]  # colours first, as PyTorch has them
            assert [*frame[name].shape] == (shape if shape != [1] else []), name
        print(
            index, frame["task"], *(f"{name} {[*frame[name].shape]}" for name in info["features"])
        )
    print(f"{folder}: {dataset.num_episodes} episodes, {len(dataset)} frames")


if __name__ == "__main__":
    check(Path(sys.argv[1]))
