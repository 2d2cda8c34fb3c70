"""Devices on the test bench, behind the one seam where the package opens a camera; stubborn, and easily unplugged."""

import time
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

Size = tuple[int, int]


@dataclass
class BenchCamera:
    """A UVC camera as Video4Linux shows it: fixed modes, clamped controls, exposure only by hand, a driver's queue."""

    plugged_in: bool = True
    limits: dict[int, tuple[float, float]] = field(
        default_factory=lambda: {
            cv2.CAP_PROP_AUTO_EXPOSURE: (0, 3),
            cv2.CAP_PROP_EXPOSURE: (1, 5000),
            cv2.CAP_PROP_GAIN: (0, 100),
            cv2.CAP_PROP_AUTO_WB: (0, 1),
            cv2.CAP_PROP_WB_TEMPERATURE: (2800, 6500),
            cv2.CAP_PROP_AUTOFOCUS: (0, 1),
            cv2.CAP_PROP_FOCUS: (0, 250),
        }
    )
    modes: dict[str, tuple[Size, ...]] = field(
        default_factory=lambda: dict.fromkeys(("YUYV", "MJPG"), ((320, 240), (640, 480)))
    )
    """Sizes of each pixel format; the nearest one is taken."""
    free_bytes_per_s: float = float("inf")
    """What other cameras leave of the USB: uncompressed images that need more never arrive."""
    channels: int | None = 3
    """Of an image; None for a grey camera whose images have rows and columns alone."""
    rates_hz: tuple[float, ...] = (29.97, 60.0)
    manual_and_automatic: tuple[float, float] = (1, 3)
    """Numbers of its two modes of exposure; others are not taken."""
    driver_delay_ms: float | None = None
    damaged_images: int = 0
    shown: int = 0
    held: int = 0
    """Captures that are open now."""

    def open_capture(self, device: int | str) -> "BenchCapture":
        self.held += 1
        return BenchCapture(self)


class BenchCapture:
    """What OpenCV would have made of it."""

    def __init__(self, camera: BenchCamera) -> None:
        self.camera = camera
        self.released = False
        self.wanted = [640.0, 480.0]
        self.pixel_format = next(iter(camera.modes))
        self.values: dict[int, float] = {prop: least for prop, (least, _) in camera.limits.items()}
        self.values |= {
            cv2.CAP_PROP_AUTO_EXPOSURE: camera.manual_and_automatic[1],
            cv2.CAP_PROP_FPS: camera.rates_hz[0],
            cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*self.pixel_format),
        }
        if cv2.CAP_PROP_AUTOFOCUS in camera.limits:
            self.values[cv2.CAP_PROP_AUTOFOCUS] = 1

    def isOpened(self) -> bool:  # noqa: N802
        return self.camera.plugged_in and not self.released

    def get(self, prop: int, /) -> float:
        if prop in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT):
            return float(self.mode()[prop == cv2.CAP_PROP_FRAME_HEIGHT])
        if prop == cv2.CAP_PROP_POS_MSEC and self.camera.driver_delay_ms is not None:
            return time.monotonic_ns() / 1e6 - self.camera.driver_delay_ms
        return float(self.values.get(prop, -1.0))

    def set(self, prop: int, value: float, /) -> bool:
        if prop in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT):
            self.wanted[prop == cv2.CAP_PROP_FRAME_HEIGHT] = value
        elif prop == cv2.CAP_PROP_FPS:
            self.values[prop] = min(self.camera.rates_hz, key=lambda rate: abs(rate - value))
        elif prop == cv2.CAP_PROP_FOURCC and (asked := int(value).to_bytes(4, "little").decode()) in self.camera.modes:
            self.pixel_format, self.values[prop] = asked, value
        elif prop == cv2.CAP_PROP_AUTO_EXPOSURE and value not in self.camera.manual_and_automatic:
            return False
        elif prop in self.camera.limits and not self.locked(prop):
            self.values[prop] = float(np.clip(value, *self.camera.limits[prop]))
        else:
            return False
        return True

    def locked(self, prop: int) -> bool:
        return (
            prop == cv2.CAP_PROP_EXPOSURE
            and self.values[cv2.CAP_PROP_AUTO_EXPOSURE] == self.camera.manual_and_automatic[1]
        )

    def mode(self) -> tuple[int, int]:
        return min(
            self.camera.modes[self.pixel_format],
            key=lambda mode: abs(mode[0] - self.wanted[0]) + abs(mode[1] - self.wanted[1]),
        )

    def read(self) -> tuple[bool, Any]:
        time.sleep(0.002)
        if self.released or not self.camera.plugged_in:
            return False, None
        if self.camera.damaged_images:
            self.camera.damaged_images -= 1
            return False, None
        cols, rows = self.mode()
        bytes_per_s = 2 * cols * rows * self.values[cv2.CAP_PROP_FPS]
        if self.pixel_format != "MJPG" and bytes_per_s > self.camera.free_bytes_per_s:
            return False, None
        self.camera.shown += 1
        shape = (rows, cols) if self.camera.channels is None else (rows, cols, self.camera.channels)
        return True, np.full(shape, self.camera.shown % 256, np.uint8)

    def release(self) -> None:
        self.camera.held -= not self.released
        self.released = True


class BenchPi:
    """A ribbon-cable camera as picamera2 shows it: controls arrive a few images late, exposure is limited."""

    camera_controls: tuple[str, ...] = ("FrameRate", "AeEnable", "ExposureTime", "AnalogueGain", "AwbEnable")

    def __init__(self, number: int = 0, late_images: int = 3) -> None:
        self.late_images = late_images
        self.shown = 0
        self.controls: dict[str, float] = {}
        self.is_silent = self.is_closed = False

    def create_video_configuration(self, **configuration: Any) -> dict[str, Any]:
        return configuration

    def configure(self, configuration: dict[str, Any]) -> None:
        self.configuration = configuration
        self.cols, self.rows = configuration["main"]["size"]
        self.controls = configuration["controls"]

    def start(self) -> None: ...

    def close(self) -> None:
        self.is_closed = True

    def capture_arrays(self, names: list[str], wait: bool) -> Any:
        return self.get_result() if wait else self

    def get_result(self, timeout: float | None = None) -> tuple[list[np.ndarray], dict[str, float]]:
        if self.is_silent:
            raise TimeoutError(timeout)
        self.shown += 1
        exposure = min(self.controls.get("ExposureTime", 0), 20_000) if self.shown > self.late_images else 5
        image = np.full((self.rows, self.cols, 3), self.shown % 256, np.uint8)
        return [image], {"ExposureTime": exposure, "AnalogueGain": self.controls.get("AnalogueGain", 1.0)}
