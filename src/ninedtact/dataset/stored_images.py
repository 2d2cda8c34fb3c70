"""The images that a data set stores: grey PNG files, encoded, decoded, and looked up by the id of a reference image."""

from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.capture.strict_image_reading import image_file_fault
from ninedtact.dataset.parquet_files import iterate_rows
from ninedtact.errors import FileFormatError

GreyImage = UInt8[Array, "rows cols"]
_FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
"""PNG compression level. Noise does not compress: a higher level would save 4 % and take three times as long."""
_MOST_DECODED = 32


class StoredImageUnreadable(FileFormatError):
    """Raised for stored bytes that are not an 8-bit image."""


def encode_png(image: GreyImage) -> bytes:
    """Return a grey image as a PNG file."""
    return bytes(cv2.imencode(".png", image, _FAST_PNG)[1])


def decode_stored_image(stored: Any) -> GreyImage:
    """Return the grey image of a value of the column `image`, or of a PNG file's bytes.

    The structure of the file is checked before it is decoded. Raises `StoredImageUnreadable`.
    """
    content = stored_image_bytes(stored)
    if not content:
        raise StoredImageUnreadable("expected an image, got nothing; record it again")
    if fault := image_file_fault(content):
        raise StoredImageUnreadable(f"expected an image, got {fault}; record it again")
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint8:
        raise StoredImageUnreadable("expected an 8-bit image, got damaged data or another depth; record it again")
    if image.ndim == 3:
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY)
    return np.asarray(image)


def stored_image_bytes(stored: Any) -> bytes | None:
    """Return the file in a value of the column `image`; None if there is none."""
    content = stored.get("bytes") if isinstance(stored, dict) else stored
    return content if isinstance(content, bytes) else None


def read_reference_values(path: Path, ids: Iterable[str | None]) -> dict[str, Any]:
    """Return the values of the column `image` of some reference images by their id; raises `DatasetDamaged`."""
    wanted = set(ids)
    rows = iterate_rows(path, ("reference_id", "image"))
    return {row["reference_id"]: row["image"] for row in rows if row["reference_id"] in wanted}


class ReferenceImageStore:
    """The reference images of a file by id: all as encoded files, the most recent ones decoded."""

    def __init__(self, path: Path) -> None:
        self._files = {row["reference_id"]: row["image"] for row in iterate_rows(path, ("reference_id", "image"))}
        self._decoded: OrderedDict[str, GreyImage] = OrderedDict()

    def find(self, reference_id: str | None) -> GreyImage | None:
        """Return the image of this id; None if it is missing or cannot be read."""
        if reference_id is None or reference_id not in self._files:
            return None
        if reference_id not in self._decoded:
            try:
                self._decoded[reference_id] = decode_stored_image(self._files[reference_id])
            except StoredImageUnreadable:
                return None
            if len(self._decoded) > _MOST_DECODED:
                self._decoded.popitem(last=False)
        return self._decoded[reference_id]
