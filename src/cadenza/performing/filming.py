"""Makes the film of a performance from its folder, on all cores."""

from __future__ import annotations

import multiprocessing
import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Progress, silent
from cadenza.episode import load_episode
from cadenza.files import checked, read_json
from cadenza.music.formats.midi import read_midi
from cadenza.music.performance import played_in
from cadenza.performing.film_renderer import FilmRenderer, Look
from cadenza.report.sound import SAMPLE_RATE, synthesize
from cadenza.report.video import write_video
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.sim.threads import available_cores

FILM = "video.mp4"
"""The name of the film in the folder of a performance."""
_LEAST = 64  # [px]
_AT_ONCE = 24  # pictures that a process draws before it hands them over
_WAITING = 2  # such pieces for each process, which bounds the memory


def write_film(folder: Path, look: Look | None = None, progress: Progress = silent) -> Path:
    """Writes the film of a performance into its folder; returns its path.

    Args:
        folder: what `Performance.save` wrote.
        look: the size of the film and its pictures a second.
        progress: is told how many pictures are drawn.

    Raises:
        CadenzaError: it is not such a folder, or this machine cannot draw.
    """
    look = look or Look()
    episode = load_episode(folder / "episode.npz")
    _renderer_of(folder, Look(_LEAST, _LEAST)).close()  # says so here if this machine cannot draw
    count = int(episode.num_steps * episode.dt * look.fps)
    pictures = _drawn(folder, look, np.arange(count) / look.fps, progress)
    size, audio = (look.width, look.height), synthesize(played_in(episode))
    write_video(folder / FILM, pictures, look.fps, audio, SAMPLE_RATE, size)
    return folder / FILM


def _drawn(
    folder: Path, look: Look, times: NDArray[np.float64], progress: Progress
) -> Iterator[NDArray[np.uint8]]:
    """Draws pictures in several processes, and yields them in their order."""
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
    _renderer = _renderer_of(folder, look)


def _renderer_of(folder: Path, look: Look) -> FilmRenderer:
    """The renderer of the performance in a folder."""
    path = folder / "settings.json"
    settings = read_json(path, dict[str, Any])
    scene = build_scene(checked(settings.get("scene"), SceneConfig, f"{path}, scene"))
    episode, goal = load_episode(folder / "episode.npz"), read_midi(folder / "wanted.mid")
    return FilmRenderer(scene, episode, goal, look)


def _draw(times: NDArray[np.float64]) -> list[NDArray[np.uint8]]:
    assert _renderer is not None
    return [_renderer.frame(float(time)) for time in times]
