"""Plays what the front page of the site shows: `python docs/gallery.py FOLDER`.

`make docs` runs it when Cadenza has changed. It takes a minute and a half of one core.

`make films` adds films of what was practised, where a Chrome or Chromium is. That takes a minute
or more a film without a graphics card, so that `make docs` leaves it out.

What was practised lies in `practised/`, made by `cadenza practice SONG --first-seconds 12 --effort
2 --num-threads 1 -o FOLDER/SONG` (the last two: 10 s, effort 0.8) and `python docs/gallery.py keep
FOLDER/SONG`. It is only played back here; in other physics it would not play the same.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

import cadenza
from cadenza.agents.playback import PLAN, Playback, load_plan
from cadenza.errors import CadenzaError
from cadenza.files import TENSORS, read_tensors, write_json, write_tensors
from cadenza.music.libraries.library import load_score
from cadenza.performing.filming import Look, write_film
from cadenza.performing.performance import Performance
from cadenza.sim.render import Picture, Renderer
from cadenza.sim.threads import available_cores

LISTED = "gallery.json"
PRACTISED = Path(__file__).with_name("practised")
_SIZE = 480, 270  # [px] of pictures
_FILM = Look(960, 540, seconds=8.0)
_PICTURED = 5.0  # [s] of music at which it is taken


@dataclass(frozen=True)
class Played:
    """A performance of the gallery."""

    name: str
    who: str
    song: str
    options: dict[str, Any] = field(default_factory=dict)
    """Arguments of `cadenza.play`."""
    camera: str = "close"
    """Of its picture."""

    def play(self) -> Performance:
        return cadenza.play(load_score(self.song), **self.options)


@dataclass(frozen=True)
class Practised:
    """A performance that practice has reached, which is played back."""

    song: str
    who: str = "The planner, after practice"
    camera: str = "close"

    @property
    def name(self) -> str:
        return self.song

    def play(self) -> Performance:
        plan = load_plan(PRACTISED / (self.song + TENSORS))
        performance = cadenza.play(plan.score, agent=Playback(plan.actions))
        settings = performance.settings | {"agent": "planner, practised"}
        return replace(performance, settings=settings)


GALLERY = (
    Practised("FurEliseOpening"),
    Practised("SonataFacileOpening"),
    Practised("MinuetInG"),
    Practised("BachPreludeInCMajor"),
    Practised("MoonlightOpening"),
    Practised("InTheHallOfTheMountainKing"),
    Played("planner", "The planner, at first sight", "JingleBells"),
    Played("generalist", "The generalist", "Greensleeves", {"agent": "generalist"}),
    Played("arms", "Allegro Hands on arms", "OdeToJoy", {"setup": "arm-allegro"}, "audience"),
    Played(
        "sampling",
        "Predictive sampling, to compare with",
        "FurEliseOpening",
        {"agent": "predictive-sampling"},
    ),
)
"""In the order of the front page; the first plays there."""


def add(played: Played | Practised, folder: Path) -> dict[str, Any]:
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
        with closing(Renderer(performance.scene, Picture(*_SIZE, played.camera))) as renderer:
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
        "verdict": performance.verdict,
        "picture": (folder / f"{played.name}.webp").exists(),
    }


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(available_cores(), get_context("spawn")) as pool:
        listed = list(pool.map(add, GALLERY, [folder] * len(GALLERY)))
    write_json(folder / LISTED, listed)


def films(folder: Path) -> None:
    """Adds a film, NAME.mp4, of each performance that practice has reached, newer than its page.

    One that is there already stays, so that this goes on where it was stopped.
    """
    for played in GALLERY:
        page, film = folder / f"{played.name}.html", folder / f"{played.name}.mp4"
        is_there = film.exists() and film.stat().st_mtime > page.stat().st_mtime
        if isinstance(played, Practised) and not is_there:
            with TemporaryDirectory() as results:
                played.play().save(results)
                write_film(Path(results), film, _FILM)


def keep(folder: Path) -> None:
    """Keeps the actions that practice has reached, of all that a practised plan holds."""
    arrays, facts = read_tensors(folder / f"plan{TENSORS}", PLAN, 1 << 31)
    kept = {name: arrays[name] for name in ("action", "fingering")}
    write_tensors(PRACTISED / (folder.name + TENSORS), kept, facts)


if __name__ == "__main__":
    *words, last = sys.argv[1:]
    {(): main, ("films",): films, ("keep",): keep}[tuple(words)](Path(last))
