"""A height map as a 16-bit grey PNG, one level per micrometre, that says so itself in its text.

    z_mm = (level − 32768) / 1000, level 0 where the camera does not see the skin

The text chunks `mm_per_px`, `noise_mm`, `camera_distance_mm` and `stamp_ns` carry the rest of a `HeightMap`, except
which of its heights are extrapolated: read back, they are all MEASURED.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt16
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.quantities import Coverage, HeightMap

LEVELS_PER_MM = 1000
ZERO_LEVEL = 32768
"""Level of the untouched skin."""
OUT_OF_VIEW_LEVEL = 0
REACH_MM = 32.767
"""The largest height, up or down, that the levels hold."""
LEGEND = "height of the skin: z_mm = (level - 32768) / 1000, level 0 = out of view, negative = pressed in"
SCALES = ("mm_per_px", "noise_mm", "camera_distance_mm")
"""What of a height map is carried as text."""
SIGNATURE = b"\x89PNG\r\n\x1a\n"
TEXT_PLACE = len(SIGNATURE) + 25
"""Where a PNG may first carry text: after its header chunk."""


class HeightNotStorable(NinedtactError):
    """A height that 16 bits of micrometres do not hold."""


class HeightImageUnreadable(NinedtactError):
    """A PNG that is none, or that does not carry heights."""


def height_png(height: HeightMap) -> bytes:
    """Encode heights, rounded to the micrometre; raises `HeightNotStorable` beyond ±32.767 mm."""
    png = cv2.imencode(".png", levels(height))[1].tobytes()
    numbers = {name: repr(float(getattr(height, name))) for name in SCALES}
    text = {"Description": LEGEND, **numbers, "stamp_ns": str(height.stamp_ns)}
    return png[:TEXT_PLACE] + b"".join(text_chunk(*entry) for entry in text.items()) + png[TEXT_PLACE:]


def levels(height: HeightMap) -> UInt16[Array, "rows cols"]:
    """The image's grey levels."""
    z_mm = np.where(height.in_view, height.z_mm, 0)
    # Written so that a height that is no number is refused too.
    if not (np.abs(z_mm) <= REACH_MM).all():
        worst = np.abs(z_mm).max()
        raise HeightNotStorable(f"expected heights up to {REACH_MM} mm for a .png, got {worst} mm; write .npy instead")
    return np.where(height.in_view, np.rint(z_mm * LEVELS_PER_MM) + ZERO_LEVEL, OUT_OF_VIEW_LEVEL).astype(np.uint16)


def read_height_png(path: Path | str) -> HeightMap:
    """Read back what `height_png` encoded; raises `HeightImageUnreadable`."""
    try:
        return decoded(Path(path).read_bytes())
    except (OSError, ValueError, KeyError, struct.error, cv2.error) as trouble:
        raise HeightImageUnreadable(
            f"expected {path} to be an undamaged height image (16-bit grey PNG with its scale as text), "
            f"got: {trouble}; export it again"
        ) from trouble


def decoded(png: bytes) -> HeightMap:
    """The height map in the bytes of a PNG."""
    text = dict(data.decode("latin-1").split("\0", 1) for kind, data in chunks(png) if kind == b"tEXt")
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        raise ValueError("an image that is not 16-bit grey")
    seen = image != OUT_OF_VIEW_LEVEL
    z_mm = np.where(seen, (image.astype(np.float32) - ZERO_LEVEL) / LEVELS_PER_MM, 0).astype(np.float32)
    coverage = np.where(seen, Coverage.MEASURED, Coverage.OUT_OF_VIEW).astype(np.uint8)
    numbers = {name: float(text[name]) for name in SCALES}
    return HeightMap(z_mm, coverage, **numbers, stamp_ns=int(text["stamp_ns"]))


def chunks(png: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of every chunk; raises `ValueError` or `struct.error` where one is damaged or missing."""
    if not png.startswith(SIGNATURE):
        raise ValueError("no PNG")
    place, kind = len(SIGNATURE), b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", png, place)
        data = png[place + 8 : place + 8 + length]
        if struct.unpack_from(">I", png, place + 8 + length) != (zlib.crc32(kind + data),):
            raise ValueError(f"a damaged {kind!r} chunk")
        place += length + 12
        yield kind, data


def text_chunk(name: str, value: str) -> bytes:
    """One entry of text as a PNG chunk."""
    kind, data = b"tEXt", f"{name}\0{value}".encode("latin-1")
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
