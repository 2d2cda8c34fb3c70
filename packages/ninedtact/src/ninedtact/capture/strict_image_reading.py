"""Image files: one of them, or a list or a folder of them as a source of frames. They are read strictly, because an incomplete
image would be measured as if it were complete.

Pillow decodes; it raises an error for data that end early. What decoders pass over is checked before: the checksums of a PNG file
(https://www.w3.org/TR/png-3/ section 5), and the marker that ends a JPEG file (ITU-T T.81 annex B). A JPEG file has no checksum, so
that flipped bits which leave it decodable are not found.
"""

import re
import struct
import time
import zlib
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from threading import Lock

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8
from numpy import ndarray as Array
from PIL import Image, UnidentifiedImageError

from ninedtact.capture.frame_source import (
    AddressedFrameSource,
    CameraNotFound,
    CameraSettings,
    FrameSource,
    SourceNotOpen,
    source_ended,
)
from ninedtact.errors import FileFormatError
from ninedtact.quantities import Frame

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")

_LARGEST_PIXELS = 100_000_000
_LARGEST_FILE_BYTES = 500_000_000
_FORMATS = ("PNG", "JPEG", "BMP")
_PNG, _JPEG, _BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
_START_OF_SCAN, _END_OF_IMAGE = b"\xff\xda", b"\xff\xd9"
_CUT_SHORT = "a file that is cut short"
_DAMAGED = "a damaged file"


class ImageUnreadable(FileFormatError):
    """Raised for an image that is missing, damaged, or of a kind that cannot be measured."""


class ImageSizeWrong(FileFormatError):
    """Raised for an image whose size differs from that of the images it belongs to."""


def read_image(path: str | Path) -> UInt8[Array, "rows cols 3"]:
    """Read a PNG, JPEG or BMP file as 8-bit BGR, pixels as stored (no rotation by EXIF).

    A grey image is repeated in all three channels; a fully opaque alpha channel is dropped. Raises `ImageUnreadable` for
    everything else: missing, empty, cut short or damaged files, animations, 16 bits, transparency.

    >>> ninedtact.read_image("my_sensor/images/ball.png").shape
    (480, 640, 3)
    """
    path = Path(path)
    content = _read_file_bytes(path)
    fault = image_file_fault(content)
    decoded = _decode(content) if fault is None else fault
    if isinstance(decoded, str):
        raise ImageUnreadable(f"expected an image in {path}, got {decoded}; record it again, or save it as 8-bit PNG")
    return decoded


def image_file_fault(content: bytes) -> str | None:
    """Return the fault in the structure of an image file, as words that follow "got"; None for a complete PNG, JPEG or BMP."""
    if content.startswith(_PNG):
        return _png_fault(content)
    if content.startswith(_JPEG):
        return None if has_jpeg_end(content) else _CUT_SHORT
    if content.startswith(_BMP):
        stated = int.from_bytes(content[2:6], "little")
        if len(content) < stated:
            return _CUT_SHORT
        return _DAMAGED if stated and any(content[stated:]) else None  # bytes were inserted; zeros are padding
    return "something else than PNG, JPEG or BMP"


def has_jpeg_end(content: bytes) -> bool:
    """Return whether the marker that ends a JPEG image follows its pixels; a preview in the header has one of its own."""
    return content.rfind(_END_OF_IMAGE) > content.rfind(_START_OF_SCAN) > 0


def jpeg_size(content: bytes) -> tuple[int, int] | None:
    """Return rows and columns in the header of a JPEG image; None where the header cannot be read."""
    try:
        with Image.open(BytesIO(content), formats=("JPEG",)) as image:
            return image.height, image.width
    except (OSError, SyntaxError, ValueError):
        return None


def _png_fault(content: bytes) -> str | None:
    at, kind = len(_PNG), b""
    while kind != b"IEND":
        if len(content) < at + 12:
            return _CUT_SHORT
        size, kind = struct.unpack_from(">I4s", content, at)
        end = at + 8 + size
        if len(content) < end + 4:
            return _CUT_SHORT
        if zlib.crc32(content[at + 4 : end]) != int.from_bytes(content[end : end + 4]):
            return _DAMAGED
        if kind == b"acTL":
            return "an animation"
        if kind == b"IHDR":
            cols, rows, bits = struct.unpack_from(">IIB", content, at + 8)
            if bits == 16 or cols * rows > _LARGEST_PIXELS:
                return "16 bits per channel" if bits == 16 else f"{cols} x {rows} pixels"
        at = end + 4
    return None


def _decode(content: bytes) -> UInt8[Array, "rows cols 3"] | str:
    """Return the image as BGR, or why it cannot be decoded, as words that follow "got"."""
    try:
        with Image.open(BytesIO(content), formats=_FORMATS) as image:
            if image.width * image.height > _LARGEST_PIXELS:
                return f"{image.width} x {image.height} pixels"
            if image.has_transparency_data and np.asarray(image.convert("RGBA"))[..., 3].min() < 255:
                return "transparent pixels"
            rgb: UInt8[Array, "rows cols 3"] = np.asarray(image.convert("RGB"))
            return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, SyntaxError, ValueError) as fault:
        return f"damaged data ({fault})"


def _read_file_bytes(path: Path) -> bytes:
    """Return the bytes of a file; raises `ImageUnreadable` with what is wrong with the path or the file."""
    if path.is_dir():
        raise ImageUnreadable(f"expected an image file, got the folder {path}; name one file in it")
    if not path.exists():
        raise ImageUnreadable(f"expected an image at {path}, got no such file; check the path")
    if not path.is_file() or path.stat().st_size > _LARGEST_FILE_BYTES:
        raise ImageUnreadable(f"expected an image file, got {path}, a device or a huge file; check the path")
    try:
        content = path.read_bytes()
    except OSError as trouble:
        raise ImageUnreadable(f"expected to read {path}, got: {trouble.strerror}; check its permissions") from trouble
    if not content:
        raise ImageUnreadable(f"expected an image in {path}, got an empty file; record it again")
    return content


def require_image_size(image: Shaped[Array, "rows cols *channels"], rows: int, cols: int, what: str) -> None:
    """Raise `ImageSizeWrong` unless the image called `what` has this size."""
    got_rows, got_cols = image.shape[:2]
    if (got_rows, got_cols) != (rows, cols):
        raise ImageSizeWrong(
            f"expected {what} to be {cols} x {rows} pixels, got {got_cols} x {got_rows}; record both alike"
        )


def average_images(images: Sequence[UInt8[Array, "_ _ 3"]]) -> UInt8[Array, "rows cols 3"]:
    """Return the mean of images of one size, rounded to whole grey levels.

    Raises `ImageSizeWrong` for images of different sizes and `ImageUnreadable` for no images.
    """
    if not images:
        raise ImageUnreadable("expected at least one image to average, got none; name the images")
    rows, cols = images[0].shape[:2]
    total = np.zeros((rows, cols, 3), np.uint32)
    for number, image in enumerate(images, start=1):
        require_image_size(image, rows, cols, f"image {number} of {len(images)}")
        total += image
    return ((total + len(images) // 2) // len(images)).astype(np.uint8)


class ImageFileList(FrameSource):
    """A frame source of the given image files in this order, all of one size."""

    is_live = False

    def __init__(self, images: Sequence[Path], name: str = "images", recorded_hz: float | None = 10.0) -> None:
        self.images = tuple(images)
        self.name = name
        self.recorded_hz = recorded_hz
        self._lock = Lock()
        self._next_index: int | None = None
        self._size: tuple[int, int] | None = None

    def open(self) -> None:
        """Start with the first image."""
        if self._next_index is None:
            self._next_index, self._size = 0, None

    def read(self) -> Frame:
        """Return the next image; raises `SourceEnded`, or `ImageUnreadable` or `ImageSizeWrong` for a bad file.

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
            return Frame(image, time.monotonic_ns(), index)

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
        """List the images, anew at every opening; raises `CameraNotFound` where there are none."""
        if self._next_index is not None:
            return
        self.images = tuple(_list_images(self.folder))
        if not self.images:
            kinds = ", ".join(IMAGE_SUFFIXES)
            raise CameraNotFound(f"expected a folder of images ({kinds}), got none in {self.folder}; check the path")
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
