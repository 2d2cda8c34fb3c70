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

A force/torque sensor on a serial port that tells its samples in the plain frame of `serial_frames`, through pyserial.
"""

import time
from binascii import crc_hqx
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Any

import numpy as np

from ninedtact.capture.force_torque.sensor import RECEIVE_TIMEOUT_S, DeviceClock, ForceTorqueDriver, ForceTorqueSample
from ninedtact.capture.wrench_source import (
    ForceTorqueLibraryMissing,
    WrenchFaulty,
    WrenchSampleRejected,
    WrenchSaturated,
    WrenchSensorLost,
    WrenchSensorNotFound,
)

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


def parse_serial_frame(frame: bytes) -> SerialFrame | None:
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


class SerialFrameParser:
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
            frame = parse_serial_frame(bytes(self._unread[:FRAME_BYTES]))
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


BAUD = 460_800
"""1,280 frames per second."""
MOST_GARBAGE_BYTES = 4096


class SerialPortDriver(ForceTorqueDriver):
    """A serial port by its name, such as /dev/ttyUSB0."""

    number_bits = 16

    def __init__(self, port: str, baud: int = BAUD) -> None:
        self.name = f"serial:{port}"
        self._port_name, self._baud = port, baud
        self._port: Any = None

    def connect(self) -> None:
        """Open the port for us alone; what it still holds from before is thrown away."""
        try:
            import serial
        except ImportError as absence:
            raise ForceTorqueLibraryMissing(self.name, "pyserial") from absence
        try:
            self._port = serial.Serial(self._port_name, self._baud, timeout=RECEIVE_TIMEOUT_S, exclusive=True)
            self._port.reset_input_buffer()
        except (OSError, ValueError) as trouble:
            raise WrenchSensorNotFound(
                f"expected a serial port at {self._port_name}, got: {trouble}; check its name and cable, and that you may "
                "use it (on Linux the group dialout)"
            ) from trouble
        self._finder, self._clock = SerialFrameParser(), DeviceClock()

    def receive(self) -> Sequence[ForceTorqueSample]:
        """The frames of the next bytes."""
        try:
            heard = self._port.read(max(self._finder.wanted_bytes, self._port.in_waiting))
        except (OSError, TypeError) as trouble:  # pyserial says TypeError where the port vanishes while it reads
            raise WrenchSensorLost(
                f"expected a sample from {self.name}, got: {trouble}; check that it is plugged in"
            ) from trouble
        arrived_ns = time.monotonic_ns()
        samples = [self._sample(frame, arrived_ns) for frame in self._finder.feed(heard)]
        if self._finder.garbage_bytes > MOST_GARBAGE_BYTES:
            raise WrenchSensorLost(
                f"expected frames from {self.name}, got {self._finder.garbage_bytes} bytes that hold none; check its baud rate "
                f"(here {self._baud}) and that it speaks the format of docs/force_torque.md"
            )
        return samples

    def disconnect(self) -> None:
        """Close the port."""
        self._port.close()

    def _sample(self, frame: SerialFrame, arrived_ns: int) -> ForceTorqueSample:
        stamp_ns = self._clock.stamp_ns(frame.device_us, arrived_ns)
        return ForceTorqueSample(np.array(frame.six, float), stamp_ns, frame.number, self._flaw(frame.flags))

    def _flaw(self, flags: int) -> WrenchSampleRejected | None:
        if flags & SATURATED:
            return WrenchSaturated(f"expected a load that {self.name} can measure, got its saturation flag; press less")
        if flags & DO_NOT_USE:
            return WrenchFaulty(f"expected a usable sample from {self.name}, got its fault flag; check the device")
        return None
