"""Draws robots of docs/related.md at their pianos.

    python tools/draw_related.py [NAME ...]

writes docs/related/NAME.webp.
"""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path
from typing import Any

from PIL import Image

import cadenza
from cadenza.files import write_atomically
from cadenza.music.libraries.library import load_score
from cadenza.sim.render import Picture, Renderer

FOLDER = Path(__file__).parents[1] / "docs" / "related"
SONG, SECONDS = "TwinkleTwinkleLittleStar", 3.0
PICTURE = Picture(960, 540, "back")  # twice as wide and high as what is written
ROBOTS: dict[str, dict[str, Any]] = {  # what `cadenza.play` is told beside the song
    "shadow": {"agent": "stitched"},
}


def draw(name: str) -> None:
    """The end of the first seconds of a song."""
    performance = cadenza.play(load_score(SONG).beginning(SECONDS), **ROBOTS[name])
    episode = performance.episode
    names = ("hand_qpos", "key_qpos", "key_activation", "goal_keys")
    with closing(Renderer(performance.scene, PICTURE)) as renderer:
        pixels = renderer.frame(*(episode[each][-3] for each in names))
    picture = Image.fromarray(pixels).resize((PICTURE.width // 2, PICTURE.height // 2))
    with write_atomically(FOLDER / f"{name}.webp") as file:
        picture.save(file, "webp", quality=70)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("robots", nargs="*", metavar="NAME", help=f"of {', '.join(ROBOTS)}")
    names = parser.parse_args().robots or list(ROBOTS)
    if unknown := sorted({*names} - ROBOTS.keys()):
        parser.error(f"no robot {unknown[0]!r}: choose from {', '.join(ROBOTS)}")
    for name in names:
        draw(name)


if __name__ == "__main__":
    main()
