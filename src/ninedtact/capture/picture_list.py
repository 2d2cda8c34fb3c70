"""Pictures that were named one by one, as a source."""

import time
from collections.abc import Sequence
from pathlib import Path
from threading import Lock

from ninedtact.capture.pictures import read_picture, require_size
from ninedtact.capture.source import FrameSource, SourceEnded, SourceNotOpen
from ninedtact.quantities import Frame


class PictureList(FrameSource):
    """These pictures in this order, all of one size, then `SourceEnded`."""

    def __init__(self, pictures: Sequence[Path], name: str = "pictures", recorded_hz: float | None = 10.0) -> None:
        self.pictures = tuple(pictures)
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
        """The next picture; `SourceEnded` after the last, `PictureUnreadable` or `PictureSizeWrong` for a bad one.

        A bad picture is told once and counts as read, so that the reader may go on.
        """
        with self._lock:
            index = self._counted()
            path = self.pictures[index]
            picture = read_picture(path)
            self._size = self._size or picture.shape[:2]
            require_size(picture, *self._size, str(path))
            return Frame(picture, time.monotonic_ns(), index)

    def close(self) -> None:
        """Opening again starts over."""
        with self._lock:
            self._next_index = None

    def _counted(self) -> int:
        if self._next_index is None:
            raise SourceNotOpen(self.name)
        if self._next_index == len(self.pictures):
            raise SourceEnded(
                f"expected another picture, got the end of {self.name} after {self._next_index}; stop here"
            )
        self._next_index += 1
        return self._next_index - 1
