"""Plays what the front page of the site shows: `python docs/gallery.py FOLDER`.

`make docs` runs it when Cadenza has changed. It takes a minute and a half of one core.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

import cadenza
from cadenza.agents.planner.config import PlannerConfig
from cadenza.errors import CadenzaError
from cadenza.files import write_json
from cadenza.music.libraries.library import load_score
from cadenza.performing.performance import Performance
from cadenza.sim.render import Picture, Renderer
from cadenza.sim.threads import available_cores

LISTED = "gallery.json"
_PICTURE = Picture(480, 270)
_PICTURED = 5.0  # [s] of music at which it is taken


@dataclass(frozen=True)
class Played:
    """A performance of the gallery."""

    name: str
    who: str
    song: str
    seconds: float = 60.0
    """How much of the song is played [s]."""
    effort: float = 0.0
    """How long the planner practises it."""
    options: dict[str, Any] = field(default_factory=dict)
    """Arguments of `cadenza.play`."""

    def play(self) -> Performance:
        options = self.options
        if self.effort:
            config = PlannerConfig(effort=self.effort)
            options = options | {"agent": cadenza.make_agent("planner", config)}
        return cadenza.play(load_score(self.song).until(self.seconds), **options)


GALLERY = (
    Played("planner", "The planner", "FurEliseOpening"),
    Played("practised", "The planner, after practice", "MoonlightOpening", 14.4, 0.5),
    Played("generalist", "The generalist", "Greensleeves", options={"agent": "generalist"}),
    Played("allegro", "Allegro Hands", "MaryHadALittleLamb", options={"setup": "allegro"}),
    Played("arms", "Hands on arms", "OdeToJoy", options={"setup": "arm-allegro"}),
    Played(
        "sampling",
        "Predictive sampling, to compare with",
        "FurEliseOpening",
        options={"agent": "predictive-sampling"},
    ),
)
"""In the order of the front page; the first plays there."""


def add(played: Played, folder: Path) -> dict[str, Any]:
    """Writes the page of a performance, NAME.html, and a picture, NAME.webp, where it can be drawn.

    Returns:
        What the front page says of it.
    """
    performance = played.play()
    episode = performance.episode
    with TemporaryDirectory() as results:
        performance.save(results)
        (folder / f"{played.name}.html").write_bytes((Path(results) / "report.html").read_bytes())
    try:
        with closing(Renderer(performance.scene, _PICTURE)) as renderer:
            shown = ("hand_qpos", "key_qpos", "key_activation", "goal_keys")
            row = min(round(_PICTURED / episode.dt), episode.num_steps - 1)
            frame = renderer.frame(*(episode[name][row] for name in shown))
    except CadenzaError as error:
        print(f"{played.name} without a picture: {error}", file=sys.stderr)
    else:
        Image.fromarray(frame).save(folder / f"{played.name}.webp")
    (song,) = (song for song in cadenza.songs() if song.name == played.song)
    return {
        "name": played.name,
        "who": played.who,
        "song": song.title,
        "composer": song.composer,
        "f1": performance.metrics["f1"],
        "picture": (folder / f"{played.name}.webp").exists(),
    }


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(available_cores(), get_context("spawn")) as pool:
        listed = list(pool.map(add, GALLERY, [folder] * len(GALLERY)))
    write_json(folder / LISTED, listed)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
