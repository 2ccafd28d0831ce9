"""Compares performances: `python -m cadenza.studio.comparison FOLDER FOLDER PAGE`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from cadenza.episode import load_episode
from cadenza.files import read_json
from cadenza.report.comparison_page import Run, compared, comparison_page
from cadenza.report.html_pages import write_page
from cadenza.studio.limits import PLAYING, limit
from cadenza.studio.request import AGENTS, hand_titles
from cadenza.studio.storage import ABOUT, KeptPerformance


def compared_run(folder: Path, number: int) -> Run:
    """Returns what is compared of a performance."""
    metrics = read_json(folder / "metrics.json", dict[str, Any])
    settings = read_json(folder / "settings.json", dict[str, Any])
    agent = read_json(folder / ABOUT, KeptPerformance).request.agent
    episode = load_episode(folder / "episode.npz")
    title, _ = AGENTS.get(agent, (agent, ""))  # as the page calls it
    hand = settings["scene"]["hand"]
    name = f"{number}. {title}, {hand_titles().get(hand, hand)}"
    figures = compared(metrics, episode.num_steps * episode.dt)
    return Run(name, settings["seed"], figures, episode)


def main() -> None:
    """Writes the page that the command line names, of the performances before it."""
    limit(PLAYING)
    *folders, page = map(Path, sys.argv[1:])
    page.parent.mkdir(exist_ok=True)
    runs = [compared_run(folder, i) for i, folder in enumerate(folders, start=1)]
    write_page(page, comparison_page(runs))


if __name__ == "__main__":
    main()
