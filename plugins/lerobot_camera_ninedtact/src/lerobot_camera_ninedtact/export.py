"""Recordings as a LeRobotDataset, one recording an episode: what `ninedtact export --to lerobot` calls."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from numpy.typing import NDArray

from ninedtact.atomic_write import create_folder_atomically
from ninedtact.errors import InputError
from ninedtact.recording.export import WRENCH_COLUMNS, require_empty_folder, require_exportable
from ninedtact.recording.reader import Recording
from ninedtact.recording.summary import median_rate_hz
from ninedtact.recording.topics_and_messages import Topic

IMAGE, TIME = "observation.images.tactile", "observation.time_s"
MEASURED, ESTIMATED = "observation.wrench", "observation.wrench_estimated"
"""The wrench of the force/torque sensor and that of the estimator, each where the recordings hold it."""
STD, WARNINGS = "observation.wrench_estimated_std", "wrench_estimated_warnings"
UNKNOWN_STD = 1e6
"""Standard deviation in N and N·m of an estimate that knows nothing, in place of infinity, which statistics cannot hold."""


def export_lerobot(
    recordings: Sequence[Recording], out: Path, task: str = "touch", on_image: Callable[[], None] = lambda: None
) -> dict[str, int]:
    """Write recordings as the episodes of one data set into a new or empty folder; return its episodes, frames and features.

    task: what is done in them, in words. Wrenches are interpolated linearly at the times of the images. Raises `OutputError`,
    `InputError` for recordings that cannot be episodes of one data set, and `RecordingUnreadable` for a damaged recording; the
    folder is then as it was before.
    """
    require_empty_folder(out)
    for recording in recordings:
        require_exportable([recording])
    kind = _common_kind(recordings)
    with create_folder_atomically(out) as folder:
        root = folder / "set"  # which LeRobot wants to create
        written = LeRobotDataset.create(
            f"local/{out.name}", kind.fps, kind.features(), root, robot_type="ninedtact", use_videos=False
        )
        for recording in recordings:
            for row in _rows(recording, kind):
                written.add_frame(row | {"task": task})
                on_image()
            written.save_episode()
        written.finalize()
        for part in root.iterdir():
            part.rename(folder / part.name)
        root.rmdir()
    meta = written.meta
    return {"episodes": meta.total_episodes, "frames": meta.total_frames, "features": len(meta.features)}


@dataclass(frozen=True)
class _EpisodeKind:
    image_shape: tuple[int, ...]
    wrenches: tuple[str, ...]
    """The features of the wrenches that the recording holds."""
    fps: int

    @classmethod
    def of_recording(cls, recording: Recording) -> "_EpisodeKind":
        """Return the kind of a recording."""
        topics = {MEASURED: Topic.MEASURED, ESTIMATED: Topic.ESTIMATED}
        wrenches = tuple(key for key, topic in topics.items() if len(recording.positions(topic)))
        first = next(recording.frames(), None)
        shape = (0, 0, 0) if first is None else first.image.shape
        return cls(shape, wrenches, max(1, round(median_rate_hz(recording.stamps_ns(Topic.IMAGES)))))

    def __str__(self) -> str:
        rows, cols, _ = self.image_shape
        wrenches = " and ".join(key.removeprefix("observation.") for key in self.wrenches) or "no wrench"
        return f"{cols} x {rows} px at {self.fps} Hz and {wrenches}"

    def features(self) -> dict[str, Any]:
        """Return the features of the data set, without those that LeRobot adds."""
        image = {"dtype": "image", "shape": self.image_shape, "names": ["height", "width", "channels"]}
        six = {"dtype": "float32", "shape": (6,), "names": list(WRENCH_COLUMNS)}
        features = {IMAGE: image, **dict.fromkeys(self.wrenches, six)}
        if ESTIMATED in self.wrenches:
            features |= {STD: six, WARNINGS: {"dtype": "int64", "shape": (1,), "names": None}}
        return features | {TIME: {"dtype": "float64", "shape": (1,), "names": None}}


def _common_kind(recordings: Sequence[Recording]) -> _EpisodeKind:
    if not recordings:
        raise InputError(expected="at least one recording", got="none", remedy="give one")
    kinds = [_EpisodeKind.of_recording(recording) for recording in recordings]
    for recording, kind in zip(recordings, kinds, strict=True):
        if kind != kinds[0]:
            raise InputError(
                expected="recordings with images of one size, at one rate and with the same wrenches",
                got=f"{recordings[0].path} with {kinds[0]} and {recording.path} with {kind}",
                remedy="export them separately",
            )
    if 0 in kinds[0].image_shape:
        raise InputError(expected="a recording with images", got="one without", remedy="record a camera")
    return kinds[0]


def _rows(recording: Recording, kind: _EpisodeKind) -> Iterator[dict[str, Any]]:
    stamps_ns = recording.stamps_ns(Topic.IMAGES)
    columns = {TIME: ((stamps_ns - stamps_ns[0]) / 1e9)[:, None]}
    if MEASURED in kind.wrenches:
        columns[MEASURED] = _wrenches_at(recording, Topic.MEASURED, stamps_ns)
    if ESTIMATED in kind.wrenches:
        columns[ESTIMATED] = _wrenches_at(recording, Topic.ESTIMATED, stamps_ns)
        columns |= _errors_at(recording, stamps_ns)
    for number, frame in enumerate(recording.frames()):
        yield {IMAGE: frame.image[..., ::-1].copy()} | {key: values[number] for key, values in columns.items()}


def _wrenches_at(recording: Recording, topic: Topic, stamps_ns: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return wrenches (frames, 6) at the times of the images; before the first and after the last these are repeated."""
    wrenches = sorted(recording.wrenches(topic), key=lambda wrench: wrench.stamp_ns)
    known_ns, six = np.array([wrench.stamp_ns for wrench in wrenches]), np.array([wrench.six for wrench in wrenches])
    since_ns = known_ns[0]
    columns = [np.interp(stamps_ns - since_ns, known_ns - since_ns, column) for column in six.T]
    return np.stack(columns, axis=1).astype(np.float32)


def _errors_at(recording: Recording, stamps_ns: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Return standard deviations (frames, 6) and numbers of warnings (frames, 1) of the estimates nearest before the images."""
    estimates = sorted(recording.estimates(), key=lambda one: one.wrench.stamp_ns)
    at_ns = np.array([one.wrench.stamp_ns for one in estimates])
    nearest = np.clip(np.searchsorted(at_ns, stamps_ns, side="right") - 1, 0, None)
    std = np.nan_to_num([one.std for one in estimates], nan=UNKNOWN_STD, posinf=UNKNOWN_STD).astype(np.float32)
    return {STD: std[nearest], WARNINGS: np.array([[len(one.warnings)] for one in estimates])[nearest]}
