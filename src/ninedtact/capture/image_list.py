"""Images that were named one by one, as a source."""

import time
from collections.abc import Sequence
from pathlib import Path
from threading import Lock

from ninedtact.capture.images import read_image, require_size
from ninedtact.capture.source import FrameSource, SourceEnded, SourceNotOpen
from ninedtact.quantities import Frame


class ImageList(FrameSource):
    """These images in this order, all of one size, then `SourceEnded`."""

    def __init__(self, images: Sequence[Path], name: str = "images", recorded_hz: float | None = 10.0) -> None:
        self.images = tuple(images)
        self.name = name
        self.recorded_hz = recorded_hz
        self._lock = Lock()
        self._next_index: int | None = None
        self._size: tuple[int, int] | None = None

    def open(self) -> None:
        """Begin with the first."""
        if self._next_index is None:
            self._next_index, self._size = 0, None

    def read(self) -> Frame:
        """The next image; `SourceEnded` after the last, `ImageUnreadable` or `ImageSizeWrong` for a bad one.

        A bad image is told once and counts as read, so that the reader may go on.
        """
        with self._lock:
            index = self._counted()
            path = self.images[index]
            image = read_image(path)
            self._size = self._size or image.shape[:2]
            require_size(image, *self._size, str(path))
            return Frame(image, time.monotonic_ns(), index)

    def close(self) -> None:
        """Opening again starts over."""
        with self._lock:
            self._next_index = None

    def _counted(self) -> int:
        if self._next_index is None:
            raise SourceNotOpen(self.name)
        if self._next_index == len(self.images):
            raise SourceEnded(f"expected another image, got the end of {self.name} after {self._next_index}; stop here")
        self._next_index += 1
        return self._next_index - 1
