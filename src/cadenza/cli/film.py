"""`cadenza film`: the film of a performance, to share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from cadenza.cli.arguments import Quiet


@dataclass(frozen=True)
class Film:
    """Make video.mp4, with sound, of a folder that "cadenza play" wrote.

    Example: cadenza film played/OdeToJoy/planner --size 720 1280
    """

    folder: tyro.conf.Positional[Path]
    """The folder of a performance."""
    size: tuple[int, int] = (1280, 720)
    """Width and height [px], up to 2160. A tall film goes with the hands."""
    fps: int = 60
    """Pictures a second."""
    quiet: Quiet = False


def run(command: Film) -> None:
    from cadenza.cli.saving import film
    from cadenza.performing.film_renderer import Look

    film(command.folder, Look(*command.size, command.fps))
