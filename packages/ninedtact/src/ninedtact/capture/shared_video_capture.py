"""An opened cv2.VideoCapture that several threads may use: no device is released while another thread reads it."""

import os
import time
from collections.abc import Callable
from threading import Lock
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.errors import CameraError
from ninedtact.quantities import Frame

_SILENT = 0
"""Log level of OpenCV at which it prints nothing."""


def silence_video_libraries() -> None:
    """Stop OpenCV and FFmpeg from printing problems that a source raises; environment variables set by the user win."""
    import cv2

    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    if "OPENCV_LOG_LEVEL" not in os.environ:
        # OpenCV moved this function in 4.13.
        set_log_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
        set_log_level(_SILENT)


Result = TypeVar("Result")


@runtime_checkable
class VideoCaptureProtocol(Protocol):
    """The methods of cv2.VideoCapture that are used; the simulated devices of the tests have the same methods."""

    def isOpened(self) -> bool: ...  # noqa: N802, D102
    def get(self, prop: int, /) -> float: ...  # noqa: D102
    def set(self, prop: int, value: float, /) -> bool: ...  # noqa: D102
    def read(self) -> tuple[bool, Any]: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


def _as_bgr(image: Any, name: str) -> Any:
    """Return an image in three channels: that of a grey camera is repeated, an alpha channel dropped; raises `CameraError`."""
    planes = image[..., None] if image.ndim == 2 else image
    channels = planes.shape[2]
    if image.dtype != np.uint8 or channels not in (1, 3, 4):
        raise CameraError(
            expected=f"grey or colour images of 8 bits from {name}",
            got=f"{channels} channels of type {image.dtype}",
            remedy="choose another --pixel-format",
        )
    if channels == 3:
        return planes
    return np.ascontiguousarray(np.broadcast_to(planes[..., :3], (*planes.shape[:2], 3)))


class ThreadSafeVideoCapture:
    """Reads, stamps and counts the images of one capture; only one thread at a time accesses the device."""

    def __init__(
        self,
        name: str,
        capture: VideoCaptureProtocol,
        stamp_ns: Callable[[VideoCaptureProtocol], int] = lambda capture: time.monotonic_ns(),
    ) -> None:
        """stamp_ns: gives the stamp of the image that was just read, in ns of the monotonic clock."""
        self.next_index = 0
        self._name = name
        self._capture = capture
        self._stamp_ns = stamp_ns
        self._released = False
        self._lock = Lock()

    def read(self) -> Frame | None:
        """Return the next image in its own memory, or None where the driver gave none; raises `SourceNotOpen`."""
        with self._lock:
            if self._released:
                raise SourceNotOpen(self._name)
            delivered, image = self._capture.read()
            if not delivered or image is None:
                return None
            self.next_index += 1
            return Frame(_as_bgr(image, self._name), self._stamp_ns(self._capture), self.next_index - 1)

    def query(self, question: Callable[[VideoCaptureProtocol], Result]) -> Result:
        """Call a function with the device between two reads and return its result; raises `SourceNotOpen`."""
        with self._lock:
            if self._released:
                raise SourceNotOpen(self._name)
            return question(self._capture)

    def release(self) -> None:
        """Close the device after a read in progress has ended."""
        with self._lock:
            self._released = True
            self._capture.release()
