"""A video file of a performance with its sound, or a moving picture without."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
import av.filter
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import write_atomically
from cadenza.report.sound import SAMPLE_RATE, Samples, write_audio

ANIMATIONS: dict[str, tuple[str, str, dict[str, str]]] = {
    ".gif": ("gif", "rgb24", {}),
    ".webp": ("libwebp_anim", "yuv420p", {"quality": "70"}),
}
"""Encoder, its pixels and its options, by the ending of the name."""
_MIN_SIZE = 16  # [px] that the encoder takes
# As large a file as x264's default makes of crf 20, in half of the time, and hardly worse.
_QUALITY = {"crf": "19", "preset": "veryfast"}
_THREADS = 2  # that encode; by default, x264 takes all cores


def write_video(
    path: Path,
    frames: Iterable[NDArray[np.uint8]],
    fps: float,
    audio: Samples,
    size: tuple[int, int] | None = None,
) -> None:
    """Writes an MP4 with H.264 pictures and AAC sound, which any player and browser plays.

    Args:
        frames: pictures (H, W, 3), taken one at a time; of an odd height or width, the last row or
            column is left out, because the format cannot hold it.
        fps: pictures a second.
        audio: cut where it outlasts the pictures by over a second.
        size: width and height [px] to which pictures are scaled; None leaves them as they are.

    Raises:
        CadenzaError: there are no frames, or they differ in size.
        OSError: the disk is full, or the file cannot be written for another reason.
    """
    first, pictures = _begun(path, frames)
    width, height = (side // 2 * 2 for side in size or first.shape[1::-1])
    if min(height, width) < _MIN_SIZE:
        raise CadenzaError(
            f"{path}: a video of {width} x {height} pixels cannot be encoded; "
            f"choose {_MIN_SIZE} x {_MIN_SIZE} or more"
        )
    with (
        write_atomically(path) as file,
        _errors_of_files(),
        av.open(file, "w", format="mp4") as container,
    ):
        rate = Fraction(fps).limit_denominator(1001)
        video = container.add_stream("libx264", rate=rate, options=_QUALITY)
        video.width, video.height, video.pix_fmt = width, height, "yuv420p"
        video.thread_count = _THREADS
        layout = "mono" if audio.ndim == 1 else "stereo"
        sound = container.add_stream("aac", rate=SAMPLE_RATE, layout=layout)

        count = 0
        for picture in _scaled(path, pictures, (width, height), "yuv420p"):
            container.mux(video.encode(picture))
            count += 1
        container.mux(video.encode(None))

        length = min(len(audio), int((count / fps + 1) * SAMPLE_RATE))
        write_audio(container, sound, audio, length)


def write_animation(
    path: Path, frames: Iterable[NDArray[np.uint8]], fps: float, size: tuple[int, int]
) -> None:
    """Writes pictures that go round and round, without sound: a GIF or WebP, as the name says.

    A GIF has the 256 colours that the pictures have most, so all of them are kept in memory.

    Args:
        frames: pictures (H, W, 3), taken one at a time.
        fps: pictures a second.
        size: width and height [px] to which pictures are scaled.

    Raises:
        CadenzaError: there are no frames, or they differ in size.
        OSError: the file cannot be written.
    """
    kind = path.suffix.lower().removeprefix(".")
    codec, pixels, options = ANIMATIONS[f".{kind}"]
    _, pictures = _begun(path, frames)
    scaled = _scaled(path, pictures, size, pixels)
    rate = Fraction(fps).limit_denominator(1001)
    with (
        write_atomically(path) as file,
        _errors_of_files(),
        av.open(file, "w", format=kind, options={"loop": "0"}) as container,
    ):
        stream = container.add_stream(codec, rate=rate, options=options)
        assert isinstance(stream, av.VideoStream)
        (stream.width, stream.height), stream.pix_fmt = size, pixels
        if kind == "gif":
            stream.pix_fmt = "pal8"
            scaled = _in_256_colours(scaled, size, rate)
        for picture in scaled:
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


def _in_256_colours(
    pictures: Iterable[av.VideoFrame], size: tuple[int, int], rate: Fraction
) -> Iterator[av.VideoFrame]:
    """Yields pictures in the palette that suits all of them best, by filters of FFmpeg."""
    graph = av.filter.Graph()
    source = graph.add_buffer(
        width=size[0], height=size[1], format=av.VideoFormat("rgb24"), time_base=1 / rate
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


def _begun(
    path: Path, frames: Iterable[NDArray[np.uint8]]
) -> tuple[NDArray[np.uint8], Iterator[NDArray[np.uint8]]]:
    """Returns the first of some pictures, and all of them.

    Raises:
        CadenzaError: there are none.
    """
    pictures = iter(frames)
    first = next(pictures, None)
    if first is None:
        raise CadenzaError(f"{path}: a video needs at least one picture")
    return first, itertools.chain([first], pictures)


def _scaled(
    path: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int], pixels: str
) -> Iterator[av.VideoFrame]:
    """Yields pictures of a size [px] and with pixels of a format; an odd row or column is left out.

    Raises:
        CadenzaError: they differ in size.
    """
    shape = None
    for number, picture in enumerate(pictures):
        shape = shape or picture.shape
        if picture.shape != shape:
            raise CadenzaError(f"{path}: picture {number} is {picture.shape}, the first is {shape}")
        even = picture[: shape[0] // 2 * 2, : shape[1] // 2 * 2]
        drawn = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
        scaled = drawn.reformat(*size, pixels, interpolation="AREA")
        scaled.pts = number
        yield scaled


@contextmanager
def _errors_of_files() -> Iterator[None]:
    """Raises the OSError behind an error of PyAV, if there is one."""
    try:
        yield
    except av.FFmpegError as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, OSError):
            cause = cause.__context__
        raise cause or error from None
