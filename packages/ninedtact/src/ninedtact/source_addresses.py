"""The sources that addresses name, as a person writes them after `--source`: a camera, stream, video, folder, recording, or the
twin; and the sensor folder that belongs to one.

The cameras, streams and files of `capture` are listed in `capture.source_from_address.SOURCE_TYPES`; a recording and the twin need
the packages that are imported here, when they are named.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.bounds import checks_arguments
from ninedtact.errors import InputError
from ninedtact.recording.errors import require_recording_libraries

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import CameraSettings, FrameSource

SIMULATED = "sim"
"""Name of the sensor's twin as a source."""
RECORDING_SUFFIX = ".mcap"
_RECORDING_ADDRESS = re.compile(rf".*{re.escape(RECORDING_SUFFIX)}(#\w+)?", re.IGNORECASE | re.DOTALL)


def is_recording_address(text: str) -> bool:
    """Return whether the text names a file that `ninedtact record` or `collect` writes, or one sensor of it: `grasp.mcap#left`."""
    return _RECORDING_ADDRESS.fullmatch(text) is not None and "://" not in text


def is_twin_address(text: str) -> bool:
    """Return whether the text names the twin of the sensor."""
    return text == SIMULATED


@checks_arguments
def source_for(
    text: str, settings: "CameraSettings | None" = None, sensor: "SensorFolder | None" = None
) -> "FrameSource":
    """Return the source that `text` names, not yet opened.

    `text` is a camera, stream, video file, folder of images, recording (.mcap) or "sim", the twin of `sensor`. Without a
    sensor it is the default twin. `settings` apply to cameras on this computer, which are set to the size of `sensor`. Raises
    `InputError`.

    >>> ninedtact.source_for("0").name
    'camera 0'
    """
    if is_twin_address(text):
        from ninedtact.simulation.simulated_sources import demo_sources
        from ninedtact.simulation.twin import default_twin

        return demo_sources(default_twin() if sensor is None else sensor.twin()).camera
    if is_recording_address(text):
        require_recording_libraries()
        from ninedtact.recording.recorded_source import RecordedFrameSource

        return RecordedFrameSource(Path(text).expanduser())
    from ninedtact.capture import source_from_address
    from ninedtact.capture.frame_source import DEFAULT_CAMERA

    settings = settings or DEFAULT_CAMERA
    if sensor is not None:
        settings = replace(settings, size_px=(sensor.record.grid.raw_cols, sensor.record.grid.raw_rows))
    return source_from_address.camera_or_file_source(text, settings)


def source_in_real_time(
    text: str,
    settings: "CameraSettings | None" = None,
    notify: Callable[[str], None] | None = None,
    sensor: "SensorFolder | None" = None,
    keeps_times: bool = False,
) -> "FrameSource":
    """Return the source that `text` names; files and recordings play at their own pace, stamped as their frames are read.

    notify: receives a sentence where images of a file are missing or damaged; without it, reading raises this at the end.
    keeps_times: frames that a slow computer delivers late keep their times (`LivePlayback`).
    """
    from ninedtact.capture.frame_pacing import LivePlayback

    return LivePlayback(source_for(text, settings, sensor), notify, keeps_times)


def require_matching_force_source(source: str, force_torque: str | None, *kinds: "Callable[[str], bool]") -> None:
    """Raise `InputError` unless images and forces come from the same kind: devices, a simulation or recordings."""
    if force_torque is not None and any(kind(source) != kind(force_torque) for kind in kinds):
        raise InputError(
            expected=f"--source and --force-torque to be both devices, both {SIMULATED} or both recordings",
            got=f"'{source}' and '{force_torque}'",
            remedy="name two that belong together",
        )


@contextmanager
def load_recorded_sensor(source: "str | FrameSource") -> "Iterator[SensorFolder]":
    """Load the sensor that a recording carries, which stays usable when its files are deleted at the end of the block.

    Raises `InputError` for another source, `SensorFolderDamaged`.
    """
    recording = source.recording if not isinstance(source, str) else source if is_recording_address(source) else None
    if recording is None:
        name = source if isinstance(source, str) else source.name
        raise InputError(
            expected=f"--sensor with --source {name}",
            got="none",
            remedy="name the folder that 'ninedtact calibrate --out' wrote",
        )
    require_recording_libraries()
    from ninedtact.recording.reader import Recording

    with Recording(Path(recording).expanduser()) as opened, opened.unpacked_sensor() as sensor:
        yield sensor
