"""The plain frame in which a force/torque sensor on a serial line tells its samples; 36 bytes, little-endian.

| byte | | |
|---|---|---|
| 0 | A5 5A | where a frame begins |
| 2 | uint16 | number of the sample, one more each time, begins again after 65,535 |
| 4 | uint32 | the device's clock in µs when it measured, begins again after 71 minutes |
| 8 | uint16 | bit 0: saturated; bit 1: do not use this sample; the others 0 |
| 10 | 6 × float32 | F_x, F_y, F_z in N, T_x, T_y, T_z in N·m: what loads the tool side, in the device's frame |
| 34 | uint16 | CRC-16/CCITT-FALSE (polynomial 1021, begun with FFFF) of bytes 2 to 33 |

A reader that begins in the middle, or hears garbage, looks for the next A5 5A whose checksum is right; no whole frame after
the garbage is lost.
"""

from binascii import crc_hqx
from collections.abc import Iterator
from dataclasses import dataclass
from struct import Struct

BEGIN = b"\xa5\x5a"
BODY = Struct("<HIH6f")
CHECKSUM = Struct("<H")
FRAME_BYTES = len(BEGIN) + BODY.size + CHECKSUM.size
SATURATED, DO_NOT_USE = 1, 2
Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class SerialFrame:
    """One sample on a serial line."""

    number: int
    device_us: int
    six: Six
    """N and N·m."""
    flags: int = 0

    def encoded(self) -> bytes:
        """As it goes over the line."""
        body = BODY.pack(self.number, self.device_us, self.flags, *self.six)
        return BEGIN + body + CHECKSUM.pack(crc_hqx(body, 0xFFFF))


def decoded(frame: bytes) -> SerialFrame | None:
    """A frame from its bytes; None if they are not one."""
    body = frame[len(BEGIN) : -CHECKSUM.size]
    if (
        len(frame) != FRAME_BYTES
        or not frame.startswith(BEGIN)
        or crc_hqx(body, 0xFFFF) != CHECKSUM.unpack(frame[-2:])[0]
    ):
        return None
    number, device_us, flags, *six = BODY.unpack(body)
    return SerialFrame(number, device_us, tuple(six), flags)


class FrameFinder:
    """Finds frames in bytes that come in any portions, with any garbage between."""

    def __init__(self) -> None:
        self.garbage_bytes = 0
        """Bytes since the last frame that belonged to none."""
        self._unread = bytearray()

    @property
    def wanted_bytes(self) -> int:
        """After so many more bytes there may be a frame."""
        return max(FRAME_BYTES - len(self._unread), 1)

    def feed(self, portion: bytes) -> Iterator[SerialFrame]:
        """The frames that this portion completes."""
        self._unread += portion
        while self._at_beginning():
            frame = decoded(bytes(self._unread[:FRAME_BYTES]))
            if frame is None:
                self._forget(1)
                continue
            del self._unread[:FRAME_BYTES]
            self.garbage_bytes = 0
            yield frame

    def _at_beginning(self) -> bool:
        """Drop what cannot begin a frame; whether enough is there for one."""
        begins_at = self._unread.find(BEGIN)
        if begins_at < 0:
            begins_at = len(self._unread) - self._unread.endswith(BEGIN[:1])
        self._forget(begins_at)
        return len(self._unread) >= FRAME_BYTES

    def _forget(self, count: int) -> None:
        del self._unread[:count]
        self.garbage_bytes += count
