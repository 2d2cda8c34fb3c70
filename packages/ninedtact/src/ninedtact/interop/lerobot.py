"""Exports recordings as a LeRobotDataset v3.0: one folder with Parquet and JSON files, one recording an episode.

The layout is that of LeRobot (docs/lerobot.md): `data/` holds the frames with their images as PNG, `meta/` the features, the
episodes, the tasks and the statistics by which training normalises. The files are written with pyarrow; LeRobot is not needed.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact._version import installation_command
from ninedtact.atomic_write import create_folder_atomically
from ninedtact.errors import InputError, MissingLibraryError
from ninedtact.recording.export import WRENCH_COLUMNS, require_empty_folder, require_exportable
from ninedtact.recording.reader import Recording
from ninedtact.recording.summary import median_rate_hz
from ninedtact.recording.topics_and_messages import Topic

CODEBASE_VERSION = "v3.0"
IMAGE, TIME = "observation.images.tactile", "observation.time_s"
WRENCHES = {"observation.wrench": Topic.MEASURED, "observation.wrench_estimated": Topic.ESTIMATED}
"""The wrench of the force/torque sensor and that of the estimator, each where the recordings hold it."""
STD, WARNINGS = "observation.wrench_estimated_std", "wrench_estimated_warnings"
UNKNOWN_STD = 1e6
"""Standard deviation in N and N·m of an estimate that knows nothing, in place of infinity, which statistics cannot hold."""
FILES_PER_CHUNK = 1000
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
_ROWS_PER_GROUP = 100
_IMAGES_IN_STATISTICS = 100
_SCALARS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""What LeRobot adds to every frame; timestamp is frame_index / fps."""

Statistics = dict[str, dict[str, list[Any]]]


class PyArrowMissing(MissingLibraryError):
    """Raised where pyarrow is not installed."""


class RecordingsDiffer(InputError):
    """Raised for recordings that cannot be episodes of one data set."""


def export_lerobot(
    recordings: Sequence[Recording], out: Path, task: str = "touch", on_image: Callable[[], None] = lambda: None
) -> dict[str, int]:
    """Write recordings as the episodes of one data set into a new or empty folder; return its episodes, frames and features.

    task: what is done in them, in words. Wrenches are interpolated linearly at the times of the images. Raises `OutputError`,
    `RecordingsDiffer`, `PyArrowMissing`, and `RecordingUnreadable` for a damaged recording; the folder is then as it was before.
    """
    if find_spec("pyarrow") is None:
        raise PyArrowMissing(
            f"expected pyarrow, which writes LeRobot's files, got none; run {installation_command('datasets')}"
        )
    require_empty_folder(out)
    for recording in recordings:
        require_exportable([recording])
    features, fps = _common_features(recordings)
    with create_folder_atomically(out) as folder:
        writer = _EpisodeWriter(folder, features, fps, task)
        for recording in recordings:
            writer.write(recording, on_image)
        writer.finish()
    return {"episodes": len(writer.episodes), "frames": writer.frames, "features": len(features)}


def _common_features(recordings: Sequence[Recording]) -> tuple[dict[str, Any], int]:
    """Return the features of all recordings and their images per second; raises `RecordingsDiffer`."""
    if not recordings:
        raise RecordingsDiffer("expected at least one recording, got none; give one")
    kinds = [_EpisodeKind.of_recording(recording) for recording in recordings]
    for recording, kind in zip(recordings, kinds, strict=True):
        if kind != kinds[0]:
            raise RecordingsDiffer(
                "expected recordings with images of one size, at one rate and with the same wrenches, got "
                f"{recordings[0].path} with {kinds[0]} and {recording.path} with {kind}; export them separately"
            )
    shape, wrenches, fps = kinds[0].image_shape, kinds[0].wrenches, kinds[0].fps
    if 0 in shape:
        raise RecordingsDiffer("expected a recording with images, got one without; record a camera")
    names = {"image": ["height", "width", "channels"]}
    features: dict[str, Any] = {IMAGE: {"dtype": "image", "shape": list(shape), "names": names["image"]}}
    features |= {key: {"dtype": "float32", "shape": [6], "names": list(WRENCH_COLUMNS)} for key in wrenches}
    if "observation.wrench_estimated" in features:
        features[STD] = {"dtype": "float32", "shape": [6], "names": list(WRENCH_COLUMNS)}
        features[WARNINGS] = {"dtype": "int64", "shape": [1], "names": None}
    features[TIME] = {"dtype": "float64", "shape": [1], "names": None}
    return features | {key: {"dtype": dtype, "shape": [1], "names": None} for key, dtype in _SCALARS.items()}, fps


@dataclass(frozen=True)
class _EpisodeKind:
    """What the episodes of one data set have in common."""

    image_shape: tuple[int, ...]
    wrenches: tuple[str, ...]
    """The features of the wrenches that the recording holds."""
    fps: int

    @classmethod
    def of_recording(cls, recording: Recording) -> "_EpisodeKind":
        """Return the kind of a recording."""
        wrenches = tuple(key for key, topic in WRENCHES.items() if len(recording.positions(topic)))
        fps = max(1, round(median_rate_hz(recording.stamps_ns(Topic.IMAGES))))
        return cls(_image_shape(recording), wrenches, fps)

    def __str__(self) -> str:
        rows, cols, _ = self.image_shape
        wrenches = " and ".join(key.removeprefix("observation.") for key in self.wrenches) or "no wrench"
        return f"{cols} x {rows} px at {self.fps} Hz and {wrenches}"


def _image_shape(recording: Recording) -> tuple[int, ...]:
    """Return the (rows, cols, 3) of a recording's images, zeros where it has none."""
    first = next(recording.frames(), None)
    return (0, 0, 0) if first is None else first.image.shape


@dataclass
class _EpisodeWriter:
    """Writes episodes one after the other, each into a data file of its own, and at the end what describes them all."""

    folder: Path
    features: dict[str, Any]
    fps: int
    task: str

    def __post_init__(self) -> None:
        self.episodes: list[dict[str, Any]] = []
        self.statistics: list[Statistics] = []
        self.frames = 0

    def write(self, recording: Recording, on_image: Callable[[], None]) -> None:
        """Write one recording as the next episode."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        number, columns = len(self.episodes), self._numbers(recording)
        chunk, file = divmod(number, FILES_PER_CHUNK)
        path = self.folder / DATA_PATH.format(chunk_index=chunk, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        sampled = _ImageStatistics(max(1, len(columns["index"]) // _IMAGES_IN_STATISTICS))
        images = self._encoded_images(recording, sampled, on_image)
        with pq.ParquetWriter(path, self._schema()) as writer:
            for start in range(0, len(columns["index"]), _ROWS_PER_GROUP):
                part = {key: values[start : start + _ROWS_PER_GROUP].tolist() for key, values in columns.items()}
                part[IMAGE] = list(islice(images, _ROWS_PER_GROUP))
                writer.write_table(pa.Table.from_pydict(part, schema=self._schema()))
        statistics = {key: _describe(values) for key, values in columns.items()} | {IMAGE: sampled.described()}
        self.statistics.append(statistics)
        many = len(columns["index"])
        self.episodes.append(
            {
                "episode_index": number,
                "tasks": [self.task],
                "length": many,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self.frames,
                "dataset_to_index": self.frames + many,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
            | {f"stats/{key}/{name}": value for key, parts in statistics.items() for name, value in parts.items()}
        )
        self.frames += many

    def finish(self) -> None:
        """Write the features, the task, the episodes and the statistics of the whole."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        info = {
            "codebase_version": CODEBASE_VERSION,
            "robot_type": "ninedtact",
            "total_episodes": len(self.episodes),
            "total_frames": self.frames,
            "total_tasks": 1,
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": {"train": f"0:{len(self.episodes)}"},
            "data_path": DATA_PATH,
            "video_path": None,
            "features": self.features,
        }
        episodes = self.folder / EPISODES_PATH
        episodes.parent.mkdir(parents=True)
        (self.folder / "meta/info.json").write_text(json.dumps(info, indent=4), encoding="utf-8")
        (self.folder / "meta/stats.json").write_text(
            json.dumps(_aggregate(self.statistics), indent=4), encoding="utf-8"
        )
        pq.write_table(pa.Table.from_pylist(self.episodes), episodes)
        tasks = pa.table({"task_index": pa.array([0], pa.int64()), "task": [self.task]})
        pq.write_table(
            tasks.replace_schema_metadata({b"pandas": json.dumps(_TASK_INDEX)}), self.folder / "meta/tasks.parquet"
        )

    def _numbers(self, recording: Recording) -> dict[str, Array]:
        """Return all columns of an episode but the images."""
        stamps_ns = recording.stamps_ns(Topic.IMAGES)
        frames, time_s = np.arange(len(stamps_ns)), (stamps_ns - stamps_ns[0]) / 1e9
        columns = {
            key: _wrenches_at(recording, topic, stamps_ns) for key, topic in WRENCHES.items() if key in self.features
        }
        if STD in self.features:
            columns |= _errors_at(recording, stamps_ns)
        return columns | {
            TIME: time_s,
            "timestamp": (frames / self.fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full(len(frames), len(self.episodes)),
            "index": self.frames + frames,
            "task_index": np.zeros(len(frames), int),
        }

    def _encoded_images(
        self, recording: Recording, sampled: "_ImageStatistics", on_image: Callable[[], None]
    ) -> Iterator[dict[str, Any]]:
        """Yield the images as PNG with the names that LeRobot gives them."""
        for frame in recording.frames():
            sampled.add(frame.image)
            on_image()
            yield {"bytes": cv2.imencode(".png", frame.image)[1].tobytes(), "path": f"frame-{frame.index:06d}.png"}

    def _schema(self) -> Any:
        """Return the Arrow schema of the frames, with the features that Hugging Face's `datasets` reads."""
        import pyarrow as pa

        image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        fields: list[tuple[str, Any]] = []
        described: dict[str, dict[str, Any]] = {}
        for key, feature in self.features.items():
            value, length = {"dtype": feature["dtype"], "_type": "Value"}, feature["shape"][0]
            if feature["dtype"] == "image":
                fields.append((key, image))
                described[key] = {"_type": "Image"}
            elif length == 1:
                fields.append((key, pa.type_for_alias(feature["dtype"])))
                described[key] = value
            else:
                fields.append((key, pa.list_(pa.type_for_alias(feature["dtype"]), length)))
                described[key] = {"feature": value, "length": length, "_type": "Sequence"}
        return pa.schema(fields, {"huggingface": json.dumps({"info": {"features": described}})})


_TASK_INDEX = {
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {
            "name": "task_index",
            "field_name": "task_index",
            "pandas_type": "int64",
            "numpy_type": "int64",
            "metadata": None,
        },
        {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object", "metadata": None},
    ],
}
"""What tells pandas that the words of a task are the index of the table, as LeRobot expects."""


def _wrenches_at(recording: Recording, topic: Topic, stamps_ns: Array) -> Float64[Array, "frames 6"]:
    """Return wrenches at the times of the images; before the first and after the last wrench these are repeated."""
    wrenches = sorted(recording.wrenches(topic), key=lambda wrench: wrench.stamp_ns)
    known = np.array([wrench.stamp_ns for wrench in wrenches])
    six = np.array([wrench.six for wrench in wrenches])
    since = known[0]
    return np.stack([np.interp(stamps_ns - since, known - since, column) for column in six.T], axis=1)


def _errors_at(recording: Recording, stamps_ns: Array) -> dict[str, Array]:
    """Return standard deviations (frames, 6) and numbers of warnings (frames) of the estimates nearest before the images."""
    estimates = sorted(recording.estimates(), key=lambda one: one.wrench.stamp_ns)
    at_ns = np.array([one.wrench.stamp_ns for one in estimates])
    nearest = np.clip(np.searchsorted(at_ns, stamps_ns, side="right") - 1, 0, None)
    std = np.nan_to_num([one.std for one in estimates], nan=UNKNOWN_STD, posinf=UNKNOWN_STD)
    return {STD: std[nearest], WARNINGS: np.array([len(one.warnings) for one in estimates])[nearest]}


@dataclass
class _ImageStatistics:
    """Statistics of the three colours, red first and 0 to 1, over some images of an episode."""

    every: int
    """Which images count: each of this many."""
    seen: int = 0

    def __post_init__(self) -> None:
        self._parts: list[Array] = []

    def add(self, image: Array) -> None:
        """Take note of an image if it is its turn."""
        if self.seen % self.every == 0:
            colours = image[..., ::-1].reshape(-1, 3) / 255
            self._parts.append(np.stack([colours.min(0), colours.max(0), colours.mean(0), (colours**2).mean(0)]))
        self.seen += 1

    def described(self) -> dict[str, list[Any]]:
        """Return minimum, maximum, mean and standard deviation, each (3, 1, 1), and the number of images."""
        low, high, mean, square = np.stack(self._parts, axis=1)
        mean = mean.mean(0)
        values = (low.min(0), high.max(0), mean, np.sqrt(np.maximum(square.mean(0) - mean**2, 0)))
        named = dict(zip(("min", "max", "mean", "std"), (one.reshape(3, 1, 1).tolist() for one in values), strict=True))
        return named | {"count": [len(self._parts)]}


def _describe(values: Array) -> dict[str, list[Any]]:
    """Return minimum, maximum, mean and standard deviation of a column, and the number of its rows."""
    rows = np.atleast_2d(values.T).T
    named = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    return {name: value.tolist() for name, value in named.items()} | {"count": [len(rows)]}


def _aggregate(episodes: Sequence[Statistics]) -> Statistics:
    """Return the statistics of all episodes together."""
    return {key: _aggregate_feature([episode[key] for episode in episodes]) for key in episodes[0]}


def _aggregate_feature(parts: Sequence[dict[str, list[Any]]]) -> dict[str, list[Any]]:
    """Return the statistics of one feature over all episodes, from those of each."""
    low, high, mean, std = (np.array([part[name] for part in parts]) for name in ("min", "max", "mean", "std"))
    counts = np.array([part["count"][0] for part in parts])
    whole = np.average(mean, axis=0, weights=counts)
    spread = np.sqrt(np.average(std**2 + (mean - whole) ** 2, axis=0, weights=counts))
    named = {"min": low.min(0), "max": high.max(0), "mean": whole, "std": spread}
    return {name: value.tolist() for name, value in named.items()} | {"count": [int(counts.sum())]}
