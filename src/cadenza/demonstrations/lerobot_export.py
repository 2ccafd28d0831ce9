"""Export of demonstrations to LeRobot, format v3.0, which is Parquet and JSON.

    meta/info.json                                the features and their shapes
    meta/stats.json                               minimum, maximum, mean, deviation of each feature
    meta/tasks.parquet                            a task for each song
    meta/episodes/chunk-000/file-000.parquet      where each episode is
    data/chunk-000/file-000.parquet               the frames, many episodes a file
    videos/NAME/chunk-000/file-000.mp4            the view of a camera, if there are any

The action is the demonstrator's choice, in [-1, 1]; the played action, with noise, is the next
frame's `observation.previous_action`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import reduce
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from numpy.typing import NDArray

from cadenza.demonstrations.dataset import Dataset
from cadenza.demonstrations.transitions import pictures_of, shown_by, transitions
from cadenza.errors import CadenzaError, extra_packages
from cadenza.files import new_folder, write_json
from cadenza.sim.render import Picture, Renderer

_MAX_DATA_BYTES = 100 * 2**20  # bytes of a file of data
_MAX_ROWS = 256  # rows of the table of episodes in memory, 170 kB each
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_EPISODES = "meta/episodes/chunk-000/file-000.parquet"

Arrays = dict[str, NDArray[Any]]


def write_lerobot(
    dataset: Dataset,
    path: Path,
    advance: Callable[[int, int], None],
    pictures: Sequence[Picture] = (),
) -> None:
    """Write a dataset into a new folder, with these `pictures` of every step.

    Raises CadenzaError if pyarrow is not installed, the folder exists, an episode is damaged, the
    control steps are no whole number a second, or this machine cannot draw.
    """
    with extra_packages("export", "exporting"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    fps = _fps(dataset)
    songs = list(dict.fromkeys(episode.facts.song for episode in dataset.episodes))
    tasks = {song: number for number, song in enumerate(songs)}
    with new_folder(path) as folder, ExitStack() as opened:
        videos = [
            opened.enter_context(closing(Video(dataset, picture, fps, folder)))
            for picture in pictures
        ]
        files, rows = _FrameFiles(folder), _EpisodeTable(folder / _EPISODES)
        index, totals = 0, dict[str, Statistics]()
        features: dict[str, Any] = {}
        names = _names(dataset)
        for number, episode in enumerate(dataset.episodes):
            frames = _frames(dataset, number, index, tasks[episode.facts.song], fps)
            features = features or {n: _feature(of, names.get(n)) for n, of in frames.items()}
            of_episode = {name: Statistics.of(values) for name, values in frames.items()}
            places = dict[str, Any]()
            for video in videos:
                at, of_episode[video.name] = video.add(number)
                places |= at
            for name, of in of_episode.items():
                totals[name] = totals[name].merged(of) if name in totals else of
            place = files.add(pa.table({n: _column(pa, v) for n, v in frames.items()}))
            end = index + len(frames["index"])
            row = _row(number, episode.facts.song, range(index, end), place, _stats(of_episode))
            rows.add(row | places)
            index = end
            advance(number + 1, len(dataset.episodes))
        files.close()
        rows.close()
        features |= {video.name: video.feature for video in videos}
        pq.write_table(_tasks(pa, songs), folder / "meta/tasks.parquet")
        write_json(folder / "meta/stats.json", _stats(totals))
        counts = {"episodes": len(dataset.episodes), "frames": index, "tasks": len(songs)}
        robot = f"{dataset.scene.hand.name} hands"
        write_json(folder / "meta/info.json", _info(robot, counts, fps, features))


def _fps(dataset: Dataset) -> int:
    fps = round(1 / dataset.control_timestep)
    if abs(fps * dataset.control_timestep - 1) > 1e-9:
        raise CadenzaError(
            f"LeRobot wants a whole number of frames a second, not {1 / dataset.control_timestep:g}"
        )
    return fps


def _row(
    number: int, song: str, frames: range, place: tuple[int, int], stats: Mapping[str, Any]
) -> dict[str, Any]:
    """The row of an episode, whose frames are in a file of a chunk, the `place`."""
    chunk, file = place
    return {
        "episode_index": number,
        "tasks": [_task(song)],
        "length": len(frames),
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": frames.start,
        "dataset_to_index": frames.stop,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    } | {f"stats/{name}/{k}": v for name, of in stats.items() for k, v in of.items()}


def _info(
    robot: str, counts: Mapping[str, int], fps: int, features: dict[str, Any]
) -> dict[str, Any]:
    return {
        "codebase_version": "v3.0",
        "robot_type": robot,
        **{f"total_{what}": count for what, count in counts.items()},
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": _MAX_DATA_BYTES >> 20,
        "video_files_size_in_mb": FILE_BYTES >> 20,
        "fps": fps,
        "splits": {"train": f"0:{counts['episodes']}"},
        "data_path": _DATA,
        "video_path": PATH if any(of["dtype"] == "video" for of in features.values()) else None,
        "features": features,
    }


def _frames(dataset: Dataset, number: int, first: int, task: int, fps: int) -> Arrays:
    made = transitions(dataset, number)
    count = len(made.chosen)
    frame = np.arange(count)
    return {
        "observation.state": made.joints[:-1],
        "observation.velocity": made.velocities[:-1],
        "observation.previous_action": made.played[:-1],
        "observation.environment_state": made.environment[:-1],
        "action": made.chosen,
        "next.reward": made.reward.astype(np.float32),
        "next.done": frame == count - 1,
        "timestamp": (frame / fps).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(count, number),
        "index": first + frame,
        "task_index": np.full(count, task),
    }


def _feature(values: NDArray[Any], names: Sequence[str] | None) -> dict[str, Any]:
    shape = list(values.shape[1:]) or [1]
    return {"dtype": values.dtype.name, "shape": shape, "names": names and list(names)}


def _names(dataset: Dataset) -> dict[str, Sequence[str]]:
    """The names of the entries of features: by joint, by actuator, or by part and place."""
    scene, layout = dataset.scene, shown_by(dataset).observation_layout
    joints, actions = scene.hand_joint_names, (*scene.actuator_names, "sustain_pedal")
    parts = {name: part.stop - part.start for name, part in layout.items() if name != "joints"}
    return {
        "observation.state": joints,
        "observation.velocity": joints,
        "observation.previous_action": actions,
        "observation.environment_state": [f"{n}.{i}" for n, d in parts.items() for i in range(d)],
        "action": actions,
    }


def _column(pa: Any, values: NDArray[Any]) -> Any:
    if values.ndim == 1:
        return pa.array(values)
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _task(song: str) -> str:
    return f"Play {song}."


def _tasks(pa: Any, songs: Sequence[str]) -> Any:
    """The table of tasks, whose names are the index for pandas, which reads it."""
    table = pa.table({"task_index": range(len(songs)), "task": [_task(song) for song in songs]})
    columns: list[dict[str, Any]] = [
        {"name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
        {"name": "task", "pandas_type": "unicode", "numpy_type": "object"},
    ]
    metadata = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [c | {"field_name": c["name"], "metadata": None} for c in columns],
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(metadata)})


def _stats(statistics: Mapping[str, Statistics]) -> dict[str, dict[str, Any]]:
    """Statistics as JSON by feature; those of a video have a place for each channel."""
    return {
        name: of.as_json((-1, 1, 1) if name.startswith(IMAGES) else (-1,))
        for name, of in statistics.items()
    }


class _FrameFiles:
    def __init__(self, folder: Path) -> None:
        self._folder, self._number = folder, -1
        self._writer: Any = None

    def add(self, table: Any) -> tuple[int, int]:
        """Add an episode; returns the numbers of its chunk and its file."""
        import pyarrow.parquet as pq

        if self._writer is None or self._path.stat().st_size > _MAX_DATA_BYTES:
            self.close()
            self._number += 1
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(self._path, table.schema)
        self._writer.write_table(table)
        return self._place

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()

    @property
    def _place(self) -> tuple[int, int]:
        return divmod(self._number, FILES_PER_CHUNK)

    @property
    def _path(self) -> Path:
        chunk, file = self._place
        return self._folder / _DATA.format(chunk_index=chunk, file_index=file)


class _EpisodeTable:
    """The table of episodes; few rows are in memory at once."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True)
        self._path, self._rows = path, list[dict[str, Any]]()
        self._writer: Any = None

    def add(self, row: dict[str, Any]) -> None:
        self._rows.append(row)
        if len(self._rows) == _MAX_ROWS:
            self._write()

    def close(self) -> None:
        if self._rows:
            self._write()
        self._writer.close()

    def _write(self) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pa.Table.from_pylist(self._rows)
        self._rows.clear()
        if self._writer is None:
            self._writer = pq.ParquetWriter(self._path, table.schema)
        self._writer.write_table(table)


Floats = NDArray[np.float64]


class Statistics(NamedTuple):
    """Minimum, maximum, mean and variance (D,) of each of D columns over a number of rows."""

    rows: int
    minimum: Floats
    maximum: Floats
    mean: Floats
    variance: Floats

    @classmethod
    def of(cls, values: NDArray[Any]) -> Statistics:
        """The statistics of values (N, ...), whose entries are the columns."""
        columns = values.reshape(len(values), -1).astype(np.float64)
        low, high = columns.min(axis=0), columns.max(axis=0)
        return cls(len(columns), low, high, columns.mean(axis=0), columns.var(axis=0))

    def merged(self, other: Statistics) -> Statistics:
        """The statistics of the rows of both, by the law of total variance."""
        rows = self.rows + other.rows
        share = other.rows / rows
        mean = (1 - share) * self.mean + share * other.mean
        within = (1 - share) * self.variance + share * other.variance
        between = (1 - share) * (self.mean - mean) ** 2 + share * (other.mean - mean) ** 2
        low, high = np.minimum(self.minimum, other.minimum), np.maximum(self.maximum, other.maximum)
        return Statistics(rows, low, high, mean, within + between)

    def as_json(self, shape: tuple[int, ...] = (-1,)) -> dict[str, Any]:
        """The statistics as LeRobot keeps them, each of this shape."""
        arrays = {"min": self.minimum, "max": self.maximum, "mean": self.mean}
        arrays["std"] = np.sqrt(self.variance)
        return {name: a.reshape(shape).tolist() for name, a in arrays.items()} | {
            "count": [self.rows]
        }


PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
IMAGES = "observation.images."  # begins the names of features that are videos
FILE_BYTES = 200 * 2**20  # bytes of a video file
FILES_PER_CHUNK = 1000
_MIN_SIZE = 16  # [px] that the encoder takes
_ENCODER = "libx264"
_KEY_FRAME_INTERVAL = 2  # LeRobot's, whose learners read pictures in any order
_OPTIONS = {"crf": "20", "g": str(_KEY_FRAME_INTERVAL), "bf": "0"}
_THREADS = 2  # threads of the encoder; by default, x264 takes all cores
_MAX_BRIGHTNESS = 255  # LeRobot's 1


class Video:
    """The view of one camera in all episodes, the feature `name`.

    The pictures show the scene before each step, as in `PianoVectorEnv`.
    """

    def __init__(self, dataset: Dataset, picture: Picture, fps: int, folder: Path) -> None:
        """Open the renderer; the first file begins with the first episode.

        Raises CadenzaError if this machine cannot draw, or a video cannot have this size.
        """
        sides = picture.width, picture.height
        if any(side % 2 or side < _MIN_SIZE for side in sides):
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
        """Add an episode; returns where it is, and the statistics of its colours."""
        if self._output is None or self._path.stat().st_size > FILE_BYTES:
            self._begin()
        first, pictures = self._frames, []
        count = self._dataset.episodes[number].facts.num_steps
        for pixels in islice(pictures_of(self._dataset, number, self._renderer), count):
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
        row = {f"videos/{self.name}/{name}": value for name, value in place.items()}
        return row, reduce(Statistics.merged, pictures)

    def close(self) -> None:
        """End the last file, and free graphics."""
        self._end()
        self._renderer.close()

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
