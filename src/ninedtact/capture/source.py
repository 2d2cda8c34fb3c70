"""What a camera is to the rest of the package: something that is opened, read image by image, and closed.

A source is stamped on arrival (monotonic clock) and counts its own images. Reading blocks; how long at most is each
source's own setting, because only its driver can keep a limit. `Freshest` keeps a limit over any source.
"""

from abc import abstractmethod
from collections.abc import Iterator

from ninedtact.capture.openable import Openable
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame


class CameraNotFound(NinedtactError):
    """No camera, stream or file could be opened there."""


class CameraLost(NinedtactError):
    """A camera that had delivered images stopped."""


class SourceEnded(NinedtactError):
    """A file or folder has no further image."""


class SourceNotOpen(NinedtactError):
    """A source was read before it was opened or after it was closed."""

    def __init__(self, name: str) -> None:
        super().__init__(f"expected {name} to be open, got a read while it is closed; read it inside `with source:`")


class FrameSource(Openable):
    """Anything that delivers images; `open` raises `CameraNotFound`, `SettingRefused` or `ImageUnreadable`."""

    recorded_hz: float | None = None
    """Images per second at which a recording was made; None for a live source, which paces itself."""

    @abstractmethod
    def read(self) -> Frame:
        """Wait for the next image; its memory is its own.

        Raises `SourceEnded` after the last image of a recording, `CameraLost` when a live source stops, and
        `SourceNotOpen` when it is not open.
        """

    def __iter__(self) -> Iterator[Frame]:
        """Yield images until the source ends; a live source never does."""
        while True:
            try:
                frame = self.read()
            except SourceEnded:
                return
            yield frame
