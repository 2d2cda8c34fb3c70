"""Reading of image files. They are read strictly, because an incomplete image would be measured as if it were complete.

Pillow decodes; it raises an error for data that end early. What decoders pass over is checked before: the checksums of a PNG file
(https://www.w3.org/TR/png-3/ section 5), and the marker that ends a JPEG file (ITU-T T.81 annex B). A JPEG file has no checksum, so
that flipped bits which leave it decodable are not found. `encode_png` is the one way in which camera images become PNG files.
"""

import struct
import zlib
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8
from numpy import ndarray as Array
from PIL import Image, UnidentifiedImageError

from ninedtact.bounds import checks_arguments
from ninedtact.errors import FileFormatError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")

_LARGEST_PIXELS = 20_000_000
"""Decoding takes 13 bytes of memory for each pixel; cameras have up to 12 million."""
_LARGEST_FILE_BYTES = 100_000_000
_FORMATS = ("PNG", "JPEG", "BMP")
_PNG, _JPEG, _BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
_START_OF_SCAN, _END_OF_IMAGE = b"\xff\xda", b"\xff\xd9"
_DECODING_ERRORS = (
    Image.DecompressionBombError,
    OSError,
    SyntaxError,
    ValueError,
    MemoryError,
    struct.error,
    KeyError,
    AssertionError,
    IndexError,
)
_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY]
"""Noise of a camera does not repeat itself: a search for repetitions takes three times as long and makes larger files."""
if hasattr(cv2, "IMWRITE_PNG_FILTER"):  # since OpenCV 4.12; smaller and twice as fast
    _FAST_PNG += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_AVG]
_CUT_SHORT = "a file that is cut short"
_DAMAGED = "a damaged file"


@checks_arguments
def read_image(path: str | Path) -> UInt8[Array, "rows cols 3"]:
    """Read a PNG, JPEG or BMP file as 8-bit BGR, pixels as stored (no rotation by EXIF).

    A grey image is repeated in all three channels; a fully opaque alpha channel is dropped. Raises `FileFormatError` for
    everything else: missing, empty, cut short or damaged files, animations, 16 bits, transparency.

    >>> ninedtact.read_image("my_sensor/images/ball.png").shape
    (480, 640, 3)
    """
    path = Path(path)
    try:
        return decode_image_file(_read_file_bytes(path))
    except _ImageFault as fault:
        raise FileFormatError(
            expected=f"an image in {path}", got=fault.got, remedy="record it again, or save it as 8-bit PNG"
        ) from fault


class _ImageFault(FileFormatError):
    """Raised for the content of an image file that cannot be used."""


def decode_image_file(content: bytes, *formats: str) -> UInt8[Array, "rows cols 3"]:
    """Return the image in the bytes of a file, as `read_image`; raises `FileFormatError`, and for other formats than given."""
    fault = image_file_fault(content)
    decoded = _decode(content, formats or _FORMATS) if fault is None else fault
    if isinstance(decoded, str):
        raise _ImageFault(expected="an image", got=decoded, remedy="record it again")
    return decoded


def encode_png(image: UInt8[Array, "rows cols"] | UInt8[Array, "rows cols 3"]) -> bytes:
    """Return the PNG file of a camera image, grey or BGR, compressed for speed."""
    return bytes(cv2.imencode(".png", np.ascontiguousarray(image), _FAST_PNG)[1])


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
        if kind == b"IHDR" and size >= 9:
            cols, rows, bits = struct.unpack_from(">IIB", content, at + 8)
            if bits == 16 or cols * rows > _LARGEST_PIXELS:
                return "16 bits per channel" if bits == 16 else f"{cols} x {rows} pixels"
        at = end + 4
    return None


def _decode(content: bytes, formats: tuple[str, ...]) -> UInt8[Array, "rows cols 3"] | str:
    """Return the image as BGR, or why it cannot be decoded, as words that follow "got"."""
    try:
        with Image.open(BytesIO(content), formats=formats) as image:
            if image.width * image.height > _LARGEST_PIXELS:
                return f"{image.width} x {image.height} pixels"
            if image.has_transparency_data and np.asarray(image.convert("RGBA"))[..., 3].min() < 255:
                return "transparent pixels"
            rgb: UInt8[Array, "rows cols 3"] = np.asarray(image if image.mode == "RGB" else image.convert("RGB"))
            return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    except UnidentifiedImageError:
        return f"something else than {' or '.join(formats)}"
    except _DECODING_ERRORS as fault:
        return f"damaged data ({fault})"


def _read_file_bytes(path: Path) -> bytes:
    """Return the bytes of a file; raises `FileFormatError` with what is wrong with the path or the file."""
    if path.is_dir():
        raise FileFormatError(expected="an image file", got=f"the folder {path}", remedy="name one file in it")
    if not path.exists():
        raise FileFormatError(expected=f"an image at {path}", got="no such file", remedy="check the path")
    if not path.is_file() or path.stat().st_size > _LARGEST_FILE_BYTES:
        raise FileFormatError(expected="an image file", got=f"{path}, a device or a huge file", remedy="check the path")
    try:
        content = path.read_bytes()
    except OSError as trouble:
        raise FileFormatError(f"expected to read {path}, got: {trouble.strerror}; check its permissions") from trouble
    if not content:
        raise FileFormatError(expected=f"an image in {path}", got="an empty file", remedy="record it again")
    return content


def require_image_size(image: Shaped[Array, "rows cols *channels"], rows: int, cols: int, what: str) -> None:
    """Raise `FileFormatError` unless the image called `what` has this size."""
    got_rows, got_cols = image.shape[:2]
    if (got_rows, got_cols) != (rows, cols):
        raise FileFormatError(
            expected=f"{what} to be {cols} x {rows} pixels", got=f"{got_cols} x {got_rows}", remedy="record both alike"
        )


def average_images(images: Sequence[UInt8[Array, "_ _ 3"]]) -> UInt8[Array, "rows cols 3"]:
    """Return the mean of images of one size, rounded to whole grey levels.

    Raises `FileFormatError` for images of different sizes and `FileFormatError` for no images.
    """
    if not images:
        raise FileFormatError(expected="at least one image to average", got="none", remedy="name the images")
    rows, cols = images[0].shape[:2]
    total = np.zeros((rows, cols, 3), np.uint32)
    for number, image in enumerate(images, start=1):
        require_image_size(image, rows, cols, f"image {number} of {len(images)}")
        total += image
    return ((total + len(images) // 2) // len(images)).astype(np.uint8)
