"""What all devices have in common: they are opened, and closed however their use ends.

What a camera is to the rest of the package: something that is opened, read image by image, and closed.

A source is stamped on arrival (monotonic clock) and counts its own images. Reading blocks; how long at most is each
source's own setting, because only its driver can keep a limit. `Freshest` keeps a limit over any source.

What a camera is set to: every setting is read back, and refused where the camera did not take it.

The values are those of Video4Linux (https://docs.kernel.org/userspace-api/media/v4l/ext-ctrls-camera.html): exposure in
steps of 0.1 ms, automatic exposure as 0 auto, 1 manual, 2 shutter priority, 3 aperture priority.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import TypeVar

from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame

Opened = TypeVar("Opened", bound="Openable")


class Openable(ABC):
    """Anything that holds a device from `open` to `close`. The constructor touches none; opening is all or nothing."""

    name: str
    """What to call it in front of a person; never holds a password."""

    @abstractmethod
    def open(self) -> None:
        """Open, or raise and leave nothing open. Opening what is open does nothing."""

    @abstractmethod
    def close(self) -> None:
        """Release the device. Any thread may call it, any number of times; it waits for a read in progress."""

    def __enter__(self: Opened) -> Opened:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


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
    """Anything that delivers images; `open` raises `CameraNotFound`, `CameraSettingRefused` or `ImageUnreadable`."""

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


class CameraSettingRefused(NinedtactError):
    """A setting that the camera did not take."""


@dataclass(frozen=True)
class CameraSettings:
    """What to ask of a camera; None leaves a setting as the camera has it."""

    size_px: tuple[int, int] | None = (640, 480)
    """Columns and rows."""
    rate_hz: float | None = None
    pixel_format: str | None = None
    """Four letters. Over USB 2 the high rates need MJPG."""
    auto_exposure: bool | None = None
    exposure_ms: float | None = None
    """Implies that automatic exposure is off."""
    gain: float | None = None
    """In the camera's own unit."""
    auto_white_balance: bool | None = None
    white_balance_k: float | None = None
    """Implies that automatic white balance is off."""

    def __post_init__(self) -> None:
        if self.exposure_ms is not None and self.auto_exposure:
            raise CameraSettingRefused("expected exposure_ms or auto_exposure, got both; drop one")
        if self.white_balance_k is not None and self.auto_white_balance:
            raise CameraSettingRefused("expected white_balance_k or auto_white_balance, got both; drop one")
        if self.pixel_format is not None and len(self.pixel_format) != 4:
            raise CameraSettingRefused(
                f"expected pixel_format of four letters, got '{self.pixel_format}'; try MJPG or YUYV"
            )


DEFAULT_CAMERA = CameraSettings()
"""Raw images of the size that the published sensor has; all else as the camera has it."""
FIXED_EXPOSURE = CameraSettings(auto_exposure=False, auto_white_balance=False)
"""What touch needs: a camera that regulates its own brightness answers a press by brightening the image again."""
