"""What a person names after --source and --force-torque, from whichever room it comes."""

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import CameraSettings, FrameSource
    from ninedtact.capture.wrench_source import WrenchSource

RECORDING = ".mcap"


SIM = "sim"
"""The name of the twin as a source."""


class DevicesApart(NinedtactError):
    """A camera and a force/torque sensor that cannot belong together."""


class SensorUnnamed(NinedtactError):
    """Neither --sensor nor a recording that carries its sensor."""


def is_recording(text: str) -> bool:
    """Whether the text names a file that `ninedtact record` or `collect` writes."""
    return text.lower().endswith(RECORDING) and "://" not in text


def source_named(text: str, settings: "CameraSettings") -> "FrameSource":
    """The source that the text names, not yet opened; a recording with the stamps that it was made with."""
    if is_recording(text):
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        from ninedtact.recording.recorded_source import RecordedSource

        return RecordedSource(Path(text).expanduser())
    from ninedtact.capture.source_address import source_for

    return source_for(text, settings)


def live_source(text: str, settings: "CameraSettings") -> "FrameSource":
    """The same, all that was recorded as if it were now."""
    from ninedtact.capture.latest_frame import LivePlayback

    return LivePlayback(source_named(text, settings))


def device(text: str, on_lost: "Callable[[Exception], None]", on_back: "Callable[[], None]") -> "WrenchSource":
    """The force/torque sensor that the text names, in its own frame, reopened when it was lost."""
    from ninedtact.capture.force_torque.pipeline import force_torque_sensor_for
    from ninedtact.capture.reconnecting import ReconnectingWrenchSource

    return ReconnectingWrenchSource(force_torque_sensor_for(text), on_lost, on_back)


def require_alike(source: str, force_torque: str | None, *kinds: "Callable[[str], bool]") -> None:
    """Refuse images and forces that are not of the same time; raises `DevicesApart`."""
    if force_torque is not None and any(kind(source) != kind(force_torque) for kind in kinds):
        raise DevicesApart(
            f"expected --source and --force-torque to be both devices, both {SIM} or both recordings, got '{source}' and "
            f"'{force_torque}'; name two that belong together"
        )


def is_sim(text: str) -> bool:
    """Whether the text names the twin."""
    return text == SIM


@contextmanager
def sensor_of(sensor: Path | None, source: str) -> "Iterator[SensorFolder]":
    """The sensor that was named, else the one that a recording carries; raises `SensorUnnamed`."""
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
