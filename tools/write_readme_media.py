"""Makes the README's moving picture and its sound: the planner plays the opening of Für Elise.

    python tools/write_readme_media.py

writes docs/hands.webp and docs/fur-elise.mp3.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import closing
from itertools import chain
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

import cadenza
from cadenza.files import write_atomically
from cadenza.report.sound import encode_mp3, synthesize
from cadenza.sim.render import Picture, Renderer

DOCS = Path(__file__).parents[1] / "docs"
SONG, SEED = "FurEliseOpening", 0
PICTURE = Picture(1600, 900, "player")  # twice as wide and high as what is written
FIRST, LAST = 0.5, 7.5  # [s] what is shown
EVERY = 2  # control steps to a picture


def pictures(performance: cadenza.Performance) -> Iterator[NDArray[np.uint8]]:
    episode = performance.episode
    keys = np.flatnonzero(episode["goal_keys"].any(axis=0))
    names = ("hand_qpos", "key_qpos", "key_activation", "goal_keys")
    steps = range(round(FIRST / episode.dt), round(LAST / episode.dt), EVERY)
    with closing(Renderer(performance.scene, PICTURE, (int(keys[0]), int(keys[-1])))) as renderer:
        for step in steps:
            pixels = renderer.frame(*(episode[name][step] for name in names))
            halves = pixels.reshape(PICTURE.height // 2, 2, PICTURE.width // 2, 2, 3)
            yield halves.mean(axis=(1, 3)).astype(np.uint8)


def write_webp(path: Path, frames: Iterator[NDArray[np.uint8]], fps: int) -> None:
    """Writes pictures (H, W, 3), at least one, to a file."""
    first = next(frames)
    with (
        write_atomically(path) as file,
        av.open(file, "w", format="webp", options={"loop": "0"}) as container,
    ):
        options = {"quality": "60", "compression_level": "6"}
        stream = container.add_stream("libwebp_anim", rate=fps, options=options)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in chain([first], frames):
            pixels = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            container.mux(stream.encode(pixels))
        container.mux(stream.encode(None))


def main() -> None:
    performance = cadenza.play(SONG, seed=SEED)
    print(f"F1 {performance.metrics['f1']:.3f}")
    fps = round(1 / performance.episode.dt / EVERY)
    write_webp(DOCS / "hands.webp", pictures(performance), fps)
    with write_atomically(DOCS / "fur-elise.mp3") as file:
        file.write(encode_mp3(synthesize(performance.played)))


if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0]).parse_args()
    main()
