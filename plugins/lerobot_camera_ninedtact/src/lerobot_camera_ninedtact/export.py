"""Recordings as a LeRobotDataset, one recording an episode: what `ninedtact export --to lerobot` calls."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from numpy.typing import NDArray

from lerobot_camera_ninedtact.tracking_features import TRACKING_NAMES, tracking_values
from ninedtact.atomic_write import create_folder_atomically
from ninedtact.errors import InputError
from ninedtact.recording.episode_sensors import write_episode_sensors
from ninedtact.recording.export import WRENCH_COLUMNS, require_empty_folder, require_exportable
from ninedtact.recording.followed_recording import follow_recording
from ninedtact.recording.reader import Recording
from ninedtact.recording.summary import usual_rate_hz
from ninedtact.recording.topics_and_messages import Topic

SENSORS = "ninedtact"
"""Folder of the data set with name, calibration and reference image of the sensor of each episode."""
IMAGE, TIME = "observation.images.tactile", "observation.time_s"
MEASURED, ESTIMATED = "observation.wrench", "observation.wrench_estimated"
"""The wrench of the force/torque sensor and that of the estimator, each where the recordings hold it."""
STD, WARNINGS = "observation.wrench_estimated_std", "wrench_estimated_warnings"
TRACKING = "observation.tracking"
"""Contacts, motion and slip (`tracking_features`)."""
UNKNOWN_STD = 1e6
"""Standard deviation in N and N·m of an estimate that knows nothing, in place of infinity, which statistics cannot hold."""
_RATE_TOLERANCE = 0.05
"""Relative difference from the common rate up to which recordings are taken to have it: two recordings of one camera differ."""
_MOST_FPS = 1000
_MOST_REPEATS = 1000
"""Frames for each image, on average, up to which a recording may be filled with repeated images at --fps."""


def export_lerobot(
    recordings: Sequence[Recording],
    out: Path,
    task: str = "touch",
    on_image: Callable[[], None] = lambda: None,
    fps: int | None = None,
    tracking: bool = False,
) -> dict[str, int]:
    """Write recordings as the episodes of one data set into a new or empty folder; return its episodes, frames and features.

    task: what is done in them, in words. fps: frames per second of the data set, for each of which the nearest image is taken;
    None takes all images, at the rate that the recordings have in common. Wrenches are interpolated linearly at the times of the
    images. tracking: add contacts, motion and slip. Raises `OutputError`, `InputError` for recordings that cannot be episodes of
    one data set, and `RecordingUnreadable` for a damaged recording; the folder is then as it was before.
    """
    require_empty_folder(out)
    for recording in recordings:
        require_exportable([recording])
    kind, rate_hz = _common_kind(recordings), _frames_per_second(recordings, fps)
    with create_folder_atomically(out) as folder:
        root = folder / "set"  # which LeRobot wants to create
        written = LeRobotDataset.create(
            f"local/{out.name}", rate_hz, kind.features(tracking), root, robot_type="ninedtact", use_videos=False
        )
        for recording in recordings:
            stamps_ns = recording.stamps_ns(Topic.IMAGES)
            times = _frames_of_images(stamps_ns, fps)
            for row, number in zip(_rows(recording, kind, stamps_ns, tracking), times, strict=True):
                for _ in range(number):
                    written.add_frame(row | {"task": task})
                on_image()
            written.save_episode()
        written.finalize()
        for part in root.iterdir():
            part.rename(folder / part.name)
        root.rmdir()
        write_episode_sensors(recordings, folder / SENSORS)
    meta = written.meta
    return {"episodes": meta.total_episodes, "frames": meta.total_frames, "features": len(meta.features)}


@dataclass(frozen=True)
class _EpisodeKind:
    image_shape: tuple[int, ...]
    wrenches: tuple[str, ...]
    """The features of the wrenches that the recording holds."""

    @classmethod
    def of_recording(cls, recording: Recording) -> "_EpisodeKind":
        """Return the kind of a recording."""
        topics = {MEASURED: Topic.MEASURED, ESTIMATED: Topic.ESTIMATED}
        wrenches = tuple(key for key, topic in topics.items() if len(recording.positions(topic)))
        first = next(recording.frames(), None)
        shape = (0, 0, 0) if first is None else first.image.shape
        return cls(shape, wrenches)

    def __str__(self) -> str:
        rows, cols, _ = self.image_shape
        wrenches = " and ".join(key.removeprefix("observation.") for key in self.wrenches) or "no wrench"
        return f"{cols} x {rows} px and {wrenches}"

    def features(self, tracking: bool) -> dict[str, Any]:
        """Return the features of the data set, without those that LeRobot adds."""
        image = {"dtype": "image", "shape": self.image_shape, "names": ["height", "width", "channels"]}
        six = {"dtype": "float32", "shape": (6,), "names": list(WRENCH_COLUMNS)}
        features = {IMAGE: image, **dict.fromkeys(self.wrenches, six)}
        if ESTIMATED in self.wrenches:
            features |= {STD: six, WARNINGS: {"dtype": "int64", "shape": (1,), "names": None}}
        if tracking:
            features[TRACKING] = {"dtype": "float32", "shape": (len(TRACKING_NAMES),), "names": list(TRACKING_NAMES)}
        return features | {TIME: {"dtype": "float64", "shape": (1,), "names": None}}


def _common_kind(recordings: Sequence[Recording]) -> _EpisodeKind:
    if not recordings:
        raise InputError(expected="at least one recording", got="none", remedy="give one")
    kinds = [_EpisodeKind.of_recording(recording) for recording in recordings]
    for recording, kind in zip(recordings, kinds, strict=True):
        if kind != kinds[0]:
            raise InputError(
                expected="recordings with images of one size and with the same wrenches",
                got=f"{recordings[0].path} with {kinds[0]} and {recording.path} with {kind}",
                remedy="export them separately",
            )
    if 0 in kinds[0].image_shape:
        raise InputError(expected="a recording with images", got="one without", remedy="record a camera")
    return kinds[0]


def _frames_per_second(recordings: Sequence[Recording], fps: int | None) -> int:
    """Return the rate of the data set, a whole number: `fps`, or the median of the recordings' rates.

    Raises `InputError` where a recording has another rate and `fps` is None. One image has any rate.
    """
    if fps is not None:
        if not 1 <= fps <= _MOST_FPS:
            raise InputError(expected=f"1 to {_MOST_FPS} frames per second", got=f"{fps}", remedy="give another --fps")
        return fps
    stamps_ns = {recording.path: recording.stamps_ns(Topic.IMAGES) for recording in recordings}
    rates_hz = {path: usual_rate_hz(stamps) for path, stamps in stamps_ns.items() if len(stamps) > 1}
    common_hz = float(np.median([*rates_hz.values()])) if rates_hz else usual_rate_hz(np.empty(0, np.int64))
    for path, rate_hz in rates_hz.items():
        if abs(rate_hz - common_hz) > _RATE_TOLERANCE * common_hz:
            raise InputError(
                expected=f"recordings within {_RATE_TOLERANCE:.0%} of one rate, here {common_hz:.1f} Hz",
                got=f"{path} at {rate_hz:.1f} Hz",
                remedy="give the data set a rate with --fps, which takes the nearest images, or export it separately",
            )
    whole_hz = max(1, round(common_hz))
    if abs(whole_hz - common_hz) > _RATE_TOLERANCE * common_hz:
        raise InputError(
            expected=f"a rate within {_RATE_TOLERANCE:.0%} of a whole number of frames per second",
            got=f"{common_hz:.2g} Hz",
            remedy="give the data set a rate with --fps, which takes the nearest images",
        )
    return whole_hz


def _frames_of_images(stamps_ns: NDArray[np.int64], fps: int | None) -> NDArray[np.int64]:
    """Return how many frames show each image: one, or as many of the times k / fps as are nearest to it."""
    if fps is None:
        return np.ones(len(stamps_ns), np.int64)
    since_ns = stamps_ns - stamps_ns[0]
    frames = int(since_ns.max()) * fps // 10**9
    if frames > _MOST_REPEATS * len(stamps_ns):
        raise InputError(
            expected=f"at most {_MOST_REPEATS} frames for each image",
            got=f"{len(stamps_ns)} images in {since_ns.max() * 1e-9:.0f} s, which are {frames} frames",
            remedy="leave out --fps, or take a lower rate",
        )
    frames_ns = np.arange(int(since_ns.max() * fps * 1e-9 + 0.5) + 1) * (1e9 / fps)
    order = np.argsort(since_ns, kind="stable")
    ahead = np.searchsorted((since_ns[order][1:] + since_ns[order][:-1]) / 2, frames_ns)
    return np.bincount(order[ahead], minlength=len(stamps_ns))


def _rows(
    recording: Recording, kind: _EpisodeKind, stamps_ns: NDArray[np.int64], tracking: bool
) -> Iterator[dict[str, Any]]:
    columns = {TIME: ((stamps_ns - stamps_ns[0]) / 1e9)[:, None]}
    if MEASURED in kind.wrenches:
        columns[MEASURED] = _wrenches_at(recording, Topic.MEASURED, stamps_ns)
    if ESTIMATED in kind.wrenches:
        columns[ESTIMATED] = _wrenches_at(recording, Topic.ESTIMATED, stamps_ns)
        columns |= _errors_at(recording, stamps_ns)
    if tracking:
        found = follow_recording(recording)
        columns[TRACKING] = np.array([tracking_values(one) for one in found], np.float32)
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
