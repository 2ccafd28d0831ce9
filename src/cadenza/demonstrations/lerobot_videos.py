"""The videos of a LeRobot dataset: H.264, many episodes a file."""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from cadenza.demonstrations.dataset import Dataset
from cadenza.demonstrations.lerobot_statistics import Statistics
from cadenza.errors import CadenzaError
from cadenza.sim.render import Picture, Renderer

PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
IMAGES = "observation.images."  # begins the names of features that are videos
FILE_BYTES = 200 * 2**20  # after which another file is begun
FILES_PER_CHUNK = 1000
_MIN_SIZE = 16  # [px] that the encoder takes
_ENCODER = "libx264"
_KEY_FRAME_INTERVAL = 2  # as LeRobot has it: its learners read pictures in any order
_OPTIONS = {"crf": "20", "g": str(_KEY_FRAME_INTERVAL), "bf": "0"}
_THREADS = 2  # that encode; by default, x264 takes all cores
_MAX_BRIGHTNESS = 255  # which LeRobot calls 1


class Video:
    """The view of one camera in all episodes, the feature `name`.

    The pictures are those that environments show before each step, see `PianoVectorEnv`.
    """

    def __init__(self, dataset: Dataset, picture: Picture, fps: int, folder: Path) -> None:
        """Opens the renderer; the first file begins with the first episode.

        Raises:
            CadenzaError: this machine cannot draw, or a video cannot have this size.
        """
        if (
            picture.width % 2
            or picture.height % 2
            or min(picture.width, picture.height) < _MIN_SIZE
        ):
            raise CadenzaError(
                f"a video of {picture.width} x {picture.height} pixels cannot be encoded: choose "
                f"even numbers, {_MIN_SIZE} or more"
            )
        self.name = IMAGES + picture.camera
        self._dataset, self._picture, self._fps, self._folder = dataset, picture, fps, folder
        self._renderer = Renderer(dataset.scene, picture)
        self._file, self._frames = -1, 0
        self._output: Any = None
        self._stream: Any = None

    @property
    def feature(self) -> dict[str, Any]:
        """The entry of the video in info.json."""
        picture = self._picture
        return {
            "dtype": "video",
            "shape": [picture.height, picture.width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": picture.height,
                "video.width": picture.width,
                "video.codec": "h264",
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False,
                "video.fps": self._fps,
                "video.channels": 3,
                "has_audio": False,
            },
        }

    def add(self, number: int) -> tuple[dict[str, Any], Statistics]:
        """Adds an episode; returns where it is, and the statistics of its colours."""
        if self._output is None or self._path.stat().st_size > FILE_BYTES:
            self._begin()
        first, pictures = self._frames, []
        for pixels in self._pictures(number):
            colours = Statistics.of(pixels.reshape(-1, 3) / _MAX_BRIGHTNESS)
            pictures.append(colours._replace(rows=1))  # LeRobot counts pictures
            self._encode(av.VideoFrame.from_ndarray(pixels, format="rgb24"))
            self._frames += 1
        chunk, file = divmod(self._file, FILES_PER_CHUNK)
        place = {
            "chunk_index": chunk,
            "file_index": file,
            "from_timestamp": first / self._fps,
            "to_timestamp": self._frames / self._fps,
        }
        row = {f"videos/{self.name}/{what}": of for what, of in place.items()}
        return row, reduce(Statistics.merged, pictures)

    def close(self) -> None:
        """Ends the last file, and frees graphics."""
        self._end()
        self._renderer.close()

    def _pictures(self, number: int) -> Iterator[NDArray[np.uint8]]:
        episode, keyboard = self._dataset.episodes[number], self._dataset.scene.keyboard
        steps, count = episode.steps, episode.facts.num_steps
        sounding = np.unpackbits(steps["sounding"], axis=1, count=keyboard.num_keys).view(bool)
        wanted = np.pad(self._dataset.goals(number).keys, [(1, 0), (0, 0)])
        depth = steps["key_state"] * keyboard.travel
        for t in range(count):
            frame = self._renderer.frame(steps["hand_qpos"][t], depth[t], sounding[t], wanted[t])
            yield np.ascontiguousarray(frame)

    @property
    def _path(self) -> Path:
        chunk, file = divmod(self._file, FILES_PER_CHUNK)
        return self._folder / PATH.format(video_key=self.name, chunk_index=chunk, file_index=file)

    def _begin(self) -> None:
        self._end()
        self._file, self._frames = self._file + 1, 0
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._output = av.open(self._path, "w")
        self._stream = self._output.add_stream(_ENCODER, rate=self._fps, options=_OPTIONS)
        self._stream.width, self._stream.height = self._picture.width, self._picture.height
        self._stream.pix_fmt, self._stream.thread_count = "yuv420p", _THREADS

    def _encode(self, frame: av.VideoFrame | None) -> None:
        self._output.mux(self._stream.encode(frame))

    def _end(self) -> None:
        if self._output is not None:
            self._encode(None)
            self._output.close()
            self._output = None
