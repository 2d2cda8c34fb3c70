"""From what a person writes after --source, --force-torque and --sensor to the source and the sensor folder it names."""

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.recording.errors import SensorUnnamed, SourcesMismatched

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import CameraSettings, FrameSource

RECORDING_SUFFIX = ".mcap"
SIM = "sim"
"""The name of the twin as a source."""


def is_recording(text: str) -> bool:
    """Return whether the text names a recording (.mcap)."""
    return text.lower().endswith(RECORDING_SUFFIX) and "://" not in text


def frame_source_for(text: str, settings: "CameraSettings") -> "FrameSource":
    """Return the source that the text names, not yet opened; a recording keeps its own stamps."""
    if is_recording(text):
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        from ninedtact.recording.recorded_source import RecordedSource

        return RecordedSource(Path(text).expanduser())
    from ninedtact.capture.source_address import source_for

    return source_for(text, settings)


def live_source(text: str, settings: "CameraSettings") -> "FrameSource":
    """Return the source that the text names, not yet opened; recordings play at their own rate with present stamps."""
    from ninedtact.capture.latest_frame import LivePlayback

    return LivePlayback(frame_source_for(text, settings))


def require_matching_sources(source: str, force_torque: str | None, *kinds: "Callable[[str], bool]") -> None:
    """Raise `SourcesMismatched` unless images and forces are both of each kind, or both not."""
    if force_torque is not None and any(kind(source) != kind(force_torque) for kind in kinds):
        raise SourcesMismatched(
            f"expected --source and --force-torque to be both devices, both {SIM} or both recordings, got '{source}' and "
            f"'{force_torque}'; name two that belong together"
        )


def is_sim(text: str) -> bool:
    """Return whether the text names the twin of the sensor."""
    return text == SIM


@contextmanager
def sensor_of(sensor: Path | None, source: str) -> "Iterator[SensorFolder]":
    """Yield the sensor that was named, or else the one that a recording carries; raises `SensorUnnamed`."""
    from tempfile import TemporaryDirectory

    from ninedtact.calibration.sensor_folder import load_sensor

    if sensor is not None:
        yield load_sensor(sensor)
        return
    if not is_recording(source):
        raise SensorUnnamed(
            f"expected --sensor with --source {source}, got none; name the folder that 'ninedtact calibrate --out' wrote"
        )
    from ninedtact.recording.errors import require_recording_libraries

    require_recording_libraries()
    from ninedtact.recording.reader import restore_sensor_folder

    with TemporaryDirectory(prefix="ninedtact_") as folder:
        yield load_sensor(restore_sensor_folder(Path(source).expanduser(), Path(folder) / "sensor"))
