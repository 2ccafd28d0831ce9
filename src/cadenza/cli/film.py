"""`cadenza film`: a film of a performance, or its sound, to share."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from cadenza.cli.arguments import Output, Quiet, SoundFont


@dataclass(frozen=True)
class Film:
    """Make a film of a folder that "cadenza play" wrote, or the sound alone.

    Example: cadenza film played/OdeToJoy/planner --size 1080 1920 --seconds 20

    The film is the page of the performance, drawn by Chrome, Chromium or Edge: 60 pictures a
    second with a graphics card; without one 30, at half a second of a core each.
    """

    folder: tyro.conf.Positional[Path]
    """The folder of a performance."""
    output: Output[Path | None] = None
    """The file: a film by the ending .mp4, or the sound alone by .wav, .flac or .mp3; video.mp4 in
    the folder by default."""
    start: float = 0.0
    """Where in the performance the film begins [s]."""
    seconds: float | None = None
    """Length; to the end by default."""
    size: tuple[int, int] = (1920, 1080)
    """Width and height [px], up to 2160."""
    camera: str = "player"
    """player, close, top, audience or side."""
    score: bool = False
    """Show the score below the hands."""
    sound_font: SoundFont = None
    quiet: Quiet = False


def run(command: Film) -> None:
    from cadenza.cli.saving import film
    from cadenza.performing.filming import Look
    from cadenza.report.sound import voice_of

    look = Look(*command.size, command.camera, command.score, command.start, command.seconds)
    film(command.folder, voice_of(command.sound_font), command.output, look)
