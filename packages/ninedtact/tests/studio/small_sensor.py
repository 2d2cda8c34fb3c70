"""A sensor of 40 x 30 pixels whose skin is pressed in by 1 mm for every quarter of brightness lost, and its camera."""

import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from threading import Event

import cv2
import numpy as np

from ninedtact.calibration.save import to_sensor_toml
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder
from ninedtact.calibration.sensor_toml_schema import (
    SENSOR_FORMAT,
    DepthTable,
    GridTable,
    LensModelTable,
    SensorTomlRecord,
)
from ninedtact.capture.frame_pacing import LatestFrameSource
from ninedtact.capture.frame_source import CameraLost, FrameSource, SourceNotOpen
from ninedtact.design import RectifiedImageSize, SensorDesign
from ninedtact.errors import CameraError
from ninedtact.quantities import Frame
from ninedtact.sensor import Sensor
from ninedtact.shape.depth import DepthCurve, Smoothing

RAW_SHAPE, MM_PER_PX, UNTOUCHED = (48, 64), 0.5, 100
LONG_MS = 20_000.0
CURVE = DepthCurve("ratio", darkening=(0.0, 0.5), indentation_mm=(0.0, 2.0), error_mm=(0.0, 0.01))
PX_PER_MM = 1 / (MM_PER_PX * max(RAW_SHAPE) / 2)
RECORDED = SensorTomlRecord(
    format=SENSOR_FORMAT,
    id="small",
    created=datetime(2026, 1, 1, tzinfo=UTC),
    software="test",
    design=SensorDesign(field_of_view=RectifiedImageSize(30, 40, 64)),
    grid=GridTable(MM_PER_PX, *RAW_SHAPE, calibrated_area_mm=(-10.0, 10.0, -7.5, 7.5)),
    lens=LensModelTable((PX_PER_MM, 0.0, 0.0, 0.0, PX_PER_MM, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0)),
    depth=DepthTable("ratio", noise_mm=0.001, smoothing=Smoothing(0.0, 0.0), curve=CURVE),
)
SHAPE = SensorFolder(Path(), RECORDED).shape


PRESSED_PX, DARK = 8, 10
"""Side of the square in the middle that is pressed in; level below which the light is off."""


def skin(level: int) -> np.ndarray:
    """An image of skin that is pressed in by the same all over a square in the middle, or an image without light."""
    image = np.full((*RAW_SHAPE, 3), UNTOUCHED if level > DARK else level, np.uint8)
    middle = tuple(slice((side - PRESSED_PX) // 2, (side + PRESSED_PX) // 2) for side in RAW_SHAPE)
    image[middle] = level
    return image


def image_folder(path: Path, *levels: int) -> Path:
    """A new folder of images of skins."""
    path.mkdir()
    for number, level in enumerate(levels):
        cv2.imwrite(str(path / f"{number:02}.png"), skin(level))
    return path


def sensor_folder(path: Path) -> Path:
    path.mkdir()
    (path / SENSOR_FILE).write_bytes(to_sensor_toml(RECORDED))
    return path


def sensor_on(source: FrameSource, reference_frames: int = 2) -> Sensor:
    """The sensor on a source, patient enough for a busy machine."""
    return Sensor(
        LatestFrameSource(source, max_age_ms=LONG_MS, timeout_ms=1000.0), SHAPE, reference_frames=reference_frames
    )


class SkinCamera(FrameSource):
    """Delivers an image every few ms, at the brightness that the test sets, while it is plugged in."""

    def __init__(self, period_s: float = 0.004) -> None:
        self.name = "the bench camera"
        self.level, self.plugged_in = UNTOUCHED, True
        self._period_s = period_s
        self._closed = Event()
        self._next_index = 0

    def open(self) -> None:
        if not self.plugged_in:
            raise CameraError(f"expected {self.name}, got none; plug it in")
        self._closed, self._next_index = Event(), 0

    def read(self) -> Frame:
        if self._closed.wait(self._period_s):
            raise SourceNotOpen(self.name)
        if not self.plugged_in:
            raise CameraLost(f"expected an image from {self.name}, got none; plug it in")
        self._next_index += 1
        return Frame(skin(self.level), time.monotonic_ns(), self._next_index - 1)

    def close(self) -> None:
        self._closed.set()


def wait_until(is_true: Callable[[], bool], limit_s: float = 60.0, pause_s: float = 0.01) -> None:
    give_up_at = time.monotonic() + limit_s
    while not is_true():
        assert time.monotonic() < give_up_at
        time.sleep(pause_s)
