"""The sensor of every episode of an exported data set, whose images alone do not say how to measure them.

episodes.json                 for each episode: name and calibration of the sensor, the recording, its reference image (no contact)
references/episode_000000.*   .png: the mean of raw images; .npy: a rectified one, whose grey levels are no whole numbers
sensors/CHECKSUM/             the sensor folder of each calibration
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path

import cv2
import msgspec
import numpy as np

from ninedtact.atomic_write import write_file_atomically, write_files_atomically
from ninedtact.capture.strict_image_reading import average_images
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic, decode_reference_grey
from ninedtact.shape.calibrated_shape import REFERENCE_FRAMES

EPISODES_FILE = "episodes.json"


@dataclass(frozen=True)
class EpisodeSensor:
    """The sensor of one episode; paths are within the folder of the list."""

    episode: int
    sensor: str
    """Name of the sensor, as in its sensor.toml."""
    calibration_checksum: str
    """`SensorFolder.calibration_checksum`; empty where the recording carries no sensor folder."""
    sensor_folder: str
    recording: str
    """`RecordingMetadata.id`."""
    reference: str
    """The first reference image; empty for a recording without an image."""
    references_in_recording: int
    """Number of reference images that the recording holds; 0 where its first images are the reference."""


def write_episode_sensors(recordings: Sequence[Recording], folder: Path) -> list[EpisodeSensor]:
    """Write the sensors of recordings, which are the episodes of one data set in this order, into a folder.

    Raises what reading a recording raises, and `FileNotWritten`.
    """
    episodes = []
    for number, recording in enumerate(recordings):
        files, checksum = recording.sensor_files(), recording.calibration_checksum
        place = f"sensors/{checksum}" if files else ""
        if files and not (folder / place).exists():
            write_files_atomically(folder / place, list(files.items()))
        references = len(recording.positions(Topic.REFERENCE_GREY)) or len(recording.positions(Topic.REFERENCE))
        reference = _write_first_reference(recording, folder, f"references/episode_{number:06d}")
        identity = recording.sensor, checksum, place, recording.metadata.id
        episodes.append(EpisodeSensor(number, *identity, reference, references))
    content = msgspec.json.format(msgspec.json.encode([asdict(one) for one in episodes]), indent=1)
    write_file_atomically(folder / EPISODES_FILE, content)
    return episodes


def _write_first_reference(recording: Recording, folder: Path, name: str) -> str:
    """Write the reference image with which a recording begins; return its file, empty where it has no image."""
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    rectified = next(recording.messages(Topic.REFERENCE_GREY), None)
    if rectified is not None:
        np.save(folder / f"{name}.npy", recording.decode(rectified, decode_reference_grey), allow_pickle=False)
        return f"{name}.npy"
    frames = list(islice(recording.frames(Topic.REFERENCE), REFERENCE_FRAMES))
    frames = [frame for frame in frames if frame.index == frames[0].index]  # of the first tare
    frames = frames or list(islice(recording.frames(), REFERENCE_FRAMES))
    if not frames:
        return ""
    mean = average_images([frame.image for frame in frames])
    write_file_atomically(folder / f"{name}.png", cv2.imencode(".png", mean)[1].tobytes())
    return f"{name}.png"
