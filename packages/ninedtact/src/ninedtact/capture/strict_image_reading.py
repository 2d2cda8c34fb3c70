"""Reads image files strictly, because an incomplete image would be measured as if it were complete.

The structure of a file is checked before any decoder reads it. Versions of decoders differ in what they accept: some return half
an image with a line on standard error, others crash on a damaged animation. The check of the structure gives the same result
with all of them. PNG: https://www.w3.org/TR/png-3/ section 5; JPEG: ITU-T T.81 annex B. A JPEG file has no checksum: damage that
leaves it decodable is found in the decoded image, as steps along the borders of its blocks that no optical image has.
"""

import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Int, Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.capture.shared_video_capture import capture_output
from ninedtact.errors import FileFormatError

_LARGEST_PIXELS = 100_000_000
_PNG, _JPEG, _BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
_OTHER_FORMATS = {
    b"GIF8": "a GIF",
    b"II*\0": "a TIFF",
    b"MM\0*": "a TIFF",
    b"RIFF": "a WebP or a video",
    b"\0\0\0": "a video, HEIC or AVIF",
    b"%PDF": "a PDF",
}
_BESIDE_BORDER_PX = (-4, -3, 3, 4)
"""Distances from the border of a block at which the scene itself is compared."""
_CUT_SHORT = "a file that is cut short"
_DAMAGED = "a damaged file"


def image_file_fault(content: bytes) -> str | None:
    """Return the fault in the content of an image file, as words that follow "got"; None for a complete PNG, JPEG or BMP."""
    if content.startswith(_PNG):
        return _png_fault(content)
    if content.startswith(_JPEG):
        return _jpeg_fault(content)
    if content.startswith(_BMP):
        return _bmp_fault(content)
    kind = next((kind for start, kind in _OTHER_FORMATS.items() if content.startswith(start)), "something else")
    return f"{kind} where PNG, JPEG or BMP is read"


def _png_fault(content: bytes) -> str | None:
    at, last = len(_PNG), b""
    while last != b"IEND":
        size, last = int.from_bytes(content[at : at + 4]), content[at + 4 : at + 8]
        body, check = content[at + 4 : at + 8 + size], content[at + 8 + size : at + 12 + size]
        if len(check) < 4:
            return _CUT_SHORT
        if zlib.crc32(body) != int.from_bytes(check):
            return _DAMAGED
        if last == b"acTL":
            return "an animation"
        if last == b"IHDR" and (fault := _too_large(int.from_bytes(body[8:12]), int.from_bytes(body[4:8]))):
            return fault
        at += 12 + size
    return None


def _jpeg_fault(content: bytes) -> str | None:
    """Return the fault of a JPEG file; only an end-of-image marker outside of all segments ends a complete file."""
    for marker, segment in _jpeg_segments(content):
        if marker == 0xD9:
            return None
        if _is_frame_header(marker) and (fault := _too_large(*_frame_header_size(segment))):
            return fault
    return _CUT_SHORT


def jpeg_size(content: bytes) -> tuple[int, int] | None:
    """Return rows and columns of a JPEG image, complete or not; None where its frame header is missing."""
    headers = (segment for marker, segment in _jpeg_segments(content) if _is_frame_header(marker))
    segment = next(headers, None)
    return None if segment is None else _frame_header_size(segment)


def _is_frame_header(marker: int) -> bool:
    return 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC)


def _frame_header_size(segment: bytes) -> tuple[int, int]:
    """Return rows and columns in the frame header of a JPEG image."""
    return int.from_bytes(segment[3:5]), int.from_bytes(segment[5:7])


def _jpeg_segments(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield markers with the bytes that follow them, up to the end of the image.

    Scan data is skipped; in it 0xFF precedes 0x00 or a restart marker.
    """
    at = 2
    while (at := content.find(b"\xff", at)) >= 0 and at + 1 < len(content):
        marker = content[at + 1]
        if marker in (0x00, 0x01, 0xFF) or 0xD0 <= marker <= 0xD7:
            at += 1 if marker == 0xFF else 2
            continue
        if marker == 0xD9:
            yield marker, b""
            return
        size = int.from_bytes(content[at + 2 : at + 4])
        yield marker, content[at + 2 : at + 2 + size]
        at += 2 + size


def has_shifted_blocks(content: bytes, grey: UInt8[Array, "rows cols"]) -> bool:
    """Return whether the brightness of a decoded JPEG image is shifted from some block on, as after a flipped bit.

    A block's mean brightness is stored as its difference from the block before (ITU-T T.81, F.1.1.5.1), so that a wrong difference
    shifts all that follow. The border between them and the blocks above is as long as the image is wide. Along any such
    border of a whole image, the steps due to quantisation average less than a quantum, and those of the scene are no larger than
    on lines beside it.
    """
    height, quantum = _luminance_blocks(content)
    rows, cols = grey.shape
    count = (rows - 2 - max(_BESIDE_BORDER_PX)) // height
    if count < 1:
        return False
    borders = height * np.arange(1, count + 1)
    at_border, *beside = (brightness_steps_at_rows(grey, borders + px) for px in (0, *_BESIDE_BORDER_PX))

    def means(steps: Float32[Array, "lines cols"]) -> Shaped[Array, " places"]:
        sums = np.cumsum(steps, dtype=float)
        return np.abs(sums[cols - 1 :] - np.concatenate([[0.0], sums[:-cols]])) / cols

    noise = float(np.std(beside)) / np.sqrt(cols)
    usual = 2 * np.max([means(steps) for steps in beside], axis=0)
    return bool((means(at_border) > usual + 1.25 * quantum + 0.5 + 4 * noise).any())


def brightness_steps_at_rows(
    grey: UInt8[Array, "rows cols"], chosen: Int[Array, " lines"]
) -> Float32[Array, "lines cols"]:
    """Return the difference of each chosen row from the one before, less the mean of the slopes on both sides."""
    before, row = grey[chosen - 1].astype(np.int16), grey[chosen].astype(np.int16)
    return np.float32(1.5) * (row - before) - np.float32(0.5) * (grey[chosen + 1].astype(np.int16) - grey[chosen - 2])


def _luminance_blocks(content: bytes) -> tuple[int, float]:
    """Return the height of a JPEG image's coded units in pixels, and the quantum of a block's mean brightness in grey levels."""
    height, table, quanta = 8, 0, dict[int, int]()
    for marker, segment in _jpeg_segments(content):
        if _is_frame_header(marker) and len(segment) > 10:
            height, table = 8 * (segment[9] % 16 if segment[7] > 1 else 1), segment[10]
        at = 2
        while marker == 0xDB and at + 2 < len(segment):
            size = 1 + (segment[at] >> 4)
            quanta[segment[at] % 16] = int.from_bytes(segment[at + 1 : at + 1 + size])
            at += 1 + 64 * size
    return max(height, 8), quanta.get(table, 16) / 8


def _bmp_fault(content: bytes) -> str | None:
    size = int.from_bytes(content[2:6], "little")
    if len(content) < max(size, 26):
        return _CUT_SHORT
    if size and any(content[size:]):  # not padding: bytes were inserted, and all pixels after them are in another place
        return _DAMAGED
    cols, rows = (int.from_bytes(content[at : at + 4], "little", signed=True) for at in (18, 22))
    return _too_large(abs(rows), abs(cols))


def _too_large(rows: int, cols: int) -> str | None:
    return f"{cols} x {rows} pixels" if cols * rows > _LARGEST_PIXELS else None


_LARGEST_FILE_BYTES = 500_000_000


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
    if fault := image_file_fault(content):
        raise ImageUnreadable(f"expected an image in {path}, got {fault}; record it again, or save it as 8-bit PNG")
    return _to_bgr(_decode(content, path), path)


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


def _decode(content: bytes, path: Path) -> Shaped[Array, "rows cols *channels"]:
    """Decode with OpenCV; raises `ImageUnreadable` also where the decoder only printed a warning about missing data."""
    with capture_output(2) as printed:
        try:
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            image = None
    if image is None or "Corrupt JPEG" in printed.text or "Premature end" in printed.text:
        raise ImageUnreadable(f"expected an image in {path}, got damaged data; record it again")
    if content.startswith(_JPEG) and has_shifted_blocks(content, _to_grey(image)):
        raise ImageUnreadable(
            f"expected an image in {path}, got one whose brightness changes at once along a line of JPEG blocks, as after a "
            "flipped bit; record it again, and keep images as PNG, which has a checksum"
        )
    return image


def _to_grey(image: Shaped[Array, "rows cols *channels"]) -> UInt8[Array, "rows cols"]:
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def _to_bgr(image: Shaped[Array, "rows cols *channels"], path: Path) -> UInt8[Array, "rows cols 3"]:
    if image.dtype != np.uint8:
        bits = image.dtype.itemsize * 8
        raise ImageUnreadable(f"expected 8 bits per channel in {path}, got {bits}; save it as an 8-bit PNG")
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    if image.shape[2] == 4 and image[:, :, 3].min() < 255:
        raise ImageUnreadable(f"expected an opaque image in {path}, got transparent pixels; save it without alpha")
    return np.ascontiguousarray(image[:, :, :3])
