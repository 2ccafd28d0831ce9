"""Makes films, animations and sound of a performance from its folder, on all cores."""

from __future__ import annotations

import multiprocessing
import os
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Progress, silent
from cadenza.episode import Episode, load_episode
from cadenza.errors import CadenzaError
from cadenza.files import checked, read_json
from cadenza.music.formats.midi import read_midi
from cadenza.music.libraries.library import composer_of
from cadenza.music.performance import played_in
from cadenza.performing.film_renderer import FilmRenderer, Look
from cadenza.report.sound import CODECS, SAMPLE_RATE, Samples, synthesize, write_sound
from cadenza.report.tone import Tone, tone
from cadenza.report.video import ANIMATIONS, write_animation, write_video
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.sim.threads import available_cores

FILM = "video.mp4"
"""The name of the film in the folder of a performance."""
FILMS = (".mp4", *ANIMATIONS)
"""Endings of the names of films; of animations, which have no sound, all but the first."""
_ANIMATED = 6.0  # [s] that an animation lasts
_LEAST = 64  # [px]
_AT_ONCE = 24  # pictures that a process draws before it hands them over
_WAITING = 2  # such pieces for each process, which bounds the memory


@dataclass(frozen=True)
class FilmExcerpt:
    """A part of a performance: from `start` [s] on, for so many seconds or to its end."""

    start: float = 0.0
    seconds: float | None = None

    def of(self, length: float) -> tuple[float, float]:
        """Return from when to when it is, of a performance of a length, all in [s].

        Raises:
            CadenzaError: there is nothing of it.
        """
        end = length if self.seconds is None else min(self.start + self.seconds, length)
        if not 0 <= self.start < end:
            raise CadenzaError(
                f"nothing to show from {self.start:g} s to {end:g} s: what was played lasts "
                f"{length:.1f} s"
            )
        return self.start, end


WHOLE = FilmExcerpt()
"""All of a performance."""


def look_of(path: Path) -> Look:
    """Return the usual look of a film: that of an animation is smaller and has fewer pictures."""
    return Look(640, 360, 20) if path.suffix.lower() in ANIMATIONS else Look()


def check_film(path: Path) -> None:
    """Check the name of a film, an animation or a sound before it is made.

    Raises:
        CadenzaError: it has another ending, or is a folder.
    """
    if path.suffix.lower() not in (*FILMS, *CODECS):
        raise CadenzaError(
            f"{path}: a film is an {FILMS[0]}, a moving picture a {' or '.join(ANIMATIONS)}, and "
            f"the sound alone a {', '.join(CODECS)} file; choose a name with one of these endings"
        )
    if path.is_dir():
        raise CadenzaError(f"{path}: is a folder; choose another name")


def write_film(
    folder: Path,
    path: Path | None = None,
    look: Look | None = None,
    excerpt: FilmExcerpt = WHOLE,
    voice: Tone = tone,
    progress: Progress = silent,
) -> Path:
    """Write the film of a performance, or what else the ending of a name asks for.

    Args:
        folder: what `Performance.save` wrote.
        path: the file; `FILM` in the folder if there is none. See `check_film`.
        look: the size of the pictures and how many a second; `look_of` the file if there is none.
        excerpt: the part of the performance; an animation of it ends after six seconds unless
            the excerpt says when.
        voice: what makes the notes, see `synthesize`.
        progress: is told how many pictures are drawn.

    Returns:
        The file.

    Raises:
        CadenzaError: the folder holds no performance, the file has another ending, there is
            nothing of the excerpt, or this machine cannot draw.
    """
    path = folder / FILM if path is None else path
    check_film(path)
    if not (folder / "episode.npz").is_file():
        raise CadenzaError(
            f'{folder}: holds no performance (episode.npz); make one with "cadenza play SONG", and '
            "give the folder of its results, such as played/SONG/planner"
        )
    kind, episode = path.suffix.lower(), load_episode(folder / "episode.npz")
    if kind in ANIMATIONS and excerpt.seconds is None:
        excerpt = replace(excerpt, seconds=_ANIMATED)
    start, end = excerpt.of(episode.num_steps * episode.dt)
    if kind in CODECS:
        audio = _heard(episode, excerpt, voice)
        write_sound(path, audio, seconds=end - start)
        return path
    look = look or look_of(path)
    size, count = (look.width, look.height), max(int((end - start) * look.fps), 1)
    renderer_of(folder, Look(_LEAST, _LEAST)).close()  # says so here if this machine cannot draw
    pictures = _drawn(folder, look, start + np.arange(count) / look.fps, progress)
    if kind in ANIMATIONS:
        write_animation(path, pictures, look.fps, size)
    else:
        audio = _heard(episode, excerpt, voice)
        write_video(path, pictures, look.fps, audio, size)
    return path


def _heard(episode: Episode, excerpt: FilmExcerpt, voice: Tone) -> Samples:
    """The sound of a part of an episode; the last notes of the whole ring on after its end."""
    audio = synthesize(played_in(episode), voice=voice)
    if excerpt == WHOLE:
        return audio
    start, end = excerpt.of(episode.num_steps * episode.dt)
    last = len(audio) if excerpt.seconds is None else round(end * SAMPLE_RATE)
    return audio[round(start * SAMPLE_RATE) : last]


def _drawn(
    folder: Path, look: Look, times: NDArray[np.float64], progress: Progress
) -> Iterator[NDArray[np.uint8]]:
    """Draw pictures in several processes, and yield them in their order."""
    cores = available_cores()
    pieces = (times[i : i + _AT_ONCE] for i in range(0, len(times), _AT_ONCE))
    done = 0
    with ProcessPoolExecutor(
        cores, multiprocessing.get_context("spawn"), _begin, (folder, look)
    ) as pool:
        waiting: deque[Future[list[NDArray[np.uint8]]]] = deque(
            pool.submit(_draw, piece) for piece in islice(pieces, _WAITING * cores)
        )
        while waiting:
            for picture in waiting.popleft().result():
                yield picture
                done += 1
                progress("drawing", done, len(times))
            waiting.extend(pool.submit(_draw, piece) for piece in islice(pieces, 1))


_renderer: FilmRenderer | None = None  # of a process that draws


def _begin(folder: Path, look: Look) -> None:
    global _renderer
    os.environ.setdefault("LP_NUM_THREADS", "1")  # Mesa's own threads would compete
    _renderer = renderer_of(folder, look)


def renderer_of(folder: Path, look: Look) -> FilmRenderer:
    """Return what draws the performance in a folder.

    Raises:
        CadenzaError: it is not such a folder, or this machine cannot draw.
    """
    path = folder / "settings.json"
    settings = read_json(path, dict[str, Any])
    scene = build_scene(checked(settings.get("scene"), SceneConfig, f"{path}, scene"))
    episode, goal = load_episode(folder / "episode.npz"), read_midi(folder / "wanted.mid")
    return FilmRenderer(scene, episode, goal, look, _titles(episode, settings))


def _titles(episode: Episode, settings: Mapping[str, Any]) -> list[str]:
    """Name the song, who wrote it if a library says so, and who plays."""
    by = composer_of(str(settings.get("song")))
    player = f"played by the {settings['agent']}" if settings.get("agent") else ""
    return [episode.song, *filter(None, (by, player))]


def _draw(times: NDArray[np.float64]) -> list[NDArray[np.uint8]]:
    assert _renderer is not None
    return [_renderer.frame(float(time)) for time in times]
