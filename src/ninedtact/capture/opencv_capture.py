"""One opened cv2.VideoCapture that several threads may use: it is never released while another thread reads it."""

import time
from collections.abc import Callable
from threading import Lock
from typing import Any, Protocol, TypeVar, runtime_checkable

from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.quantities import Frame

Result = TypeVar("Result")


@runtime_checkable
class OpenCvCapture(Protocol):
    """The methods of cv2.VideoCapture that are used; the simulated devices of the tests have the same."""

    def isOpened(self) -> bool: ...  # noqa: N802, D102
    def get(self, prop: int, /) -> float: ...  # noqa: D102
    def set(self, prop: int, value: float, /) -> bool: ...  # noqa: D102
    def read(self) -> tuple[bool, Any]: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


class FrameGrabber:
    """Reads, stamps and counts the images of one capture; one thread at a time accesses the device."""

    def __init__(
        self,
        name: str,
        capture: OpenCvCapture,
        stamp_ns: Callable[[OpenCvCapture], int] = lambda capture: time.monotonic_ns(),
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
            if not delivered:
                return None
            self.next_index += 1
            return Frame(image, self._stamp_ns(self._capture), self.next_index - 1)

    def query(self, question: Callable[[OpenCvCapture], Result]) -> Result:
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
