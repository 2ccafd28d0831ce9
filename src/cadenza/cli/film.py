"""`cadenza film`: a film, a moving picture or the sound of a performance, to share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from cadenza.cli.arguments import Output, Quiet, SoundFont


@dataclass(frozen=True)
class Film:
    """Make a film of a folder that "cadenza play" wrote, or a moving picture, or the sound alone.

    Example: cadenza film played/OdeToJoy/planner -o joy.gif --start 3
    """

    folder: tyro.conf.Positional[Path]
    """The folder of a performance."""
    output: Output[Path | None] = None
    """The file; its ending says what it is: .mp4 a film, .gif or .webp a moving picture, .wav,
    .flac or .mp3 the sound alone. video.mp4 in the folder by default."""
    start: float = 0.0
    """Begin so many seconds into what was played."""
    seconds: float | None = None
    """Length; to the end by default, and of a moving picture 6 s."""
    size: tuple[int, int] | None = None
    """Width and height [px], up to 2160; 1280 x 720 by default, and of a moving picture 640 x 360.
    A tall film goes with the hands."""
    fps: int | None = None
    """Pictures a second; 60 by default, and of a moving picture 20."""
    sound_font: SoundFont = None
    quiet: Quiet = False


def run(command: Film) -> None:
    from cadenza.cli.saving import film
    from cadenza.performing.film_renderer import Look
    from cadenza.performing.filming import FILM, FilmExcerpt, look_of
    from cadenza.report.sound_font import voice_of

    path = command.output or command.folder / FILM
    look = look_of(path)
    size = command.size or (look.width, look.height)
    look = Look(*size, look.fps if command.fps is None else command.fps)
    excerpt = FilmExcerpt(command.start, command.seconds)
    film(command.folder, voice_of(command.sound_font), path, look, excerpt)
