"""A video file of a performance with its sound."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import write_atomically
from cadenza.report.sound import SAMPLE_RATE, Samples, audio_frames

_MIN_SIZE = 16  # [px] that the encoder takes
_THREADS = 2  # that encode; by default, x264 takes all cores


def write_video(
    path: Path,
    frames: Iterable[NDArray[np.uint8]],
    fps: float,
    audio: Samples,
    sample_rate: int = SAMPLE_RATE,
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
    pictures = iter(frames)
    first = next(pictures, None)
    if first is None:
        raise CadenzaError(f"{path}: a video needs at least one picture")
    drawn_height, drawn_width = first.shape[0] // 2 * 2, first.shape[1] // 2 * 2
    width, height = (side // 2 * 2 for side in size or (drawn_width, drawn_height))
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
        video = container.add_stream("libx264", rate=rate, options={"crf": "20"})
        video.width, video.height, video.pix_fmt = width, height, "yuv420p"
        video.thread_count = _THREADS
        layout = "mono" if audio.ndim == 1 else "stereo"
        sound = container.add_stream("aac", rate=sample_rate, layout=layout)

        count = 0
        for picture in itertools.chain([first], pictures):
            if picture.shape != first.shape:
                raise CadenzaError(
                    f"{path}: picture {count} is {picture.shape}, the first is {first.shape}"
                )
            pixels = np.ascontiguousarray(picture[:drawn_height, :drawn_width])
            drawn = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            container.mux(
                video.encode(drawn.reformat(width, height, "yuv420p", interpolation="AREA"))
            )
            count += 1
        container.mux(video.encode(None))

        length = min(len(audio), int((count / fps + 1) * sample_rate))
        for frame in audio_frames(audio, sample_rate, length):
            container.mux(sound.encode(frame))
        container.mux(sound.encode(None))


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
