"""A force/torque sensor on a serial port that tells its samples in the plain frame of `serial_frames`, through pyserial."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from ninedtact.capture.force_torque.device_clock import DeviceClock
from ninedtact.capture.force_torque.line import LISTENED_S, Line, Sample
from ninedtact.capture.force_torque.refusals import (
    ForceTorqueLibraryMissing,
    WrenchFaulty,
    WrenchSaturated,
    WrenchSensorNotFound,
    WrenchUntrusted,
)
from ninedtact.capture.force_torque.serial_frames import DO_NOT_USE, SATURATED, FrameFinder, SerialFrame
from ninedtact.capture.wrench_source import WrenchSensorLost

BAUD = 460_800
"""1,280 frames per second."""
MOST_GARBAGE_BYTES = 4096


class SerialLine(Line):
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
            self._port = serial.Serial(self._port_name, self._baud, timeout=LISTENED_S, exclusive=True)
            self._port.reset_input_buffer()
        except (OSError, ValueError) as trouble:
            raise WrenchSensorNotFound(
                f"expected a serial port at {self._port_name}, got: {trouble}; check its name and cable, and that you may "
                "use it (on Linux the group dialout)"
            ) from trouble
        self._finder, self._clock = FrameFinder(), DeviceClock()

    def receive(self) -> Sequence[Sample]:
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

    def _sample(self, frame: SerialFrame, arrived_ns: int) -> Sample:
        stamp_ns = self._clock.stamp_ns(frame.device_us, arrived_ns)
        return Sample(np.array(frame.six, float), stamp_ns, frame.number, self._flaw(frame.flags))

    def _flaw(self, flags: int) -> WrenchUntrusted | None:
        if flags & SATURATED:
            return WrenchSaturated(f"expected a load that {self.name} can measure, got its saturation flag; press less")
        if flags & DO_NOT_USE:
            return WrenchFaulty(f"expected a usable sample from {self.name}, got its fault flag; check the device")
        return None
