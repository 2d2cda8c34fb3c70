"""A camera on this machine: UVC and everything else that Video4Linux knows, opened through OpenCV."""

import os
import sys
import time
from collections.abc import Callable

import cv2

from ninedtact.capture.chatter import hush_video
from ninedtact.capture.devices import why_closed
from ninedtact.capture.grabber import Capture, Grabber
from ninedtact.capture.settings import AS_SENSOR, CameraSettings, apply, settings_in_force
from ninedtact.capture.source import CameraLost, CameraNotFound, FrameSource, SourceNotOpen
from ninedtact.quantities import Frame

SILENCE_LIMIT_S = 2
DAMAGED_IN_A_ROW = 3
OLDEST_DRIVER_STAMP_NS = 10_000_000_000

Opener = Callable[[int | str], Capture]
"""Turns a device into a capture, opened or not; the one place where the package touches a camera."""


def open_capture(device: int | str) -> Capture:
    """Open a Video4Linux device; on other systems, whatever OpenCV uses there (settings are then often refused)."""
    # OpenCV waits ten seconds for a camera that went silent, unless told otherwise before its first image.
    os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(SILENCE_LIMIT_S))
    hush_video()
    return cv2.VideoCapture(device, cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY)


class Camera(FrameSource):
    """A camera by number or path (`0`, `/dev/video0`; `/dev/v4l/by-id/…` stays the same in another socket)."""

    def __init__(
        self, device: int | str = 0, settings: CameraSettings = AS_SENSOR, opener: Opener = open_capture
    ) -> None:
        self.device = device
        self.settings = settings
        self.name = f"camera {device}"
        self._opener = opener
        self._grabber: Grabber | None = None

    @property
    def settings_in_force(self) -> CameraSettings:
        """What the open camera says it is set to."""
        return self._open_grabber().ask(settings_in_force)

    def open(self) -> None:
        """Open, set, read back, and see one image; raises `CameraNotFound` or `SettingRefused`."""
        if self._grabber is None:
            capture = self._opener(self.device)
            try:
                self._grabber = self._proven(capture)
            except BaseException:
                capture.release()
                raise

    def read(self) -> Frame:
        """Wait for the next image; `CameraLost` after two seconds of silence."""
        frame = patiently(self._open_grabber())
        if frame is None:
            raise CameraLost(f"expected an image from {self.name}, got none; see that it is plugged in")
        return frame

    def close(self) -> None:
        """Release the device."""
        grabber, self._grabber = self._grabber, None
        if grabber is not None:
            grabber.release()

    def _open_grabber(self) -> Grabber:
        if self._grabber is None:
            raise SourceNotOpen(self.name)
        return self._grabber

    def _proven(self, capture: Capture) -> Grabber:
        if not capture.isOpened():
            raise CameraNotFound(f"expected {self.name} to open, got {why_closed(self.device)}")
        apply(self.settings, capture, self.name)
        grabber = Grabber(self.name, capture, arrival_ns)
        if patiently(grabber) is None:
            raise CameraNotFound(f"expected an image from {self.name}, got none; plug it in again, or try another one")
        grabber.next_index = 0  # the first image after opening is often half exposed and is not counted
        return grabber


def patiently(grabber: Grabber) -> Frame | None:
    """Read over a few damaged images, which a cheap USB board delivers now and then; None where nothing comes."""
    give_up_at = time.monotonic() + SILENCE_LIMIT_S
    for _ in range(DAMAGED_IN_A_ROW):
        frame = grabber.read()
        if frame is not None or time.monotonic() > give_up_at:
            return frame
    return None


def arrival_ns(capture: Capture) -> int:
    """When the image reached the driver, if it says so on the monotonic clock; otherwise now.

    A driver queues a few images: one that is read late was taken earlier, and its stamp must say so.
    """
    now = time.monotonic_ns()
    driver = int(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
    return driver if 0 <= now - driver < OLDEST_DRIVER_STAMP_NS else now
