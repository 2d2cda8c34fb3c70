"""What the Linux kernel says of a camera: the modes that it has, the limits of its exposure, and the automatic controls for which
OpenCV has no property.

The numbers and layouts are those of Video4Linux (https://docs.kernel.org/userspace-api/media/v4l/user-func.html). On other systems,
and of devices that may not be queried, nothing is known, and every function returns nothing.
"""

import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from ninedtact.errors import CameraError

_QUERY_CAPABILITIES, _QUERY_CONTROL, _GET_CONTROL, _SET_CONTROL = 0x80685600, 0xC0445624, 0xC008561B, 0xC008561C
_LIST_FORMATS, _LIST_SIZES, _LIST_INTERVALS = 0xC0405602, 0xC02C564A, 0xC034564B
_DEVICE_CAPABILITIES = slice(88, 92)
_CAPTURE_TYPES = {0x00000001: 1, 0x00001000: 9}
"""Buffer types of the capability bits of video capture, single-planar or multi-planar."""
_EXPOSURE_CONTROL, _CONTROL_BYTES, _CONTROL_LIMITS_AT = 0x009A0902, 68, 40
_EXPOSURE_STEPS_PER_MS = 10
_DISCRETE = 1
_MOST_MODES = 1000
AUTOMATIC_CONTROLS = {
    "automatic gain": 0x00980912,
    "automatic hue": 0x00980919,
    "automatic colour gain": 0x0098091D,
    "automatic brightness": 0x00980920,
    "frame rate that follows the exposure": 0x009A0903,
    "wide dynamic range": 0x009A0915,
    "image stabilisation": 0x009A0916,
    "continuous autofocus": 0x009A090C,
}
"""Controls that change the brightness or the geometry of images by themselves, beside those that OpenCV knows; zero is off."""


@dataclass(frozen=True)
class VideoMode:
    """One size of images in one pixel format."""

    pixel_format: str
    size_px: tuple[int, int]
    """Columns and rows."""
    rates_hz: tuple[float, ...] = ()


def delivers_images(path: Path) -> bool:
    """Return whether a device delivers images; a UVC camera also lists one that delivers only metadata.

    A device that may not be queried counts as a camera: the user must hear of the missing permission.
    """
    try:
        return bool(_capture_type(path))
    except OSError:
        return True


def exposure_limits_ms(path: Path) -> tuple[float, float] | None:
    """Return the shortest and the longest exposure; None where they are not known."""
    request = bytearray(_CONTROL_BYTES)
    request[:4] = _EXPOSURE_CONTROL.to_bytes(4, "little")
    try:
        _query(path, _QUERY_CONTROL, request)
    except OSError:
        return None
    least, most = struct.unpack_from("<ii", request, _CONTROL_LIMITS_AT)
    return least / _EXPOSURE_STEPS_PER_MS, most / _EXPOSURE_STEPS_PER_MS


def list_modes(path: Path) -> list[VideoMode]:
    """Return the modes of a camera, in the order of its driver."""
    try:
        kind = _capture_type(path)
        return [mode for pixel_format in _formats(path, kind) for mode in _modes_of_format(path, pixel_format)]
    except OSError:
        return []


def automatic_controls_on(path: Path) -> list[str]:
    """Return the names of the `AUTOMATIC_CONTROLS` that are on."""
    return [name for name, control in AUTOMATIC_CONTROLS.items() if _read_control(path, control)]


def switch_automatic_controls_off(path: Path, camera: str) -> None:
    """Switch every one of the `AUTOMATIC_CONTROLS` off, and read them back; raises `CameraError`."""
    for name in automatic_controls_on(path):
        try:
            _query(path, _SET_CONTROL, bytearray(struct.pack("<Ii", AUTOMATIC_CONTROLS[name], 0)))
        except OSError:
            continue  # what it did not take is still on below
    if still_on := automatic_controls_on(path):
        raise CameraError(
            expected=f"{camera} to switch {' and '.join(still_on)} off",
            got="still on",
            remedy="switch it off with `v4l2-ctl`, or keep it with --automatic (heights then drift)",
        )


def _read_control(path: Path, control: int) -> int:
    """Return the value of a control; zero where the camera lacks it."""
    request = bytearray(struct.pack("<Ii", control, 0))
    try:
        _query(path, _GET_CONTROL, request)
    except OSError:
        return 0
    return int(struct.unpack("<Ii", request)[1])


def _capture_type(path: Path) -> int:
    reply = bytearray(104)
    _query(path, _QUERY_CAPABILITIES, reply)
    own = int.from_bytes(reply[_DEVICE_CAPABILITIES], "little")
    return next((kind for bit, kind in _CAPTURE_TYPES.items() if own & bit), 0)


def _formats(path: Path, kind: int) -> Iterator[bytes]:
    """Yield the codes of four letters."""
    yield from (reply[44:48] for reply in _enumerate(path, _LIST_FORMATS, lambda i: struct.pack("<II56x", i, kind)))


def _modes_of_format(path: Path, pixel_format: bytes) -> Iterator[VideoMode]:
    for reply in _enumerate(path, _LIST_SIZES, lambda i: struct.pack("<I4s36x", i, pixel_format)):
        kind, cols, rows, greatest_rows = struct.unpack_from("<III8xI", reply, 8)
        # A range states the least and the most columns, a step, and the same of rows; its largest size stands for it.
        size_px = (cols, rows) if kind == _DISCRETE else (rows, greatest_rows)
        rates = tuple(_rates_hz(path, pixel_format, *size_px))
        yield VideoMode(pixel_format.decode("ascii", errors="replace"), size_px, rates)
        if kind != _DISCRETE:
            return


def _rates_hz(path: Path, pixel_format: bytes, cols: int, rows: int) -> Iterator[float]:
    for reply in _enumerate(path, _LIST_INTERVALS, lambda i: struct.pack("<I4sII36x", i, pixel_format, cols, rows)):
        kind, numerator, denominator = struct.unpack_from("<III", reply, 16)
        if numerator:
            yield round(denominator / numerator, 3)
        if kind != _DISCRETE:
            return


def _enumerate(path: Path, request: int, ask: Callable[[int], bytes]) -> Iterator[bytes]:
    """Yield the replies to the same request with the indices 0, 1, …, until the driver has no more."""
    for index in count():
        reply = bytearray(ask(index))
        try:
            _query(path, request, reply)
        except OSError:
            return
        if index == _MOST_MODES:
            return
        yield bytes(reply)


def _query(path: Path, request: int, reply: bytearray) -> None:
    try:
        import fcntl
    except ImportError as absence:  # Windows, where no device gets this far
        raise OSError("expected Linux, got another system") from absence

    handle = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    try:
        fcntl.ioctl(handle, request, reply)
    finally:
        os.close(handle)
