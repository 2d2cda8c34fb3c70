"""Driver for a force/torque sensor on a serial port, through pyserial, and the frame in which it sends its samples.

A frame has 36 bytes, little-endian:

| byte | | |
|---|---|---|
| 0 | A5 5A | start of a frame |
| 2 | uint16 | number of the sample, one more each time, wraps after 65,535 |
| 4 | uint32 | clock of the device in µs at the measurement, wraps after 71 minutes |
| 8 | uint16 | bit 0: saturated; bit 1: do not use this sample; the others 0 |
| 10 | 6 × float32 | F_x, F_y, F_z in N, T_x, T_y, T_z in N·m: the load on the tool side, in the frame of the device |
| 34 | uint16 | CRC-16/CCITT-FALSE (polynomial 1021, initial value FFFF) of bytes 2 to 33 |

A reader that starts in the middle, or receives garbage, searches for the next A5 5A with a correct checksum; no whole frame after
the garbage is lost.
"""

import time
from binascii import crc_hqx
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Any

import numpy as np

from ninedtact.capture.force_torque.driver_source import (
    RECEIVE_TIMEOUT_S,
    DeviceClock,
    ForceTorqueDriver,
    ForceTorqueSample,
)
from ninedtact.capture.wrench_source import WrenchSensorLost
from ninedtact.errors import DeviceError, InputError
from ninedtact.required_libraries import require_libraries

BEGIN = b"\xa5\x5a"
_BODY = Struct("<HIH6f")
_CHECKSUM = Struct("<H")
FRAME_BYTES = len(BEGIN) + _BODY.size + _CHECKSUM.size
_SATURATED, _DO_NOT_USE = 1, 2
_SixFloats = tuple[float, float, float, float, float, float]
_DEFAULT_BAUD = 460_800
"""Baud rate for 1,280 frames per second."""
_MOST_BAUD_DIGITS = 9
_MOST_GARBAGE_BYTES = 4096


@dataclass(frozen=True)
class SerialFrame:
    """One sample as a frame on the serial line."""

    number: int
    device_us: int
    six: _SixFloats
    """The load in N and N·m."""
    flags: int = 0

    def to_bytes(self) -> bytes:
        """Return the frame as it is sent over the line."""
        body = _BODY.pack(self.number, self.device_us, self.flags, *self.six)
        return BEGIN + body + _CHECKSUM.pack(crc_hqx(body, 0xFFFF))


def parse_serial_frame(frame: bytes) -> SerialFrame | None:
    """Return the frame of the given bytes, or None if they are not a whole and correct frame."""
    body = frame[len(BEGIN) : -_CHECKSUM.size]
    if (
        len(frame) != FRAME_BYTES
        or not frame.startswith(BEGIN)
        or crc_hqx(body, 0xFFFF) != _CHECKSUM.unpack(frame[-2:])[0]
    ):
        return None
    number, device_us, flags, *six = _BODY.unpack(body)
    return SerialFrame(number, device_us, tuple(six), flags)


class SerialFrameParser:
    """Finds frames in bytes that arrive in portions of any size, with any garbage between them."""

    def __init__(self) -> None:
        self.garbage_bytes = 0
        """Bytes since the last frame that belonged to no frame."""
        self._unread = bytearray()

    @property
    def wanted_bytes(self) -> int:
        """The least number of further bytes that complete a frame."""
        return FRAME_BYTES - len(self._unread)

    def parse(self, portion: bytes) -> Iterator[SerialFrame]:
        """Yield the frames that this portion completes."""
        self._unread += portion
        while self._find_start():
            frame = parse_serial_frame(bytes(self._unread[:FRAME_BYTES]))
            if frame is None:
                self._discard(1)
                continue
            del self._unread[:FRAME_BYTES]
            self.garbage_bytes = 0
            yield frame

    def _find_start(self) -> bool:
        """Remove bytes that cannot start a frame; return whether enough bytes remain for one."""
        start = self._unread.find(BEGIN)
        if start < 0:
            start = len(self._unread) - self._unread.endswith(BEGIN[:1])
        self._discard(start)
        return len(self._unread) >= FRAME_BYTES

    def _discard(self, count: int) -> None:
        del self._unread[:count]
        self.garbage_bytes += count


class SerialPortDriver(ForceTorqueDriver):
    """The driver of a sensor on a serial port, named by the port, such as /dev/ttyUSB0."""

    number_bits = 16

    def __init__(self, port: str, baud: int = _DEFAULT_BAUD) -> None:
        self.name = f"serial:{port}"
        self._port_name, self._baud = port, baud
        self._port: Any = None

    @classmethod
    def from_address(cls, address: str) -> "SerialPortDriver":
        """Return the driver of serial:PORT or serial:PORT@BAUD; raises `InputError`."""
        rest = address.partition(":")[2]
        port, _, baud = rest.rpartition("@") if "@" in rest else (rest, "", str(_DEFAULT_BAUD))
        if not port or not baud.isdecimal() or len(baud) > _MOST_BAUD_DIGITS or int(baud) == 0:
            raise InputError(expected="serial:PORT or serial:PORT@BAUD", got=f"'{address}'", remedy="correct it")
        return cls(port, int(baud))

    def connect(self) -> None:
        """Open the port exclusively and discard what it buffered before; raises `DeviceError`."""
        require_libraries("force-torque", "serial")
        import serial

        try:
            self._port = serial.Serial(self._port_name, self._baud, timeout=RECEIVE_TIMEOUT_S, exclusive=True)
            self._port.reset_input_buffer()
        except (OSError, ValueError) as trouble:
            raise DeviceError(
                f"expected a serial port at {self._port_name}, got: {trouble}; check its name and cable, and that you may "
                "use it (on Linux the group dialout)"
            ) from trouble
        self._parser, self._clock = SerialFrameParser(), DeviceClock()

    def receive(self) -> Sequence[ForceTorqueSample]:
        """Return the samples in the next bytes; raises `WrenchSensorLost`."""
        try:
            received = self._port.read(max(self._parser.wanted_bytes, self._port.in_waiting))
        except (OSError, TypeError) as trouble:  # pyserial raises TypeError where the port vanishes while it reads
            raise WrenchSensorLost(
                f"expected a sample from {self.name}, got: {trouble}; check that it is plugged in"
            ) from trouble
        arrived_ns = time.monotonic_ns()
        samples = [self._sample(frame, arrived_ns) for frame in self._parser.parse(received)]
        if self._parser.garbage_bytes > _MOST_GARBAGE_BYTES:
            raise WrenchSensorLost(
                expected=f"frames from {self.name}",
                got=f"{self._parser.garbage_bytes} bytes without one",
                remedy=f"check its baud rate (here {self._baud}) and that it sends the format of docs/force_torque.md",
            )
        return samples

    def disconnect(self) -> None:
        """Close the serial port after use."""
        self._port.close()

    def _sample(self, frame: SerialFrame, arrived_ns: int) -> ForceTorqueSample:
        stamp_ns = self._clock.stamp_ns(frame.device_us, arrived_ns)
        fault = "its fault flag" if frame.flags & _DO_NOT_USE else ""
        is_saturated = bool(frame.flags & _SATURATED)
        return ForceTorqueSample(np.array(frame.six, float), stamp_ns, frame.number, is_saturated, fault)
