"""A video file of a performance with its sound, or a moving picture without."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
import av.filter
import numpy as np
from numpy.typing import NDArray

from cadenza.files import write_atomically
from cadenza.report.sound import SAMPLE_RATE, Samples, write_audio

ANIMATIONS: dict[str, tuple[str, str, dict[str, str]]] = {
    ".gif": ("gif", "rgb24", {}),
    ".webp": ("libwebp_anim", "yuv420p", {"quality": "70"}),
}
"""Encoder, its pixels and its options, by the ending of the name."""
# As large a file as x264's default makes of crf 20, in half of the time, and hardly worse.
_QUALITY = {"crf": "19", "preset": "veryfast"}
_THREADS = 2  # that encode; by default, x264 takes all cores


def write_video(
    path: Path,
    frames: Iterable[NDArray[np.uint8]],
    fps: int,
    audio: Samples,
    size: tuple[int, int],
) -> None:
    """Write an MP4 with H.264 pictures and AAC sound, which any player and browser plays.

    Args:
        frames: at least one picture (H, W, 3), taken one at a time.
        fps: pictures a second.
        audio: cut where it outlasts the pictures by over a second.
        size: width and height [px] to which pictures are scaled, rounded down to even numbers.

    Raises:
        OSError: the disk is full, or the file cannot be written for another reason.
    """
    width, height = (side // 2 * 2 for side in size)
    with (
        write_atomically(path) as file,
        _errors_of_files(),
        av.open(file, "w", format="mp4") as container,
    ):
        video = container.add_stream("libx264", rate=fps, options=_QUALITY)
        video.width, video.height, video.pix_fmt = width, height, "yuv420p"
        video.thread_count = _THREADS
        sound = container.add_stream("aac", rate=SAMPLE_RATE, layout="stereo")

        count = 0
        for picture in _scaled(frames, (width, height), "yuv420p"):
            container.mux(video.encode(picture))
            count += 1
        container.mux(video.encode(None))
        length = min(len(audio), int((count / fps + 1) * SAMPLE_RATE))
        write_audio(container, sound, audio, length)


def write_animation(
    path: Path, frames: Iterable[NDArray[np.uint8]], fps: int, size: tuple[int, int]
) -> None:
    """Write pictures that go round and round, without sound: a GIF or WebP, as the name says.

    A GIF has the 256 colours that the pictures have most, so all of them are kept in memory.

    Args:
        frames: at least one picture (H, W, 3), taken one at a time.
        fps: pictures a second.
        size: width and height [px] to which pictures are scaled.

    Raises:
        OSError: the file cannot be written.
    """
    kind = path.suffix.lower().removeprefix(".")
    codec, pixels, options = ANIMATIONS[f".{kind}"]
    scaled = _scaled(frames, size, pixels)
    with (
        write_atomically(path) as file,
        _errors_of_files(),
        av.open(file, "w", format=kind, options={"loop": "0"}) as container,
    ):
        stream = container.add_stream(codec, rate=fps, options=options)
        assert isinstance(stream, av.VideoStream)
        (stream.width, stream.height), stream.pix_fmt = size, pixels
        if kind == "gif":
            stream.pix_fmt = "pal8"
            scaled = _in_256_colours(scaled, size, fps)
        for picture in scaled:
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


def _in_256_colours(
    pictures: Iterable[av.VideoFrame], size: tuple[int, int], fps: int
) -> Iterator[av.VideoFrame]:
    """Yield pictures in the palette that suits all of them best, by filters of FFmpeg."""
    graph = av.filter.Graph()
    source = graph.add_buffer(
        width=size[0], height=size[1], format=av.VideoFormat("rgb24"), time_base=Fraction(1, fps)
    )
    split, palette = graph.add("split"), graph.add("palettegen", "stats_mode=diff")
    use, sink = (
        graph.add("paletteuse", "dither=bayer:bayer_scale=4:diff_mode=rectangle"),
        graph.add("buffersink"),
    )
    source.link_to(split)
    split.link_to(palette, 0, 0)
    split.link_to(use, 1, 0)
    palette.link_to(use, 0, 1)
    use.link_to(sink)
    graph.configure()
    for picture in pictures:
        source.push(picture)
    source.push(None)
    while True:
        try:
            coloured = sink.pull()
        except (av.EOFError, av.BlockingIOError):
            return
        assert isinstance(coloured, av.VideoFrame)
        yield coloured


def _scaled(
    pictures: Iterable[NDArray[np.uint8]], size: tuple[int, int], pixels: str
) -> Iterator[av.VideoFrame]:
    """Yield pictures of a size [px] and with pixels of a format."""
    for number, picture in enumerate(pictures):
        drawn = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        scaled = drawn.reformat(*size, pixels, interpolation="AREA")
        scaled.pts = number
        yield scaled


@contextmanager
def _errors_of_files() -> Iterator[None]:
    """Raise the OSError behind an error of PyAV, if there is one."""
    try:
        yield
    except av.FFmpegError as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, OSError):
            cause = cause.__context__
        raise cause or error from None
