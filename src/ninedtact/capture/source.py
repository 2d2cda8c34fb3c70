"""What a camera is to the rest of the package: something that is opened, read picture by picture, and closed.

A source is stamped on arrival (monotonic clock) and counts its own pictures. Reading blocks; how long at most is each
source's own setting, because only its driver can keep a limit. `Freshest` keeps a limit over any source.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from types import TracebackType
from typing import TypeVar

from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame

Opened = TypeVar("Opened", bound="FrameSource")


class CameraNotFound(NinedtactError):
    """No camera, stream or file could be opened there."""


class CameraLost(NinedtactError):
    """A camera that had delivered pictures stopped."""


class SourceEnded(NinedtactError):
    """A file or folder has no further picture."""


class SourceNotOpen(NinedtactError):
    """A source was read before it was opened or after it was closed."""

    def __init__(self, name: str) -> None:
        super().__init__(f"expected {name} to be open, got a read while it is closed; read it inside `with source:`")


class FrameSource(ABC):
    """Anything that delivers pictures. The constructor touches no device; opening is all or nothing."""

    name: str
    """What to call it in front of a person; never holds a password."""

    recorded_hz: float | None = None
    """Pictures per second at which a recording was made; None for a live source, which paces itself."""

    @abstractmethod
    def open(self) -> None:
        """Open, or raise and leave nothing open (`CameraNotFound`, `SettingRefused`, `PictureUnreadable`).

        Opening an open source does nothing.
        """

    @abstractmethod
    def read(self) -> Frame:
        """Wait for the next picture; its memory is its own.

        Raises `SourceEnded` after the last picture of a recording, `CameraLost` when a live source stops, and
        `SourceNotOpen` when it is not open.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the device. Any thread may call it, any number of times; it waits for a read in progress."""

    def __enter__(self: Opened) -> Opened:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        """Yield pictures until the source ends; a live source never does."""
        while True:
            try:
                frame = self.read()
            except SourceEnded:
                return
            yield frame
