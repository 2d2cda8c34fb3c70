"""Still images: read strictly, because an image that is half there would be measured as if it were whole."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.capture.chatter import stderr_held
from ninedtact.capture.image_files import fault_of
from ninedtact.errors import NinedtactError

LARGEST_FILE_BYTES = 500_000_000


class ImageUnreadable(NinedtactError):
    """An image that is missing, damaged, or not of a kind that can be measured."""


class ImageSizeWrong(NinedtactError):
    """An image of another size than the ones it belongs to."""


def read_image(path: str | Path) -> UInt8[Array, "rows cols 3"]:
    """Read a PNG, JPEG or BMP file as 8-bit BGR, pixels as stored (no rotation by EXIF).

    Grey is repeated in all three channels; a fully opaque alpha channel is dropped. All else raises
    `ImageUnreadable`: missing, empty, cut short or damaged files, animations, 16 bits, transparency.
    """
    path = Path(path)
    content = read_content(path)
    if fault := fault_of(content):
        raise ImageUnreadable(f"expected an image in {path}, got {fault}; record it again, or save it as 8-bit PNG")
    return _bgr(_decoded(content, path), path)


def read_content(path: Path) -> bytes:
    """The bytes of a file that a person named; raises `ImageUnreadable` with what is wrong with the name."""
    if path.is_dir():
        raise ImageUnreadable(f"expected an image file, got the folder {path}; name one file in it")
    if not path.exists():
        raise ImageUnreadable(f"expected an image at {path}, got no such file; check the path")
    if not path.is_file() or path.stat().st_size > LARGEST_FILE_BYTES:
        raise ImageUnreadable(f"expected an image file, got {path}, a device or a huge file; check the path")
    try:
        content = path.read_bytes()
    except OSError as trouble:
        raise ImageUnreadable(f"expected to read {path}, got: {trouble.strerror}; check its permissions") from trouble
    if not content:
        raise ImageUnreadable(f"expected an image in {path}, got an empty file; record it again")
    return content


def require_size(image: Shaped[Array, "rows cols *channels"], rows: int, cols: int, what: str) -> None:
    """Raise `ImageSizeWrong` unless the image called `what` has this size."""
    got_rows, got_cols = image.shape[:2]
    if (got_rows, got_cols) != (rows, cols):
        raise ImageSizeWrong(
            f"expected {what} to be {cols} x {rows} pixels, got {got_cols} x {got_rows}; record both alike"
        )


def average_images(images: Sequence[UInt8[Array, "_ _ 3"]]) -> UInt8[Array, "rows cols 3"]:
    """Mean of images of one size, rounded to whole grey levels; raises `ImageSizeWrong`, `ImageUnreadable`."""
    if not images:
        raise ImageUnreadable("expected at least one image to average, got none; name the images")
    rows, cols = images[0].shape[:2]
    total = np.zeros((rows, cols, 3), np.uint32)
    for number, image in enumerate(images, start=1):
        require_size(image, rows, cols, f"image {number} of {len(images)}")
        total += image
    return ((total + len(images) // 2) // len(images)).astype(np.uint8)


def _decoded(content: bytes, path: Path) -> Shaped[Array, "rows cols *channels"]:
    """Whatever OpenCV makes of the file, refused also where the decoder merely grumbled about missing data."""
    with stderr_held() as overheard:
        try:
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            image = None
    if image is None or "Corrupt JPEG" in overheard.text or "Premature end" in overheard.text:
        raise ImageUnreadable(f"expected an image in {path}, got damaged data; record it again")
    return image


def _bgr(image: Shaped[Array, "rows cols *channels"], path: Path) -> UInt8[Array, "rows cols 3"]:
    if image.dtype != np.uint8:
        bits = image.dtype.itemsize * 8
        raise ImageUnreadable(f"expected 8 bits per channel in {path}, got {bits}; save it as an 8-bit PNG")
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    if image.shape[2] == 4 and image[:, :, 3].min() < 255:
        raise ImageUnreadable(f"expected an opaque image in {path}, got transparent pixels; save it without alpha")
    return np.ascontiguousarray(image[:, :, :3])
