"""Still pictures: read strictly, because a picture that is half there would be measured as if it were whole."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.capture.chatter import stderr_held
from ninedtact.capture.picture_files import fault_of
from ninedtact.errors import NinedtactError

LARGEST_FILE_BYTES = 500_000_000


class PictureUnreadable(NinedtactError):
    """A picture that is missing, damaged, or not of a kind that can be measured."""


class PictureSizeWrong(NinedtactError):
    """A picture of another size than the ones it belongs to."""


def read_picture(path: str | Path) -> UInt8[Array, "rows cols 3"]:
    """Read a PNG, JPEG or BMP file as 8-bit BGR, pixels as stored (no rotation by EXIF).

    Grey is repeated in all three channels; a fully opaque alpha channel is dropped. All else raises
    `PictureUnreadable`: missing, empty, cut short or damaged files, animations, 16 bits, transparency.
    """
    path = Path(path)
    content = read_content(path)
    if fault := fault_of(content):
        raise PictureUnreadable(f"expected a picture in {path}, got {fault}; record it again, or save it as 8-bit PNG")
    return _bgr(_decoded(content, path), path)


def read_content(path: Path) -> bytes:
    """The bytes of a file that a person named; raises `PictureUnreadable` with what is wrong with the name."""
    if path.is_dir():
        raise PictureUnreadable(f"expected a picture file, got the folder {path}; name one file in it")
    if not path.exists():
        raise PictureUnreadable(f"expected a picture at {path}, got no such file; check the path")
    if not path.is_file() or path.stat().st_size > LARGEST_FILE_BYTES:
        raise PictureUnreadable(f"expected a picture file, got {path}, a device or a huge file; check the path")
    try:
        content = path.read_bytes()
    except OSError as trouble:
        raise PictureUnreadable(f"expected to read {path}, got: {trouble.strerror}; check its permissions") from trouble
    if not content:
        raise PictureUnreadable(f"expected a picture in {path}, got an empty file; record it again")
    return content


def require_size(picture: Shaped[Array, "rows cols *channels"], rows: int, cols: int, what: str) -> None:
    """Raise `PictureSizeWrong` unless the picture called `what` has this size."""
    got_rows, got_cols = picture.shape[:2]
    if (got_rows, got_cols) != (rows, cols):
        raise PictureSizeWrong(
            f"expected {what} to be {cols} x {rows} pixels, got {got_cols} x {got_rows}; record both alike"
        )


def average_pictures(pictures: Sequence[UInt8[Array, "_ _ 3"]]) -> UInt8[Array, "rows cols 3"]:
    """Mean of pictures of one size, rounded to whole grey levels; raises `PictureSizeWrong`, `PictureUnreadable`."""
    if not pictures:
        raise PictureUnreadable("expected at least one picture to average, got none; name the pictures")
    rows, cols = pictures[0].shape[:2]
    total = np.zeros((rows, cols, 3), np.uint32)
    for number, picture in enumerate(pictures, start=1):
        require_size(picture, rows, cols, f"picture {number} of {len(pictures)}")
        total += picture
    return ((total + len(pictures) // 2) // len(pictures)).astype(np.uint8)


def _decoded(content: bytes, path: Path) -> Shaped[Array, "rows cols *channels"]:
    """Whatever OpenCV makes of the file, refused also where the decoder merely grumbled about missing data."""
    with stderr_held() as overheard:
        try:
            picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            picture = None
    if picture is None or "Corrupt JPEG" in overheard.text or "Premature end" in overheard.text:
        raise PictureUnreadable(f"expected a picture in {path}, got damaged data; record it again")
    return picture


def _bgr(picture: Shaped[Array, "rows cols *channels"], path: Path) -> UInt8[Array, "rows cols 3"]:
    if picture.dtype != np.uint8:
        bits = picture.dtype.itemsize * 8
        raise PictureUnreadable(f"expected 8 bits per channel in {path}, got {bits}; save it as an 8-bit PNG")
    if picture.ndim == 2:
        return cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    if picture.shape[2] == 4 and picture[:, :, 3].min() < 255:
        raise PictureUnreadable(f"expected an opaque picture in {path}, got transparent pixels; save it without alpha")
    return np.ascontiguousarray(picture[:, :, :3])
