"""Sources whose images the test hands in, so that nothing depends on how fast the machine is."""

import threading
import time
from queue import Queue

import numpy as np

from ninedtact.capture.frame_source import FrameSource, SourceNotOpen
from ninedtact.quantities import Frame


class HandFed(FrameSource):
    def __init__(self) -> None:
        self.name = "a source fed by hand"
        self.queue: Queue[Frame | BaseException] = Queue()
        self.fed = 0

    def show(self, level: int = 0, age_ms: float = 0.0, stamp_ns: int | None = None) -> None:
        stamp_ns = time.monotonic_ns() - int(age_ms * 1e6) if stamp_ns is None else stamp_ns
        self.queue.put(Frame(np.full((4, 5, 3), level, np.uint8), stamp_ns, self.fed))
        self.fed += 1

    def fail(self, trouble: BaseException) -> None:
        self.queue.put(trouble)

    def open(self) -> None: ...

    def read(self) -> Frame:
        delivered = self.queue.get()
        if isinstance(delivered, BaseException):
            raise delivered
        return delivered

    def close(self) -> None:
        self.fail(SourceNotOpen(self.name))


class Hanging(FrameSource):
    """A camera whose driver hangs after the first image, until it is closed."""

    name = "a camera that hangs"

    def __init__(self) -> None:
        self._closed, self._read = threading.Event(), False

    def open(self) -> None: ...

    def read(self) -> Frame:
        if self._read:
            self._closed.wait(20)
            raise SourceNotOpen(self.name)
        self._read = True
        return Frame(np.zeros((4, 4, 3), np.uint8), time.monotonic_ns())

    def close(self) -> None:
        self._closed.set()
