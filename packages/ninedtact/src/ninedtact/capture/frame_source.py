"""The `FrameSource` interface of every camera, stream and file: it is opened, read and closed; its errors and camera settings; and
the simplest sources, image files by a list or a folder.

A source stamps each frame on arrival (monotonic clock) and counts its own frames. Reading blocks; the longest wait is a setting
of each source, because only its driver can enforce a limit. `frame_pacing.LatestFrameSource` enforces a limit over any source.
A new camera is a subclass of `AddressedFrameSource`, listed in `source_from_address`.
"""

import re
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Annotated, Any, ClassVar, Generic, TypeVar
from weakref import ReferenceType, ref

from msgspec import Meta

from ninedtact.bounds import checks_arguments, describe_value
from ninedtact.capture.strict_image_reading import IMAGE_SUFFIXES, read_image, require_image_size
from ninedtact.errors import CameraError, FileFormatError
from ninedtact.quantities import Frame

Opened = TypeVar("Opened", bound="Openable")


class CameraLost(CameraError):
    """Raised where a camera that had delivered images stopped."""


class SourceEnded(CameraError):
    """Raised where a recording has no further item."""


def source_ended(name: str, count: int) -> SourceEnded:
    """Return the error at the end of a file after some images."""
    return SourceEnded(expected="another image", got=f"the end of {name} after {count}", remedy="stop here")


class SourceIncomplete(FileFormatError):
    """Raised, once, at the end of a file of which images are missing or damaged; every other image was delivered before."""

    def __init__(self, message: str, uncounted: int = 0) -> None:
        """uncounted: number of these images, where it is known, that the indices of the frames do not count."""
        super().__init__(message)
        self.uncounted = uncounted


class SourceNotOpen(CameraError):
    """Raised where a source is read before it was opened or after it was closed."""

    def __init__(self, name: str) -> None:
        super().__init__(f"expected {name} to be open, got a read while it is closed; read it inside `with source:`")


class Openable(ABC):
    """The interface of everything that holds a device from `open` to `close`.

    The constructor accesses no device; opening succeeds completely or not at all. An object that reads it, such as a `Sensor`,
    opens it by `open_for` and owns it until `close_for`, because two readers would each get a part of the images.
    """

    name: str = "the source"
    """The name of the device in messages; it never contains a password."""
    _owner: "ReferenceType[object] | None" = None

    def open_for(self, owner: object) -> None:
        """Open the device for an object that alone reads it; raises `CameraError` while another object does, and as `open`."""
        before = self._owner and self._owner()
        if before is not None and before is not owner:
            raise CameraError(
                expected=f"{self.name} to be read by one sensor",
                got="a second one while the first is open",
                remedy="close the first, or give each sensor a source of its own",
            )
        self._owner = ref(owner)
        try:
            self.open()
        except BaseException:
            self._owner = None
            raise

    def close_for(self, owner: object) -> None:
        """Close the device unless another object owns it now."""
        before = self._owner and self._owner()
        if before is None or before is owner:
            self._owner = None
            self.close()

    @abstractmethod
    def open(self) -> None:
        """Open the device, or raise an error and leave nothing open. Opening an open device does nothing."""

    @abstractmethod
    def close(self) -> None:
        """Release the device. Any thread may call this any number of times; it waits for a read in progress."""

    def __enter__(self: Opened) -> Opened:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True)
class ExposureWithLimits:
    """The exposure of an open camera and the limits within which it can be set, ms."""

    now_ms: float
    least_ms: float
    most_ms: float


class FrameSource(Openable):
    """The interface of every source of frames; `open` raises `CameraError` or `FileFormatError`."""

    is_live: bool = True
    """Whether images show the present: a camera, a stream or a simulated camera. False for recordings, videos and images."""
    is_simulated: bool = False
    """Whether this computer renders the images, which are late where it is slow, but never unplugged."""
    recorded_hz: float | None = None
    """Images per second at which a recording was made, known once it is open; None for a live source, which paces itself."""
    recording: str | None = None
    """Address of the recording (.mcap) whose frames these are; None for any other source."""

    @abstractmethod
    def read(self) -> Frame:
        """Wait for the next frame and return it; its memory is shared with no other frame.

        Raises `SourceEnded` after the last frame of a recording, `CameraLost` when a live source stops, and
        `SourceNotOpen` when the source is not open.
        """

    @property
    def reference_frames(self) -> Sequence[Frame]:
        """Images without contact that the source brings, as a twin does; empty where the first images are to be taken."""
        return ()

    @property
    def notices(self) -> tuple[str, ...]:
        """What the source had to correct since it was opened, as sentences; empty where there is nothing."""
        return ()

    @property
    def exposure(self) -> ExposureWithLimits | None:
        """The exposure of the open source; None where it has none that can be set."""
        return None

    def set_exposure(self, exposure_ms: float) -> None:
        """Set the exposure of the open source; raises `CameraError` where it does not take it."""
        raise CameraError(
            expected="a camera whose exposure can be set here",
            got=f"{self.name} for {exposure_ms:g} ms",
            remedy="set it with the camera's own tool",
        )

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames until the source ends; a live source never ends."""
        while True:
            try:
                frame = self.read()
            except SourceEnded:
                return
            yield frame


def require_frame(frame: Any, name: str) -> Frame:
    """Return what a source of this name has read; raises `CameraError` unless it is a frame whose image has pixels."""
    if isinstance(frame, Frame) and frame.image.size:
        return frame
    got = "an image without pixels" if isinstance(frame, Frame) else describe_value(frame)
    raise CameraError(expected=f"a Frame from {name}", got=got, remedy="correct its read method")


Inner = TypeVar("Inner", bound=Openable)


class SourceWrapper(Openable, Generic[Inner]):
    """Something between a source and its reader: it is opened and closed with the source, and has its name."""

    def __init__(self, source: Inner) -> None:
        self._source = source

    @property
    def name(self) -> str:  # type: ignore[override]
        """The name of the source."""
        return self._source.name

    def open(self) -> None:
        """Open the source; raises what it raises."""
        self._source.open_for(self)

    def close(self) -> None:
        """Close the source."""
        self._source.close_for(self)


def _handed_on(fact: str) -> Any:
    return property(lambda wrapper: getattr(wrapper._source, fact), doc="The same as of the source.")


class FrameSourceWrapper(SourceWrapper[FrameSource], FrameSource):
    """A frame source that changes the frames of another, and has all its facts."""

    is_live = _handed_on("is_live")
    is_simulated = _handed_on("is_simulated")
    recorded_hz = _handed_on("recorded_hz")
    recording = _handed_on("recording")
    reference_frames = _handed_on("reference_frames")
    notices = _handed_on("notices")
    exposure = _handed_on("exposure")

    def _read_source(self) -> Frame:
        """Return the next frame of the source; raises what it raises, and `CameraError` for what is no frame."""
        return require_frame(self._source.read(), self.name)

    def set_exposure(self, exposure_ms: float) -> None:
        """Set the exposure of the source."""
        self._source.set_exposure(exposure_ms)


@checks_arguments
@dataclass(frozen=True)
class CameraSettings:
    """What to set on a camera; None leaves a setting as the camera has it. Every value is read back and must be in force."""

    size_px: tuple[Annotated[int, Meta(ge=1)], Annotated[int, Meta(ge=1)]] | None = (640, 480)
    """Columns and rows."""
    rate_hz: Annotated[float, Meta(gt=0)] | None = None
    pixel_format: str | None = None
    """Four letters. None takes the camera's own, and MJPG where uncompressed images do not arrive, lack the size or are slow."""
    auto_exposure: bool | None = None
    exposure_ms: Annotated[float, Meta(gt=0)] | None = None
    """Implies that automatic exposure is off."""
    gain: float | None = None
    """In the camera's own unit."""
    auto_white_balance: bool | None = None
    white_balance_k: Annotated[float, Meta(gt=0)] | None = None
    """Implies that automatic white balance is off."""
    autofocus: bool | None = None
    focus: float | None = None
    """In the camera's own unit. Implies that autofocus is off."""
    other_automatics: bool | None = None
    """False: automatic gain, brightness and whatever else the camera regulates (`video4linux.AUTOMATIC_CONTROLS`) are off too."""

    def __post_init__(self) -> None:
        for fixed, automatic in (
            ("exposure_ms", "auto_exposure"),
            ("white_balance_k", "auto_white_balance"),
            ("focus", "autofocus"),
        ):
            if getattr(self, fixed) is not None and getattr(self, automatic):
                raise CameraError(expected=f"{fixed} or {automatic}", got="both", remedy="drop one")
        if self.pixel_format is not None and not (len(self.pixel_format) == 4 and self.pixel_format.isascii()):
            raise CameraError(
                expected="pixel_format of four letters", got=f"'{self.pixel_format}'", remedy="try MJPG or YUYV"
            )


DEFAULT_CAMERA = CameraSettings()
"""Raw images of the size that the published sensor has; everything else as the camera has it."""
FIXED_EXPOSURE = CameraSettings(auto_exposure=False, auto_white_balance=False, autofocus=False, other_automatics=False)
"""Everything automatic off: a camera that regulates its own brightness hides the brightness change of a press, and one that focuses
moves the image.
"""


class AddressedFrameSource(FrameSource):
    """A frame source that an address names; `source_from_address.SOURCE_TYPES` lists all of them."""

    address_help: ClassVar[str]
    """The addresses that this backend accepts, for help texts and error messages."""

    @classmethod
    @abstractmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "AddressedFrameSource | None":
        """Return the source that the address names, not yet opened; None if the address belongs to another backend."""


class ImageFileList(FrameSource):
    """A frame source of the given image files in this order, all of one size, stamped as a recording of `recorded_hz`."""

    is_live = False
    recorded_hz: float

    def __init__(self, images: Sequence[Path], name: str = "images", recorded_hz: float = 10.0) -> None:
        self.images = tuple(images)
        self.name = name
        self.recorded_hz = recorded_hz
        self._lock = Lock()
        self._next_index: int | None = None
        self._began_ns = 0
        self._size: tuple[int, int] | None = None

    def open(self) -> None:
        """Start with the first image."""
        if self._next_index is None:
            self._next_index, self._size = 0, None
            self._began_ns = time.monotonic_ns() - round(1e9 * len(self.images) / self.recorded_hz)  # it ends now

    def read(self) -> Frame:
        """Return the next image; raises `SourceEnded`, or `FileFormatError` for a bad file.

        A bad image is reported once and counts as read, so that the next call continues after it.
        """
        with self._lock:
            if self._next_index is None:
                raise SourceNotOpen(self.name)
            index = self._next_index
            if index == len(self.images):
                raise source_ended(self.name, index)
            self._next_index += 1
            path = self.images[index]
            image = read_image(path)
            self._size = self._size or image.shape[:2]
            require_image_size(image, *self._size, str(path))
            return Frame(image, self._began_ns + round(1e9 * index / self.recorded_hz), index)

    def close(self) -> None:
        """Close the list; opening it again starts from the first image."""
        with self._lock:
            self._next_index = None


class ImageFolder(ImageFileList, AddressedFrameSource):
    """A frame source of the images of a folder in the order of their names (2 before 10), all of one size."""

    address_help = "a folder of images"
    is_live = False

    def __init__(self, folder: str | Path, recorded_hz: float = 10.0) -> None:
        super().__init__((), f"folder {folder}", recorded_hz)
        self.folder = Path(folder)

    @classmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "ImageFolder | None":
        """Return the source of a folder that exists; camera settings do not apply to it."""
        folder = Path(address).expanduser()
        return cls(folder) if address and folder.is_dir() else None

    def open(self) -> None:
        """List the images, anew at every opening; raises `CameraError` where there are none."""
        if self._next_index is not None:
            return
        self.images = tuple(_list_images(self.folder))
        if not self.images:
            kinds = ", ".join(IMAGE_SUFFIXES)
            recordings = sorted(self.folder.glob("*.mcap"))
            remedy = f"give the recording in it, {recordings[0]}" if recordings else "check the path"
            raise CameraError(expected=f"a folder of images ({kinds})", got=f"none in {self.folder}", remedy=remedy)
        super().open()


def _list_images(folder: Path) -> list[Path]:
    """Return the image files of a folder without hidden ones, numbers in their names in counting order."""
    if not folder.is_dir():
        return []
    images = (path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    return sorted((path for path in images if not path.name.startswith(".")), key=natural_sort_key)


def natural_sort_key(path: Path) -> list[tuple[int, str]]:
    """Return a sorting key that puts img_2 before img_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]
