"""One opened cv2.VideoCapture, which must never be released while another thread reads it."""

import time
from collections.abc import Callable
from threading import Lock
from typing import Any, Protocol, TypeVar, runtime_checkable

from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.quantities import Frame

Answer = TypeVar("Answer")


@runtime_checkable
class OpenCvCapture(Protocol):
    """The part of cv2.VideoCapture that is used; a bench device in the tests has the same."""

    def isOpened(self) -> bool: ...  # noqa: N802, D102
    def get(self, prop: int, /) -> float: ...  # noqa: D102
    def set(self, prop: int, value: float, /) -> bool: ...  # noqa: D102
    def read(self) -> tuple[bool, Any]: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


def on_arrival(capture: OpenCvCapture) -> int:
    """The stamp of an image that was read just now, ns of the monotonic clock."""
    return time.monotonic_ns()


class FrameGrabber:
    """Reads, stamps and counts the images of one capture; one thread at a time gets at the device."""

    def __init__(
        self, name: str, capture: OpenCvCapture, stamp_ns: Callable[[OpenCvCapture], int] = on_arrival
    ) -> None:
        self.next_index = 0
        self._name = name
        self._capture = capture
        self._stamp_ns = stamp_ns
        self._released = False
        self._lock = Lock()

    def read(self) -> Frame | None:
        """The next image in its own memory, or None where the driver gave none; raises `SourceNotOpen`."""
        with self._lock:
            if self._released:
                raise SourceNotOpen(self._name)
            delivered, image = self._capture.read()
            if not delivered:
                return None
            self.next_index += 1
            return Frame(image, self._stamp_ns(self._capture), self.next_index - 1)

    def ask(self, question: Callable[[OpenCvCapture], Answer]) -> Answer:
        """Put a question to the device between two images; raises `SourceNotOpen`."""
        with self._lock:
            if self._released:
                raise SourceNotOpen(self._name)
            return question(self._capture)

    def release(self) -> None:
        """Close the device after a read in progress."""
        with self._lock:
            self._released = True
            self._capture.release()
